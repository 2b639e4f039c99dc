"""A servo that fails in `coop run --wire`: the fault file reaches the emulator, the agent names the servo, both hold.

Every kind of fault in virtual time: `tests/unit/test_lost_servo.py`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.log.read import RunLog, read_log
from agent.modes import Mode
from tests.support.command import coop as line
from tests.support.coop import coop
from tests.support.stalls import Kernel, Stalled, stalled

CELL = configs.CELLS_DIR / "two_wx200.toml"
# of the emulator's time, which begins some four seconds before the trajectory: later where the arms took longer
FAULT_S = (6.5, 10.0, 16.0)  # by attempt
BEGIN_S = 2.0  # of the emulator's time: no trajectory begins sooner
SEEN_S = 1.0  # the neighbour takes up to 0.8 s to notice where the object turns round, at 3.7 to 5.2 s
BEFORE_HOLD_S = 0.1  # the silence of the servo itself is within


def run(folder: Path, fault_s: float) -> RunLog:
    """Until the neighbour must have noticed, however soon the trajectory began.  Raises Stalled."""
    folder.mkdir()
    kernel = Kernel()
    fault = {"arm": "left", "start_s": fault_s, "kind": "power_loss", "servo": 4}
    (folder / "faults.jsonl").write_text(json.dumps(fault))
    done = coop(
        "run", CELL, "--wire", "--duration", fault_s - BEGIN_S + SEEN_S, "--out", "out", "--faults", "faults.jsonl",
        "--no-report", "--set", "report.transient_s=1", "--set", "safety.tracking_error_max_m=0.02", cwd=folder,
    )  # fmt: skip
    if done.returncode not in (0, 5) and (why := kernel.accuses()):
        raise Stalled(f"{why}: {done.stderr}")
    assert done.returncode in (0, 5), done.stderr  # 5: the arm was given up before the run was over
    return read_log(folder / "out" / "run.mcap")


@pytest.mark.long  # in virtual time: tests/unit/test_lost_servo.py
@pytest.mark.realtime
@pytest.mark.timeout(400)
def test_a_lost_servo_is_named_and_both_arms_hold(tmp_path: Path) -> None:
    """A run that the machine stalled before the fault is repeated: the object is off its track without any.

    So is one whose motion began when the fault was there, or hardly before: not for ever.
    """
    why = ""
    for attempt, fault_s in enumerate(FAULT_S):
        try:
            log = run(tmp_path / str(attempt), fault_s)
        except Stalled as stall:
            why = str(stall)
            continue
        left = log.agents["left"]
        held_s = left["t"][left["mode"] == Mode.HOLD]
        why = stalled(log, held_s[0] - BEFORE_HOLD_S) if len(held_s) else stalled(log)
        early = not (left["mode"] == Mode.TRACK).any() or (held_s[:1] < SEEN_S).any()
        if not why and not (early and fault_s < FAULT_S[-1]):
            told = [e.text for e in log.events if e.source == "left" and e.text.startswith("holds: ")]
            assert told, "it goes on with a servo that has no power"
            assert "servo 4 (elbow)" in told[0]
            assert log.agents["right"]["mode"][-1] == Mode.HOLD, "the object tells the neighbour"
            for rows in log.agents.values():
                held = np.flatnonzero(rows["mode"] == Mode.HOLD)
                assert set(rows["mode"][held[0] :]) <= {Mode.HOLD, Mode.FAULT}, "HOLD leads to no motion"
            return
    pytest.skip(f"this machine stalled in the last of {len(FAULT_S)} runs ({why})")


def test_faults_without_emulated_servos_are_refused(tmp_path: Path) -> None:
    (tmp_path / "faults.jsonl").write_text("")
    done = line("run", CELL, "--faults", "faults.jsonl", cwd=tmp_path)
    assert done.code == 2
    assert "add --wire" in done.err
    assert not (tmp_path / "runs").exists()
