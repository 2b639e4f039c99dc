"""From rest to the object and back as `coop run` does it: real processes, the words over their sockets, real time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import configs
from agent.log.read import RunLog
from tests.support.command import coop
from tests.support.stalls import stalled

CELL = configs.CELLS_DIR / "two_wx200.toml"
pytestmark = pytest.mark.realtime
WAY = ("REST", "APPROACH", "GRASP", "READY", "TRACK", "HOLD", "LOWER", "RELEASE", "PARK", "REST")


@pytest.mark.timeout(400)
def test_two_arms_go_to_the_object_carry_it_and_come_back(whole_run: tuple[Path, RunLog]) -> None:
    out, log = whole_run
    results = json.loads((out / "results.json").read_text())
    for arm in ("left", "right"):
        mine = [phase for phase in results["phases"] if phase["arm"] == arm]
        assert tuple(phase["name"] for phase in mine) == WAY
        assert [phase["outcome"] for phase in mine][-2:] == ["back at rest", "torque off"]
    good = results["set_down_error_m"] <= 3e-3 and results["set_down_error_rad"] <= 20e-3
    if not good and (why := stalled(log)):
        pytest.skip(f"this machine stalled, and the error of such a run says nothing: {why}")
    assert good, results


def test_a_whole_run_without_emulated_servos_is_refused_in_one_line(tmp_path: Path) -> None:
    done = coop("run", CELL, "--whole", "--out", tmp_path / "out")
    assert done.code == 2
    assert "found a run in lockstep, expected emulated servos, which have grippers; add --wire" in done.err
