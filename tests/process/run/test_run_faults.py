"""A servo that fails while the object is carried: named by its arm, held, seen by the neighbour through the object."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.log.read import read_log
from agent.modes import Mode
from tests.support.coop import coop

CELL = configs.CELLS_DIR / "two_wx200.toml"
FAULT_S = 12.0  # of the emulator's time, which begins some seconds before the trajectory

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ({"kind": "power_loss", "servo": 4}, "servo 4 (elbow)"),
        ({"kind": "overload", "servo": 2}, "servo 2 (shoulder)"),
        ({"kind": "reboot", "servo": 5}, "servo 5 (wrist_angle)"),
    ],
    ids=["power", "overload", "reboot"],
)
def test_a_lost_servo_is_named_and_both_arms_hold(tmp_path: Path, fault: dict[str, object], named: str) -> None:
    (tmp_path / "faults.jsonl").write_text(json.dumps({"arm": "left", "start_s": FAULT_S, **fault}))
    done = coop(
        "run", CELL, "--wire", "--duration", "15", "--out", "out", "--faults", "faults.jsonl",
        "--set", "report.transient_s=1", "--set", "safety.tracking_error_max_m=0.02", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    log = read_log(tmp_path / "out" / "run.mcap")
    left, right = log.agents["left"], log.agents["right"]
    assert left["mode"][-1] == Mode.HOLD
    assert right["mode"][-1] == Mode.HOLD, "the object tells the neighbour"
    told = [e.text for e in log.events if e.source == "left" and e.text.startswith("run ended in HOLD")]
    assert named in told[0]
    for rows in (left, right):
        sent = rows["tau_sent"][:, :3]
        assert np.nanmax(np.abs(sent[:, 0])) <= 4.1 + 1e-6
        assert np.nanmax(np.abs(sent[:, 1:])) <= 2.05 + 1e-6
        held = np.flatnonzero(rows["mode"] == Mode.HOLD)
        assert (rows["mode"][held[0] :] == Mode.HOLD).all(), "HOLD is left by nobody but an operator"


def test_faults_without_emulated_servos_are_refused(tmp_path: Path) -> None:
    (tmp_path / "faults.jsonl").write_text("")
    done = coop("run", CELL, "--faults", "faults.jsonl", cwd=tmp_path)
    assert done.returncode == 2
    assert "add --wire" in done.stderr
    assert not (tmp_path / "runs").exists()
