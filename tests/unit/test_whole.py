"""From rest to rest: real drivers, loops and sessions on emulated servos with a table, grippers and an object on it.

All in virtual time; `tests/process/run/test_run_whole.py` has the processes.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.modes import Mode
from agent.replay.chain import Chain
from drivers.interface import JointState
from tests.support.servos.whole_rig import WholeRun

QUICK = [
    "session.speed_max_rad_per_s=2.0", "session.back_off_m=0.04", "session.lift_m=0.015", "session.lift_s=1.0",
    "session.lower_s=1.2", "session.take_up_s=0.6", "session.ease_s=0.5", "duration_s=2.0",
]  # fmt: skip
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", QUICK)
STALL_CURRENT_SHARE = 0.4  # above it servos are reported to trip


@cache
def whole() -> WholeRun:
    return WholeRun(CELL)


def modes(run: WholeRun, arm: str) -> list[Mode]:
    return [mode for _, mode in run.arms[arm].modes]


def test_both_arms_go_from_rest_to_the_object_carry_it_and_come_back() -> None:
    run = whole()
    way = [
        Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.RELEASE, Mode.PARK,
        Mode.REST, Mode.OFF,
    ]  # fmt: skip
    assert {name: modes(run, name) for name in run.arms} == {"left": way, "right": way}
    assert {name: arm.summary.reason for name, arm in run.arms.items() if arm.summary} == {"left": "", "right": ""}
    assert not any(event.text for arm in run.arms.values() for event in arm.events if "fault" in event.text)


def test_the_object_is_carried_as_the_cell_asks_and_set_down_where_it_stood() -> None:
    run = whole()
    bounds = CELL.file.report
    for arm in run.arms.values():
        tracked = arm.rows[arm.rows["mode"] == Mode.TRACK]
        assert tracked["t"][-1] > CELL.file.duration_s - 0.02
        # the cell judges after its transient; at the start of the lift joints begin to turn, against their friction
        assert np.linalg.norm(tracked["e_p"], axis=1).max() < 2.0 * (bounds.max_position_error_m or 0.0)
        assert 2.0 * np.linalg.norm(tracked["e_eps"], axis=1).max() < 2.0 * (bounds.max_attitude_error_rad or 0.0)
        lifted = tracked["p_object"][:, 2].max() - CELL.file.p_place_m[2]
        assert lifted == pytest.approx(0.015, abs=1e-3)
    assert run.place is not None
    assert run.place[0] < 3e-3
    assert run.place[1] < 20e-3


def test_no_torque_steps_in_any_phase_and_no_servo_is_overloaded() -> None:
    for arm in whole().arms.values():
        rows, n = arm.rows, 3
        limits = arm.agent.limits
        steps = np.abs(np.diff(rows["tau_limited"][:, :n], axis=0))
        assert (steps <= np.array(limits.tau_step_max_Nm) + 1e-12).all()
        alone = np.isin(rows["mode"][1:], [Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK])
        assert (steps[alone] <= np.array(arm.agent.session.limits.tau_step_max_Nm) + 1e-12).all()
        share = np.abs(rows["tau_sent"][:, :n]) / np.array([8.2, 4.1, 4.1])
        assert np.nanmax(share) < STALL_CURRENT_SHARE
        bound = CELL.file.session.speed_max_rad_per_s if CELL.file.session else 0.0
        assert np.nanmax(np.abs(rows["dq_measured"][:, :n])) < 1.1 * bound


def test_a_session_replays_bit_for_bit_from_its_rows() -> None:
    run = whole().arms["left"]
    chain = Chain(run.agent)
    chain.start()
    for row in run.rows:
        state = JointState(int(row["stamp_ns"]), *(row[f][:3] for f in ("q_measured", "dq_measured", "tau_measured")))
        memory, outcome = chain.pass_row(state, float(row["t"]), Mode(int(row["mode"])), int(row["flags"]))
        assert np.array_equal(outcome.tau, row["tau_limited"][:3])
        assert np.array_equal(memory.flatten(), row["memory"])
