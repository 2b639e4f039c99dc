"""The log row of one tick: every field holds its own number, and never that of another tick."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.adaptation import Estimate
from agent.control.against import pull_of
from agent.control.borne import Borne
from agent.control.brace import Braced
from agent.control.errors import Errors
from agent.control.knock import Struck
from agent.control.memory import Memory, initial, restore
from agent.control.models import Kinematics
from agent.control.residual import Sense
from agent.control.terms import JOINT_TERMS, Terms
from agent.control.touch import Plain
from agent.control.trajectory import Desired
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, MAX_JOINTS
from drivers.interface import BusCounters, JointState

SENTINEL = 123.0
OF_THE_LAW = (*JOINT_TERMS, "wrench_cmd", "wrench_internal")
MEMORY = initial(3)


def agent() -> tuple[Agent, JointState]:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    q = np.array(cell.arms[0].entry.q_near_rad)
    return build_agent(cell, cell.arms[0]), JointState(5_000_000, q, 0.1 * q, np.array([0.1, np.nan, 0.3]))


def fresh(joint_count: int = 3) -> tuple[np.ndarray, AgentRow]:
    message = np.zeros(1, dtype=AGENT_STATE.dtype)
    return message, AgentRow(message, joint_count, 0xABCD)


def fill(row: AgentRow, outcome: Outcome, state: JointState, memory: Memory = MEMORY) -> None:
    row.fill(7, 0.005, 11, Mode.TRACK, state, memory, outcome, outcome.tau + 0.5)
    row.fill_timing(0.1, 0.2, 0.3, 0.4, BusCounters(1, 2, 3, 4))


def all_different(n: int) -> tuple[JointState, Memory, Outcome]:
    """A tick of n joints in which no two numbers are equal."""
    numbers = count(1.25)

    def tuple_of(length: int) -> tuple[float, ...]:
        return tuple(next(numbers) for _ in range(length))

    def array_of(length: int) -> np.ndarray:
        return np.array(tuple_of(length))

    desired = Desired(tuple_of(3), tuple_of(4), tuple_of(6), tuple_of(6))
    unused = [np.empty(0)] * 6
    kinematics = Kinematics(tuple_of(3), tuple_of(4), (), tuple_of(6), *unused, tuple_of(3))
    errors = Errors(tuple_of(3), next(numbers), tuple_of(3), tuple_of(6), tuple_of(6), tuple_of(6), tuple_of(6))
    joints = array_of((len(JOINT_TERMS) + 1) * n).reshape(-1, n)
    terms = Terms(desired, kinematics, errors, joints, tuple_of(6), tuple_of(6), next(numbers), next(numbers), None)
    estimate = Estimate(array_of(16 * n), array_of(10))
    arrays = [array_of(n) for _ in range(6)]
    pull, plain = pull_of(tuple_of(14)), Plain(array_of(n), next(numbers))
    wrenches = array_of(6), array_of(6), array_of(6)
    struck, borne, braced = Struck(*tuple_of(5)), Borne(*tuple_of(4)), Braced(*tuple_of(5))
    sense = Sense(array_of(n), array_of(n), array_of(n), *wrenches, next(numbers), pull, plain, struck, borne)
    memory = Memory(
        *arrays, True, sense, tuple_of(6), 103, tuple_of(7), next(numbers), estimate, array_of(n), next(numbers), 19,
        braced, next(numbers), tuple_of(6),
    )  # fmt: skip
    state = JointState(5_000_000, array_of(n), array_of(n), array_of(n))
    flags = Flag.SATURATED | Flag.STALE
    return state, memory, Outcome(array_of(n), array_of(n), terms, array_of(n), flags, memory, tuple_of(10))


def good_and_bad() -> tuple[JointState, Outcome, Outcome]:
    arm, state = agent()
    memory = initial_memory(arm)
    good = step(arm, state, 0.005, Mode.TRACK, memory)
    bad = step(arm, replace(state, q=np.full(3, np.nan)), 0.005, Mode.TRACK, memory)
    return state, good, bad


def check(
    found: np.void,
    state: JointState,
    memory: Memory,
    outcome: Outcome,
    bridged: tuple[object, object, float] = ((0.0,), (0.0,), 0.0),
) -> None:
    """Every field of the row has its own number of the tick, and zeros behind it."""
    terms = outcome.terms
    e, k, d = terms.errors, terms.kinematics, terms.desired
    estimate = memory.estimate or Estimate(np.zeros(1), np.zeros(10))
    expected = {
        "encapsulation": CDR_LITTLE_ENDIAN, "sequence": 7, "stamp_ns": 5_000_000, "utc_ns": 11, "mode": Mode.TRACK,
        "flags": outcome.flags, "joint_count": len(state.q), "config_id": 0xABCD, "t": 0.005, "q_measured": state.q,
        "dq_measured": state.dq, "tau_measured": state.tau, "q": outcome.q, "dq": outcome.dq, "p_object_des": d.p,
        "quat_object_des": d.quat, "v_object_des": d.v, "a_object_des": d.a, "p_object": k.p_object,
        "quat_object": k.quat_object, "v_object": k.v_object, "e_p": e.e_p, "e_eta": e.e_eta, "e_eps": e.e_eps,
        "e_v": e.e_v, "v_object_ref": e.v_ref, "dv_object_ref": e.dv_ref, "lyapunov": terms.lyapunov,
        "sigma_min": terms.sigma_min, "tau_limited": outcome.tau, "tau_sent": outcome.tau + 0.5,
        "shift": memory.shift, "friction_factor": memory.friction_factor,
        "unexpected_wrench": (np.nan,) * 6 if outcome.sensed is None else outcome.sensed[:6],
        "unexpected": (np.nan,) * 4 if outcome.sensed is None else outcome.sensed[6:],
        "memory": memory.flatten(), "late_s": 0.1, "read_s": 0.2, "step_s": 0.3, "write_s": 0.4,
        "bus_timeouts": 1, "bus_corrupt": 2, "bus_alerts": 3, "bus_retries": 4,
        "theta_arm": estimate.arm, "theta_object": estimate.object,
        "tau_bridge": bridged[0], "q_twin": bridged[1], "twin_age_s": bridged[2],
        **{name: getattr(terms, name) for name in OF_THE_LAW},
    }  # fmt: skip
    assert set(expected) == set(AGENT_STATE.dtype.names)
    for name, value in expected.items():
        wanted = np.zeros(np.shape(found[name]))
        wanted[tuple(slice(n) for n in np.shape(value))] = value
        assert np.array_equal(np.asarray(found[name], dtype=float), wanted, equal_nan=True), name


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_every_number_of_a_tick_lands_in_its_own_field(n: int) -> None:
    message, row = fresh(n)
    state, memory, outcome = all_different(n)
    fill(row, outcome, state, memory)
    check(message[0], state, memory, outcome)
    added, q_twin = np.arange(1.0, n + 1.0), np.arange(21.0, n + 21.0)
    row.fill_bridge(outcome.tau + 0.5, added, q_twin, 0.007)
    check(message[0], state, memory, outcome, (added, q_twin, 0.007))


def test_every_field_is_what_a_real_tick_gave() -> None:
    state, outcome, _ = good_and_bad()
    message, row = fresh()
    fill(row, outcome, state)
    check(message[0], state, MEMORY, outcome)


@pytest.mark.parametrize("term", JOINT_TERMS)
def test_a_term_that_the_law_does_not_have_is_zero_though_the_tick_before_had_it(term: str) -> None:
    message, row = fresh()
    state, memory, outcome = all_different(3)
    fill(row, outcome, state, memory)
    joints = outcome.terms.joints.copy()
    joints[JOINT_TERMS.index(term)] = 0.0
    without = outcome._replace(terms=outcome.terms._replace(joints=joints))
    fill(row, without, state, memory)
    check(message[0], state, memory, without)
    assert not message[0][term].any()


@pytest.mark.parametrize("term", JOINT_TERMS)
def test_a_joint_term_of_the_law_is_the_row_of_the_block_that_has_its_name(term: str) -> None:
    terms = all_different(3)[2].terms
    assert np.array_equal(getattr(terms, term), terms.joints[JOINT_TERMS.index(term)])


def test_what_the_residual_holds_is_written_again_when_it_changes() -> None:
    message, row = fresh()
    state, memory, outcome = all_different(3)
    for sense in (memory.sense, memory.sense._replace(ticks=0.5), MEMORY.sense, memory.sense):
        now = memory._replace(sense=sense)
        fill(row, outcome, state, now)
        check(message[0], state, now, outcome)


def test_a_tick_without_a_law_shows_none_of_the_tick_before() -> None:
    state, good, bad = good_and_bad()
    assert bad.terms is None
    message, row = fresh()
    fill(row, good, state)
    fill(row, bad, state)
    found = message[0]
    names = [f.name for f in AGENT_STATE.fields]
    for name in names[names.index("p_object_des") : names.index("sigma_min") + 1]:
        if name not in ("tau_limited", "tau_sent"):
            values = found[name][:3] if found[name].shape == (MAX_JOINTS,) else found[name]
            assert np.isnan(values).all(), name
        if found[name].shape == (MAX_JOINTS,):
            assert not found[name][3:].any(), name
    assert found["flags"] == Flag.NOT_FINITE
    assert np.array_equal(found["tau_limited"][:3], bad.tau)
    assert restore(found["memory"], 3).flatten() == MEMORY.flatten()


def test_a_tick_after_one_without_a_law_shows_nothing_of_it() -> None:
    state, good, bad = good_and_bad()
    once, row = fresh()
    fill(row, good, state)
    message, row = fresh()
    for outcome in (bad, good):
        fill(row, outcome, state)
    assert message.tobytes() == once.tobytes()


@pytest.mark.parametrize("joint_count", [3, 6])
def test_joints_that_are_not_there_are_zero(joint_count: int) -> None:
    message = np.zeros(1, dtype=AGENT_STATE.dtype)
    for field in AGENT_STATE.fields:
        message[field.name] = SENTINEL
    AgentRow(message, joint_count, 0)
    for field in AGENT_STATE.fields:
        if field.length == MAX_JOINTS:
            assert not message[0][field.name][joint_count:].any()
