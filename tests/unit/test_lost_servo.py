"""A servo that fails while two arms carry an object: named by its arm, held, seen by the neighbour through the object.

Real drivers, loops and emulated servos, in virtual time; `tests/process/run/test_run_faults.py` has the processes.
"""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.modes import Mode
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.servos.coupled_rig import CoupledRun

FAULT_S, DURATION_S, GIVEN_UP_S = 0.4, 1.8, 1.7


def cell(duration_s: float = DURATION_S) -> Cell:
    return load_cell(
        configs.CELLS_DIR / "two_wx200.toml",
        [f"duration_s={duration_s}", "safety.tracking_error_max_m=0.02", "safety.recover_s=0.4"],
    )


@pytest.mark.long  # tests/unit/faults/test_bench.py has two arms without a fault
def test_without_a_fault_both_arms_follow_to_the_end() -> None:
    arms = CoupledRun(cell(1.0)).arms
    for run in arms.values():
        assert run.summary is not None
        assert (run.summary.mode, run.summary.reason) == (Mode.TRACK, "")
        assert (run.summary.late_cycles, run.summary.stale_cycles) == (0, 0)
        tracked = run.rows[run.rows["mode"] == Mode.TRACK]
        assert np.abs(np.diff(tracked["t"]) - cell().period_ns * 1e-9).max() < 1e-4
        assert tracked["t"][-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "servo", "named", "ends", "noticed_s"),
    [
        (FaultKind.POWER_LOSS, 4, "servo 4 (joint elbow)", Mode.FAULT, 0.15),  # nobody sees this joint any more
        # an arm that holds is in the way of a motion that has just begun: 1.6 N, of which half a second says nothing
        pytest.param(FaultKind.OVERLOAD, 2, "servo 2 (shoulder)", Mode.HOLD, 1.2, marks=pytest.mark.long),
        pytest.param(FaultKind.REBOOT, 5, "servo 5 (wrist_angle)", Mode.HOLD, 1.2, marks=pytest.mark.long),
    ],
    ids=["power", "overload", "reboot"],
)
@pytest.mark.fault("S1")
def test_a_lost_servo_is_named_and_both_arms_hold(
    kind: FaultKind, servo: int, named: str, ends: Mode, noticed_s: float
) -> None:
    seen_s = GIVEN_UP_S if ends is Mode.FAULT else DURATION_S
    arms = CoupledRun(cell(seen_s), [Fault(kind=kind, arm="left", servo=servo, start_s=FAULT_S)], ready_s=0.05).arms
    left, right = arms["left"], arms["right"]
    assert left.summary is not None
    assert right.summary is not None
    assert left.summary.mode is ends
    assert named in left.summary.reason
    assert right.summary.mode is Mode.HOLD, "the object tells the neighbour"
    assert "UNEXPECTED" in right.summary.reason
    begins = {}
    for name, run in arms.items():
        rows = run.rows
        sent = rows["tau_sent"][:, :3]
        assert np.nanmax(np.abs(sent[:, 0])) <= 4.1 + 1e-6
        assert np.nanmax(np.abs(sent[:, 1:])) <= 2.05 + 1e-6
        held = np.flatnonzero(rows["mode"] == Mode.HOLD)
        assert (rows["mode"][held[0] :] == Mode.HOLD).all(), "HOLD is left by nobody but an operator"
        begins[name] = rows["t"][held[0]]
    assert FAULT_S < begins["left"] <= FAULT_S + 0.05
    assert begins["left"] < begins["right"] < FAULT_S + noticed_s
