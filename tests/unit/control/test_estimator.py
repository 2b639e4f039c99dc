"""The joint observer, and the memory it lives in: exact on an exact model, better than raw servo values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.estimator import Observer
from agent.control.memory import MEMORY_JOINTS, Memory, initial, restore
from agent.loop import step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.telemetry.row.sample import MAX_JOINTS, MEMORY_LENGTH
from drivers.interface import JointState, Vector

PERIOD = 0.005
POSITION_STEP = 2 * np.pi / 4096
VELOCITY_STEP = 0.229 * 2 * np.pi / 60  # servos count 0.229 rpm
PAPER = configs.CELLS_DIR / "paper.toml"


def observer(delay_cycles: int = 0) -> Observer:
    """The gains that agents run with."""
    cell = load_cell(PAPER, ['controller.velocity="observer"'])
    found = build_agent(cell, cell.arms[0]).observer
    assert found is not None
    assert found.period_s == PERIOD
    return replace(found, delay_cycles=delay_cycles)


def accelerations(count: int) -> Vector:
    """(count, 2) rad/s², one per tick, constant within a tick."""
    t = np.arange(count) * PERIOD
    return np.stack([3.0 * np.sin(4.0 * t), 2.0 * np.cos(7.0 * t)], axis=1)


def motion(ddq: Vector) -> tuple[Vector, Vector]:
    """True (q, dq) at every tick of joints that really accelerate by ddq."""
    q, dq = np.zeros_like(ddq), np.zeros_like(ddq)
    for k in range(1, len(ddq)):
        q[k] = q[k - 1] + PERIOD * dq[k - 1] + 0.5 * PERIOD**2 * ddq[k - 1]
        dq[k] = dq[k - 1] + PERIOD * ddq[k - 1]
    return q, dq


def observe(law: Observer, q: Vector, dq: Vector, expected: Vector) -> tuple[Vector, Vector]:
    """Estimates at every tick; expected: the acceleration the law computes at each tick."""
    memory, found_q, found_dq = initial(q.shape[1]), [], []
    for k in range(len(q)):
        q_k, dq_k = law.correct(memory, q[k], dq[k])
        found_q.append(q_k)
        found_dq.append(dq_k)
        memory = Memory(q_k, dq_k, expected[k], memory.ddq, memory.tau, primed=True)
    return np.array(found_q), np.array(found_dq)


def test_the_first_tick_takes_the_measurement_as_it_is() -> None:
    q, dq = np.array([0.1, 0.2]), np.array([0.3, 0.4])
    found_q, found_dq = observer().correct(initial(2), q, dq)
    assert np.array_equal(found_q, q)
    assert np.array_equal(found_dq, dq)


def test_an_exact_model_leaves_no_error() -> None:
    ddq = accelerations(400)
    q, dq = motion(ddq)
    found_q, found_dq = observe(observer(), q, dq, ddq)
    assert np.abs(found_q - q).max() < 1e-12
    assert np.abs(found_dq - dq).max() < 1e-12


def test_an_exact_model_with_torque_one_cycle_late_leaves_no_error() -> None:
    """What the law computes at tick k moves the joint from tick k + 1 on."""
    expected = accelerations(400)
    happened = np.vstack([np.zeros((1, 2)), expected[:-1]])
    q, dq = motion(happened)
    found_q, found_dq = observe(observer(delay_cycles=1), q, dq, expected)
    assert np.abs(found_q - q).max() < 1e-12
    assert np.abs(found_dq - dq).max() < 1e-12


def test_the_delay_matters() -> None:
    expected = accelerations(400)
    q, dq = motion(np.vstack([np.zeros((1, 2)), expected[:-1]]))
    wrong = observe(observer(delay_cycles=0), q, dq, expected)[1] - dq
    assert np.abs(wrong).max() > 1e-4


def test_quantised_servo_values_give_a_better_velocity_than_raw() -> None:
    ddq = accelerations(2000)
    q, dq = motion(ddq)
    raw_q, raw_dq = POSITION_STEP * np.round(q / POSITION_STEP), VELOCITY_STEP * np.round(dq / VELOCITY_STEP)
    _, found = observe(observer(), raw_q, raw_dq, ddq)
    settled = slice(200, None)
    error, raw_error = ((v - dq)[settled].std() for v in (found, raw_dq))
    assert error < 0.6 * raw_error


def test_a_wrong_start_is_forgotten() -> None:
    """The observer is stable: an error of half a radian is gone after a second."""
    ddq = accelerations(400)
    q, dq = motion(ddq)
    law = observer()
    memory = Memory(q[0] + 0.5, dq[0] - 1.0, ddq[0], ddq[0], np.zeros(2), primed=True)
    for k in range(1, 200):
        q_k, dq_k = law.correct(memory, q[k], dq[k])
        memory = Memory(q_k, dq_k, ddq[k], memory.ddq, memory.tau, primed=True)
    assert np.abs(memory.q - q[199]).max() < 1e-6
    assert np.abs(memory.dq - dq[199]).max() < 1e-5


def random_memory(seed: int, n: int, hold: bool) -> Memory:
    rng = np.random.default_rng(seed)
    pose = (0.1, -0.2, 0.3, 0.5, -0.5, 0.5, -0.5) if hold else None
    return Memory(*rng.normal(size=(5, n)), primed=bool(seed % 2), hold=pose)


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("n", [3, 6, 7])
@pytest.mark.parametrize("seed", [0, 1])
def test_memory_survives_the_log(seed: int, n: int, hold: bool) -> None:
    memory = random_memory(seed, n, hold)
    flat = np.array(memory.flatten())
    assert len(flat) == MEMORY_LENGTH
    found = restore(flat, n)
    for name in ("q", "dq", "ddq", "ddq_before", "tau"):
        assert np.array_equal(getattr(found, name), getattr(memory, name))
    assert (found.primed, found.hold) == (memory.primed, memory.hold)
    assert np.array_equal(restore(np.array(found.flatten()), n).flatten(), flat)


def test_memory_and_log_agree_on_the_room_per_joint_array() -> None:
    assert MEMORY_JOINTS == MAX_JOINTS


@pytest.mark.parametrize("mode", [Mode.TRACK, Mode.HOLD])
@pytest.mark.parametrize("source", ["servo", "observer"])
def test_step_from_a_restored_memory_gives_the_same_bits(source: str, mode: Mode) -> None:
    cell = load_cell(Path(PAPER), [f'controller.velocity="{source}"'])
    agent = build_agent(cell, cell.arms[0])
    q = np.array(cell.arms[0].entry.q_near_rad)
    memory = initial(3)
    for k in range(12):
        state = JointState(k, q + 0.001 * k, 0.1 * np.ones(3), np.zeros(3))
        if k == 6:
            memory = memory._replace(hold=(0.3, 0.12, 0.0, 1.0, 0.0, 0.0, 0.0))
        restored = restore(np.array(memory.flatten()), 3)
        one, two = (step(agent, state, PERIOD * k, mode, m) for m in (memory, restored))
        assert one.tau.tobytes() == two.tau.tobytes()
        assert one.memory.flatten() == two.memory.flatten()
        memory = one.memory
