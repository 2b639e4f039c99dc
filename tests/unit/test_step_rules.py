"""Where a tick draws its lines, to the last bit: off its track, nearly singular, and which law holds the object."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control import joint_hold, known
from agent.control.joint_hold import weight
from agent.control.memory import Memory
from agent.control.quaternion import angle_between
from agent.control.trajectory import Desired, Trajectory
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag, Limits
from agent.standing import hold_here
from drivers.interface import JointState, Vector
from tests.support.starts import start_joints

ALL_BUT_TRACK = [mode for mode in Mode if mode is not Mode.TRACK]
FREE = Limits((1e3,) * 3, (1e3,) * 3)  # nothing is limited


@cache
def paper_arm() -> tuple[Agent, tuple[float, ...]]:
    """An arm of the paper's cell without observer and limits, and where it starts."""
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ['controller.velocity="servo"'])
    return replace(build_agent(cell, cell.arms[0]), limits=FREE), tuple(start_joints(cell)[0].tolist())


def arm(**changes: Any) -> Agent:
    return replace(paper_arm()[0], **{"error_max_m": math.inf, "error_max_rad": math.inf} | changes)


def start(*aside: float) -> Vector:
    """Joints at the start pose, moved aside."""
    return np.array(paper_arm()[1]) + np.array(aside or (0.0, 0.0, 0.0))


def tick(agent: Agent, q: Vector, mode: Mode = Mode.TRACK, memory: Memory | None = None, t: float = 0.0) -> Outcome:
    return step(agent, JointState(0, q, np.zeros(3), np.zeros(3)), t, mode, memory or initial_memory(agent))


def position_error_m(outcome: Outcome) -> float:
    assert outcome.terms is not None
    return math.hypot(*outcome.terms.errors.e_p)


def angle_rad(outcome: Outcome) -> float:
    """Of the object to its desired attitude, from the quaternions themselves."""
    assert outcome.terms is not None
    return angle_between(outcome.terms.kinematics.quat_object, outcome.terms.desired.quat)


# --- off track -------------------------------------------------------------------------------------------------------


def test_an_object_turned_further_than_allowed_is_off_track() -> None:
    turned = start(0.0, 0.0, 0.25)
    assert angle_rad(tick(arm(), turned)) == pytest.approx(0.25, abs=1e-6)
    assert Flag.OFF_TRACK not in tick(arm(error_max_rad=0.2501), turned).flags
    assert Flag.OFF_TRACK in tick(arm(error_max_rad=0.2499), turned).flags


def test_an_object_further_away_than_allowed_is_off_track() -> None:
    away = start(0.05, 0.0, 0.0)
    error_m = position_error_m(tick(arm(), away))
    assert error_m > 5e-3
    assert Flag.OFF_TRACK not in tick(arm(error_max_m=error_m), away).flags, "the bound itself is allowed"
    assert Flag.OFF_TRACK in tick(arm(error_max_m=math.nextafter(error_m, 0.0)), away).flags


def test_the_allowed_angle_itself_is_allowed() -> None:
    turned = start(0.0, 0.0, -0.5)
    terms = tick(arm(), turned).terms
    assert terms is not None
    angle = 2.0 * math.atan2(math.hypot(*terms.errors.e_eps), abs(terms.errors.e_eta))
    assert Flag.OFF_TRACK not in tick(arm(error_max_rad=angle), turned).flags
    assert Flag.OFF_TRACK in tick(arm(error_max_rad=math.nextafter(angle, 0.0)), turned).flags


class Negated:
    """The same motion with every quaternion's sign turned: the same attitudes."""

    def __init__(self, motion: Trajectory) -> None:
        self._motion = motion

    def at(self, t: float) -> Desired:
        desired = self._motion.at(t)
        w, x, y, z = desired.quat
        return desired._replace(quat=(-w, -x, -y, -z))


def test_a_quaternion_and_its_negative_are_the_same_attitude() -> None:
    agent = arm(error_max_rad=0.1)
    outcome = tick(replace(agent, trajectory=Negated(agent.trajectory)), start(0.0, 0.0, 0.05))
    assert outcome.terms is not None
    assert outcome.terms.errors.e_eta < -0.99
    assert Flag.OFF_TRACK not in outcome.flags


@pytest.mark.parametrize("mode", ALL_BUT_TRACK)
def test_only_who_tracks_is_off_track(mode: Mode) -> None:
    agent, q = arm(error_max_m=1e-6, error_max_rad=1e-6), start(0.1, 0.0, 0.2)
    assert tick(agent, q).flags == Flag.OFF_TRACK
    for memory in (initial_memory(agent), hold_here(agent, start(), initial_memory(agent))):
        assert tick(agent, q, mode, memory).flags == Flag.NONE


def test_without_bounds_nothing_is_off_track() -> None:
    bounded = arm()
    plain = Agent(
        name="left",
        model=bounded.model,
        offline=bounded.offline,
        trajectory=bounded.trajectory,
        limits=FREE,
        observer=None,
        sigma_min=0.01,
        period_s=0.005,
    )
    assert tick(plain, start(0.5, -0.3, 0.4)).flags == Flag.NONE
    assert plain.hold_rate_rad_per_s == 10.0


# --- nearly singular -------------------------------------------------------------------------------------------------


def test_the_least_singular_value_that_is_allowed_is_allowed() -> None:
    terms = tick(arm(), start()).terms
    assert terms is not None
    assert tick(arm(sigma_min=terms.sigma_min), start()).flags == Flag.NONE
    below = tick(arm(sigma_min=math.nextafter(terms.sigma_min, 1.0)), start())
    assert below.flags == Flag.SINGULAR
    assert below.terms is not None


