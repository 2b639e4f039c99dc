"""P1, P2 in virtual time: agents that die or hang anywhere in a cycle while two arms carry an object.

Real drivers, loops and the guards' own steps on emulated servos; `tests/process/run/test_guard.py` has the processes.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.servos.guarded_rig import End, Guarded, GuardedRun

FROM_DEATH_NS, FROM_HEARTBEAT_NS = 20_000_000, 35_000_000
MOVES_MAX_M = 5e-3
UNTIL_S = 1.2
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["duration_s=1.2"])
STEP_MAX_NM = build_agent(CELL, CELL.arms[0]).limits.tau_step_max_Nm


def first_torque_ns(run: Guarded) -> int:
    return min(ns for ns in run.torques_ns if ns > run.died_ns)


def check_hold(run: Guarded) -> None:
    rows, k = run.rows, run.rows_of_agent
    assert (rows["mode"][k:] == Mode.HOLD).all()
    assert (rows["sequence"] == np.arange(len(rows))).all(), "one ring, no row twice"
    assert run.held is not None
    assert (np.abs(rows["tau_limited"][k, :3] - run.held) <= np.array(STEP_MAX_NM) + 0.01).all()
    moved = np.linalg.norm(rows["p_object"][k:] - rows["p_object"][k - 1], axis=1)
    assert moved.max() <= MOVES_MAX_M, f"{moved.max() * 1e3:.1f} mm"
    assert np.abs(rows["t"][k] - rows["t"][k - 1]) < 0.05, "the trajectory's zero is the agent's"


@pytest.mark.fault("P1")
@pytest.mark.fault("P2")
@pytest.mark.parametrize("seed", [1])
def test_guards_go_on_within_the_bounds_wherever_in_a_cycle_their_agents_end(seed: int) -> None:
    chance = random.Random(seed)
    ends = {"left": End(chance.uniform(0.5, 0.9)), "right": End(chance.uniform(0.5, 0.9), hangs=True)}
    arms = GuardedRun(CELL, ends, UNTIL_S).arms
    left, right = arms["left"], arms["right"]
    assert isinstance(left, Guarded)
    assert isinstance(right, Guarded)
    for run in (left, right):
        check_hold(run)
    assert first_torque_ns(left) - left.died_ns <= FROM_DEATH_NS
    assert first_torque_ns(right) - right.row_ns <= FROM_HEARTBEAT_NS
    assert first_torque_ns(right) - right.row_ns > 15_000_000, "not before it is plain that the agent hangs"


def test_an_agent_that_dies_before_the_start_is_held_where_it_waited() -> None:
    arms = GuardedRun(CELL, {"left": End(-0.1213)}, until_s=0.4).arms
    left = arms["left"]
    assert isinstance(left, Guarded)
    check_hold(left)
    assert left.rows["mode"][left.rows_of_agent - 1] == Mode.READY


def jumps(at_s: float) -> list[Fault]:
    """An encoder of the left arm jumps by half a turn, and stays there."""
    return [Fault(kind=FaultKind.ENCODER_OFFSET, arm="left", servo=2, offset_ticks=2048, start_s=at_s)]


@pytest.mark.fault("S5")
def test_no_torque_is_made_of_an_encoder_that_jumps_as_the_agent_dies() -> None:
    left = GuardedRun(CELL, {"left": End(0.7)}, UNTIL_S, jumps(0.7)).arms["left"]
    assert isinstance(left, Guarded)
    rows, k = left.rows, left.rows_of_agent
    assert (rows["flags"][k:] & Flag.STALE).all(), "nothing of it was believed"
    sent = rows["tau_sent"][k:, :3]
    assert np.nanmax(np.abs(sent - rows["tau_sent"][k - 1, :3])) < 0.2, "until nothing is sent, and its servos let go"
    assert np.isnan(sent[-1]).all()


@pytest.mark.fault("S5")
def test_an_arm_that_is_limp_because_its_encoder_has_jumped_is_not_brought_back_by_its_guard_either() -> None:
    left = GuardedRun(CELL, {"left": End(1.0)}, UNTIL_S, jumps(0.3)).arms["left"]
    assert isinstance(left, Guarded)
    assert left.summary is not None
    assert left.summary.mode is Mode.FAULT
    assert "it had not seen the arm: its servos have let go" in left.summary.reason
    assert not any(ns > left.died_ns for ns in left.torques_ns)
