"""When a log is followed by the next one, and what that is called."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.log.parts import Limits, next_path


@pytest.mark.parametrize(
    ("limits", "size", "age_s", "reached"),
    [
        (Limits(), 1 << 60, 1e9, False),
        (Limits(part_bytes=100), 99, 1e9, False),
        (Limits(part_bytes=100), 100, 0.0, True),
        (Limits(part_s=60.0), 1 << 60, 59.9, False),
        (Limits(part_s=60.0), 0, 60.0, True),
        (Limits(part_bytes=100, part_s=60.0), 100, 1.0, True),
    ],
)
def test_a_log_ends_at_its_size_or_age_whichever_comes_first(
    limits: Limits, size: int, age_s: float, reached: bool
) -> None:
    assert limits.reached(size, age_s) == reached


def test_the_next_log_has_the_next_free_name(tmp_path: Path) -> None:
    first = tmp_path / "run.mcap"
    assert next_path(first).name == "run_2.mcap"
    (tmp_path / "run_2.mcap").touch()
    assert next_path(first) == tmp_path / "run_3.mcap"
    (tmp_path / "run_3.mcap").symlink_to("nothing")
    assert next_path(first) == tmp_path / "run_4.mcap"
