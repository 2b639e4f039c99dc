"""From rest to the object and back as `coop run` does it: real processes, the words over their sockets, real time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import configs
from agent.log.read import read_log
from tests.support.command import coop as line
from tests.support.coop import coop
from tests.support.stalls import ATTEMPTS, stalled

CELL = configs.CELLS_DIR / "two_wx200.toml"
pytestmark = pytest.mark.realtime
WAY = ("REST", "APPROACH", "GRASP", "READY", "TRACK", "HOLD", "LOWER", "RELEASE", "PARK", "REST")
QUICK = ("--duration", "4", "--set", "session.speed_max_rad_per_s=1.2", "--set", "session.lower_s=2.0", "--no-report")


@pytest.mark.timeout(400)
def test_two_arms_go_to_the_object_carry_it_and_come_back(tmp_path: Path) -> None:
    """A control loop at 200 Hz says nothing on a machine that stops for 50 ms: such a run is repeated."""
    why = failed = ""
    for attempt in range(ATTEMPTS):
        out = tmp_path / str(attempt)
        done = coop("run", CELL, "--wire", "--whole", *QUICK, "--out", out)
        why = stalled(read_log(out / "run.mcap")) if (out / "run.mcap").exists() else ""
        if why:
            continue
        if done.returncode != 0:  # a machine that stalls may end a run; a defect ends all of them
            failed = done.stderr
            continue
        results = json.loads((out / "results.json").read_text())
        for arm in ("left", "right"):
            mine = [phase for phase in results["phases"] if phase["arm"] == arm]
            assert tuple(phase["name"] for phase in mine) == WAY
            assert [phase["outcome"] for phase in mine][-2:] == ["back at rest", "torque off"]
        assert results["set_down_error_m"] <= 3e-3
        assert results["set_down_error_rad"] <= 20e-3
        return
    assert not failed, failed
    pytest.skip(f"this machine stalled in each of {ATTEMPTS} runs (the last one: {why})")


def test_a_whole_run_without_emulated_servos_is_refused_in_one_line(tmp_path: Path) -> None:
    done = line("run", CELL, "--whole", "--out", tmp_path / "out")
    assert done.code == 2
    assert "found a run in lockstep, expected emulated servos, which have grippers; add --wire" in done.err