SIGMA_MIN = 0.125
NEAR, FAR = math.nextafter(1.5 * SIGMA_MIN, 0.0), 1.5 * SIGMA_MIN


@pytest.fixture
def sigma(monkeypatch: pytest.MonkeyPatch) -> dict[float, float]:
    """Smallest singular value by the first joint's angle, as the test says."""
    table: dict[float, float] = {}
    monkeypatch.setattr(joint_hold, "sigma_min", lambda _, q: table[float(q[0])])
    return table


@pytest.mark.parametrize(
    ("at_hold", "here", "by_springs"), [(FAR, FAR, False), (NEAR, FAR, True), (FAR, NEAR, True), (NEAR, NEAR, True)]
)
@pytest.mark.parametrize("mode", [Mode.READY, Mode.HOLD, Mode.LOWER])
def test_a_hold_is_by_springs_where_the_held_pose_or_the_present_one_is_within_half_as_much_again_of_singular(
    sigma: dict[float, float], mode: Mode, at_hold: float, here: float, by_springs: bool
) -> None:
    agent = arm(sigma_min=SIGMA_MIN)
    held, q = start(), start(0.01, -0.02, 0.03)
    sigma |= {float(held[0]): at_hold, float(q[0]): here}
    memory = hold_here(agent, held, initial_memory(agent))
    outcome = tick(agent, q, mode, memory)
    springs = joint_hold.torque(agent.model, agent.offline, q, np.zeros(3), held, agent.hold_rate_rad_per_s)
    desired = Desired(memory.hold[:3], memory.hold[3:], (0.0,) * 6, (0.0,) * 6)  # type: ignore[index,arg-type]
    law = known.torque(agent.model, agent.offline, q, np.zeros(3), desired)
    wanted = springs if by_springs else law
    assert not np.allclose(springs.tau_cmd, law.tau_cmd, atol=1e-3)
    np.testing.assert_array_equal(outcome.tau, wanted.tau_cmd)
    assert Flag.ADAPTATION_SATURATED not in outcome.flags


def test_who_tracks_never_holds_by_springs(sigma: dict[float, float]) -> None:
    agent, q = arm(sigma_min=SIGMA_MIN), start()
    sigma[float(q[0])] = NEAR
    memory = hold_here(agent, q, initial_memory(agent))
    law = known.torque(agent.model, agent.offline, q, np.zeros(3), agent.trajectory.at(2.0))
    np.testing.assert_array_equal(tick(agent, q, Mode.TRACK, memory, 2.0).tau, law.tau_cmd)


def test_without_a_held_pose_the_law_holds(sigma: dict[float, float]) -> None:
    agent, q = arm(sigma_min=SIGMA_MIN), start()
    sigma[float(q[0])] = NEAR
    law = known.torque(agent.model, agent.offline, q, np.zeros(3), agent.trajectory.at(0.0))
    np.testing.assert_array_equal(tick(agent, q, Mode.READY).tau, law.tau_cmd)


# --- what is carried on ----------------------------------------------------------------------------------------------


def test_the_observer_is_told_what_the_torque_asks_for() -> None:
    outcome = tick(arm(), start(0.02, 0.0, -0.03), t=0.5)
    assert outcome.terms is not None
    np.testing.assert_array_equal(outcome.memory.ddq, outcome.terms.ddq_ref)
    assert np.abs(outcome.memory.ddq).min() > 0.1


@pytest.mark.parametrize("primed", [False, True])
def test_a_tick_without_numbers_ends_what_the_observer_knew(primed: bool) -> None:
    agent = arm()
    memory = initial_memory(agent)._replace(primed=primed, tau=np.array([0.1, 0.2, 0.3]))
    outcome = tick(agent, np.array([0.1, math.nan, 0.2]), memory=memory)
    assert Flag.NOT_FINITE in outcome.flags
    assert outcome.memory.primed is False
    kept = memory.tau if primed else weight(agent.model, agent.offline, memory.q, carries=True)
    np.testing.assert_array_equal(outcome.tau, kept, "once the last torque, then the weight's")
    np.testing.assert_array_equal(outcome.memory.tau, outcome.tau)


def test_the_observers_velocity_is_what_the_law_gets() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ['controller.velocity="observer"'])
    agent = build_agent(cell, cell.arms[0])
    memory = tick(agent, start()).memory
    measured = JointState(1, start(), np.array([0.3, -0.2, 0.1]), np.zeros(3))
    outcome = step(agent, measured, 0.005, Mode.TRACK, memory)
    assert agent.observer is not None
    q, dq = agent.observer.correct(memory, measured.q, measured.dq)
    assert not np.allclose(dq, measured.dq, atol=0.01)
    np.testing.assert_array_equal(outcome.q, q)
    np.testing.assert_array_equal(outcome.dq, dq)


@pytest.mark.parametrize("missed", [0, 1, 2])
def test_ticks_without_a_state_make_no_tick_of_a_motion_older(missed: int) -> None:
    """A motion goes by t; what goes by the age of its mode catches up with the clock."""
    agent = arm()
    memory = initial_memory(agent)._replace(age=3.0, t=1.0)
    now = 1.0 + (1 + missed) * agent.period_s
    tracking, waiting = (tick(agent, start(), mode, memory, now) for mode in (Mode.TRACK, Mode.READY))
    assert tracking.memory.age == pytest.approx(3.0 + agent.period_s, abs=1e-12)
    assert waiting.memory.age == pytest.approx(3.0 + (1 + missed) * agent.period_s, abs=1e-12)
