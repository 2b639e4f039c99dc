"""The log row of one tick: every field holds its own number, and never that of another tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.law import Terms
from agent.control.memory import initial, restore
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, MAX_JOINTS
from drivers.interface import BusCounters, JointState

SENTINEL = 123.0
OF_THE_LAW = [
    name for name in Terms._fields if name not in ("desired", "kinematics", "errors", "lyapunov", "sigma_min")
]


def agent() -> tuple[Agent, JointState]:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    q = np.array(cell.arms[0].entry.q_near_rad)
    return build_agent(cell, cell.arms[0]), JointState(5_000_000, q, 0.1 * q, np.array([0.1, np.nan, 0.3]))


def fresh(joint_count: int = 3) -> tuple[np.ndarray, AgentRow]:
    message = np.zeros(1, dtype=AGENT_STATE.dtype)
    return message, AgentRow(message, joint_count, 0xABCD)


def fill(row: AgentRow, outcome: Outcome, state: JointState, sequence: int = 7) -> None:
    memory = initial(3)
    row.fill_state(sequence, 0.005, 11, Mode.TRACK, state)
    row.fill_law(outcome.q, outcome.dq, outcome.terms, memory)
    row.fill_output(outcome.flags, outcome.tau, outcome.tau + 0.5)
    row.fill_timing(0.1, 0.2, 0.3, 0.4, BusCounters(1, 2, 3, 4))


def good_and_bad() -> tuple[JointState, Outcome, Outcome]:
    arm, state = agent()
    memory = initial_memory(arm)
    good = step(arm, state, 0.005, Mode.TRACK, memory)
    bad = step(arm, replace(state, q=np.full(3, np.nan)), 0.005, Mode.TRACK, memory)
    return state, good, bad


def test_every_field_is_what_the_tick_gave() -> None:
    state, outcome, _ = good_and_bad()
    message, row = fresh()
    fill(row, outcome, state)
    found, terms = message[0], outcome.terms
    e, k, d = terms.errors, terms.kinematics, terms.desired
    expected = {
        "encapsulation": CDR_LITTLE_ENDIAN, "sequence": 7, "stamp_ns": 5_000_000, "utc_ns": 11, "mode": Mode.TRACK,
        "flags": outcome.flags, "joint_count": 3, "config_id": 0xABCD, "t": 0.005, "q_measured": state.q,
        "dq_measured": state.dq, "tau_measured": state.tau, "q": outcome.q, "dq": outcome.dq, "p_object_des": d.p,
        "quat_object_des": d.quat, "v_object_des": d.v, "a_object_des": d.a, "p_object": k.p_object,
        "quat_object": k.quat_object, "v_object": k.v_object, "e_p": e.e_p, "e_eta": e.e_eta, "e_eps": e.e_eps,
        "e_v": e.e_v, "v_object_ref": e.v_ref, "dv_object_ref": e.dv_ref, "lyapunov": terms.lyapunov,
        "sigma_min": terms.sigma_min, "tau_limited": outcome.tau, "tau_sent": outcome.tau + 0.5,
        "memory": initial(3).flatten(), "late_s": 0.1, "read_s": 0.2, "step_s": 0.3, "write_s": 0.4,
        "bus_timeouts": 1, "bus_corrupt": 2, "bus_alerts": 3, "bus_retries": 4, "theta_arm": 0.0, "theta_object": 0.0,
        **{name: getattr(terms, name) for name in OF_THE_LAW},
    }  # fmt: skip
    assert set(expected) == set(AGENT_STATE.dtype.names)
    for name, value in expected.items():
        wanted = np.zeros(np.shape(found[name]))
        wanted[tuple(slice(n) for n in np.shape(value))] = 0.0 if value is None else value
        assert np.array_equal(np.asarray(found[name], dtype=float), wanted, equal_nan=True), name


def test_a_tick_without_a_law_shows_none_of_the_tick_before() -> None:
    state, good, bad = good_and_bad()
    assert bad.terms is None
    message, row = fresh()
    fill(row, good, state)
    fill(row, bad, state)
    found = message[0]
    for name in ("p_object_des", "v_object_ref", "tau_cmd", "tau_internal", "wrench_cmd", "lyapunov", "sigma_min"):
        assert np.isnan(found[name][:3] if found[name].ndim else found[name]).all(), name
    assert found["flags"] == Flag.NOT_FINITE
    assert np.array_equal(found["tau_limited"][:3], bad.tau)
    assert restore(found["memory"], 3).flatten() == initial(3).flatten()


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
