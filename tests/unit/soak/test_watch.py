"""What rises in a long run is told, what is noise or ended early is not."""

from __future__ import annotations

import os
import re

import psutil

from tests.soak.watch import Series, grown


def series(last_MB: float, seconds: float = 100.0) -> Series:
    """Memory that rises from 50 MB to last_MB, everything else still."""
    count = 100
    made = Series([seconds * i / count for i in range(count)])
    made.values["memory_MB"] = [50.0 + (last_MB - 50.0) * i / count for i in range(count)]
    made.values["descriptors"] = made.values["threads"] = [7.0] * count
    return made


def test_a_rise_is_told_by_process_and_quantity() -> None:
    (complaint,) = grown({"recorder": series(60.0), "telemetry": series(51.0), "short": series(90.0, 10.0)})
    assert re.fullmatch(r"recorder: memory_MB rose by 5\.\d, at most 2 is allowed", complaint)


def test_a_process_without_a_sample_says_nothing() -> None:
    assert grown({"gone": Series()}) == []


def test_a_look_takes_one_sample_of_each_quantity() -> None:
    found = Series()
    found.look(psutil.Process(os.getpid()))
    assert len(found.t) == 1
    assert found.values["memory_MB"][0] > 1.0
    assert found.values["descriptors"][0] >= 3.0
    assert found.values["threads"][0] >= 1.0
