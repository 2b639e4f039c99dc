"""The joint observer, and the memory it lives in: exact on an exact model, better than raw servo values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.against import pull_of
from agent.control.borne import Borne
from agent.control.brace import Braced
from agent.control.estimator import Observer
from agent.control.knock import NOT_STRUCK, Struck
from agent.control.memory import MEMORY_JOINTS, Memory, initial, restore
from agent.control.residual import Sense
from agent.control.touch import PLAIN_JOINTS, Plain
from agent.loop import step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.telemetry.row.sample import MAX_JOINTS, MEMORY_LENGTH
from drivers.interface import JointState, Vector

PERIOD = 0.005
POSITION_STEP = 2 * np.pi / 4096
VELOCITY_STEP = 0.229 * 2 * np.pi / 60  # servos count 0.229 rpm
PAPER = configs.CELLS_DIR / "paper.toml"


def observer(delay_periods: float = 0.0) -> Observer:
    """The gains that agents run with."""
    cell = load_cell(PAPER, ['controller.velocity="observer"'])
    found = build_agent(cell, cell.arms[0]).observer
    assert found is not None
    assert found.period_s == PERIOD
    return replace(found, delay_periods=delay_periods)


def accelerations(count: int) -> Vector:
    """(count, 2) rad/s², one per tick, constant within a tick."""
    t = np.arange(count) * PERIOD
    return np.stack([3.0 * np.sin(4.0 * t), 2.0 * np.cos(7.0 * t)], axis=1)


def motion(ddq: Vector, delay_periods: float = 0.0) -> tuple[Vector, Vector]:
    """True (q, dq) at every tick of joints that accelerate by ddq, each one delay_periods after its tick."""
    q, dq = np.zeros_like(ddq), np.zeros_like(ddq)
    for k in range(1, len(ddq)):
        q_now, dq_now = q[k - 1], dq[k - 1]
        before = ddq[k - 2] if k > 1 else np.zeros_like(ddq[0])
        for h, a in ((delay_periods * PERIOD, before), ((1.0 - delay_periods) * PERIOD, ddq[k - 1])):
            q_now, dq_now = q_now + h * dq_now + 0.5 * h**2 * a, dq_now + h * a
        q[k], dq[k] = q_now, dq_now
    return q, dq


def observe(law: Observer, q: Vector, dq: Vector, expected: Vector) -> tuple[Vector, Vector]:
    """Estimates at every tick; expected: the acceleration the law computes at each tick."""
    memory, found_q, found_dq = initial(q.shape[1]), [], []
    for k in range(len(q)):
        q_k, dq_k = law.correct(memory, q[k], dq[k])
        found_q.append(q_k)
        found_dq.append(dq_k)
        memory = memory._replace(q=q_k, dq=dq_k, ddq=expected[k], ddq_before=memory.ddq, primed=True)
    return np.array(found_q), np.array(found_dq)


def test_the_first_tick_takes_the_measurement_as_it_is() -> None:
    q, dq = np.array([0.1, 0.2]), np.array([0.3, 0.4])
    found_q, found_dq = observer().correct(initial(2), q, dq)
    assert np.array_equal(found_q, q)
    assert np.array_equal(found_dq, dq)


@pytest.mark.parametrize("delay", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_an_exact_model_leaves_no_error_whatever_the_delay(delay: float) -> None:
    """What the law computes at tick k moves the joint from `delay` periods after tick k on."""
    expected = accelerations(400)
    q, dq = motion(expected, delay)
    found_q, found_dq = observe(observer(delay), q, dq, expected)
    assert np.abs(found_q - q).max() < 1e-12
    assert np.abs(found_dq - dq).max() < 1e-12


@pytest.mark.parametrize(("true", "believed"), [(1.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.5, 1.0)])
def test_the_delay_matters(true: float, believed: float) -> None:
    expected = accelerations(400)
    q, dq = motion(expected, true)
    wrong = observe(observer(believed), q, dq, expected)[1] - dq
    assert np.abs(wrong).max() > 1e-4


@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_whole_delays_use_one_acceleration_and_no_bit_of_the_other(delay: float) -> None:
    law, (q, dq, before, now, q_seen, dq_seen) = observer(delay), np.random.default_rng(3).normal(size=(6, 2))
    used, other = (before, now) if delay else (now, before)
    other[:] = np.nan  # what has no part in the motion
    dq_wanted = dq + PERIOD * used
    q_wanted = q + PERIOD * dq + (0.5 * PERIOD * PERIOD) * used
    found_q, found_dq = law.follow(q, dq, before, now, q_seen, dq_seen)
    q_off, dq_off = q_seen - q_wanted, dq_seen - dq_wanted
    assert np.array_equal(found_q, q_wanted + 0.2 * q_off)
    assert np.array_equal(found_dq, dq_wanted + 5.0 * q_off + 0.2 * dq_off)


def test_gains_and_delay_are_keys_of_the_cell() -> None:
    keys = ("position_gain=0.3", "velocity_gain=0.1", "velocity_from_position_per_s=7.0")
    cell = load_cell(PAPER, ["loop_delay_s=0.002", *(f"controller.observer.{key}" for key in keys)])
    found = build_agent(cell, cell.arms[1]).observer
    assert found == Observer(PERIOD, 0.3, 7.0, 0.1, 0.4)
    assert "array" not in repr(found), "its gains, each once"
    shipped = load_cell(PAPER)
    assert build_agent(shipped, shipped.arms[0]).observer == Observer(PERIOD, 0.2, 5.0, 0.2, 1.0)


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
    nothing = initial(2)
    memory = nothing._replace(q=q[0] + 0.5, dq=dq[0] - 1.0, ddq=ddq[0], ddq_before=ddq[0], primed=True)
    for k in range(1, 200):
        q_k, dq_k = law.correct(memory, q[k], dq[k])
        memory = nothing._replace(q=q_k, dq=dq_k, ddq=ddq[k], ddq_before=memory.ddq, primed=True)
    assert np.abs(memory.q - q[199]).max() < 1e-6
    assert np.abs(memory.dq - dq[199]).max() < 1e-5


def random_memory(seed: int, n: int, hold: bool) -> Memory:
    rng = np.random.default_rng(seed)
    pose = (0.1, -0.2, 0.3, *((0.5, -0.5, 0.5, -0.5) if seed else (0.0, 0.0, 0.0, 1.0))) if hold else None
    sense = Sense(
        *rng.normal(size=(3, n)),
        *rng.normal(size=(3, 6)),
        ticks=float(seed),
        pull=pull_of(rng.normal(size=14).tolist()),
        plain=Plain(rng.normal(size=n), float(rng.normal())),
        struck=Struck(*rng.normal(size=5).tolist()),
        borne=Borne(*rng.normal(size=4).tolist()),
    )
    shift = tuple(rng.normal(size=6).tolist())
    calm, missed = 102 - 100 * seed, 20 * seed
    braced = Braced(*rng.normal(size=5).tolist())
    more = {"sense": sense, "shift": shift, "calm": calm, "missed": missed, "hold": pose, "braced": braced}
    return Memory(*rng.normal(size=(6, n)), primed=bool(seed % 2), friction_factor=float(rng.normal()), **more)


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("n", [3, 6, 7])
@pytest.mark.parametrize("seed", [0, 1])
def test_memory_survives_the_log(seed: int, n: int, hold: bool) -> None:
    memory = random_memory(seed, n, hold)
    flat = np.array(memory.flatten())
    assert len(flat) == MEMORY_LENGTH
    found = restore(flat, n)
    for name in ("q", "dq", "ddq", "ddq_before", "tau", "tau_before"):
        assert np.array_equal(getattr(found, name), getattr(memory, name))
    assert found.sense.pull == memory.sense.pull
    assert (found.sense.struck, found.sense.borne) == (memory.sense.struck, memory.sense.borne)
    for one, two in zip(
        (*found.sense[:-4], *found.sense.plain), (*memory.sense[:-4], *memory.sense.plain), strict=True
    ):
        assert np.array_equal(one, two)
    older = restore(flat[:-6], n)
    assert (older.settled, older.friction_factor) == (memory.shift, memory.friction_factor), "nothing goes back then"
    flat_of_old = flat[:-7]  # older than the factor of friction
    assert restore(flat_of_old, n).friction_factor == 1.0
    older = restore(np.delete(flat_of_old, [-7, -6]), n)
    assert older.sense.borne == memory.sense.borne._replace(usual_stuck_N=0.0, stuck_N=0.0), "older than stuck joints"
    assert older.braced == memory.braced
    older = restore(flat_of_old[:-14], n).sense
    assert (older.plain.force_N, older.struck) == (memory.sense.plain.force_N, NOT_STRUCK), "older than a blow"
    older = restore(flat_of_old[:-22], n).sense
    assert (older.pull, older.plain.force_N) == (memory.sense.pull, 0.0), "a row that is older than what is plain"
    assert older.plain.momentum.tolist() == [0.0] * n
    for name in ("primed", "hold", "shift", "calm", "missed", "braced", "friction_factor", "settled"):
        assert getattr(found, name) == getattr(memory, name)
    assert np.array_equal(restore(np.array(found.flatten()), n).flatten(), flat)


def test_one_number_of_every_log_says_how_a_hold_is_kept_and_what_it_missed() -> None:
    memory = random_memory(1, 3, hold=True)._replace(calm=102, missed=20)
    assert memory.calm_and_missed == 102 + 20 * 1024
    assert memory.flatten()[85] == memory.calm_and_missed
    begun = initial(3)
    assert (begun.t, begun.age, begun.calm, begun.missed, begun.friction_factor) == (0.0, 0.0, 0, 0, 1.0)


def test_memory_and_log_agree_on_the_room_per_joint_array() -> None:
    assert MEMORY_JOINTS == PLAIN_JOINTS == MAX_JOINTS


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
            memory = memory._replace(hold=(0.3, 0.12, 0.0, 1.0, 0.0, 0.0, 0.0), q_hold=q)
        restored = restore(np.array(memory.flatten()), 3)
        one, two = (step(agent, state, PERIOD * k, mode, m) for m in (memory, restored))
        assert one.tau.tobytes() == two.tau.tobytes()
        assert one.memory.flatten() == two.memory.flatten()
        memory = one.memory


def test_each_gain_corrects_what_it_is_named_after() -> None:
    still, read = np.zeros(1), np.ones(1)
    q, dq = Observer(PERIOD, 0.3, 7.0, 0.1, 1.0).follow(still, still, still, still, read, 2.0 * read)
    assert (q.tolist(), dq.tolist()) == ([0.3], [7.0 + 0.1 * 2.0])
