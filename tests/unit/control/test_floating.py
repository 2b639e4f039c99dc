"""The torque of an arm that a hand guides: it carries, it resists, and it never pushes by itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.config.agent import build_agent
from agent.config.cell import ConfigError, load_cell
from agent.control.floating import Floating, afloat, damping, friction, room, sinking, standing, walls
from agent.control.terms import Terms
from agent.loop import Agent, initial_memory, step
from agent.modes import Mode
from agent.safety import Flag, limit
from drivers.interface import JointState, Vector

CELL = load_cell(Path("three_wx250s"), ['floating.arms=["left"]'])
AGENT = build_agent(CELL, CELL.arms[0])
HELD = build_agent(load_cell(Path("three_wx250s"), ['floating.arms=["left"]', "floating.holding=true"]), CELL.arms[0])
N = AGENT.model.n
Q = np.array([0.1, -0.2, 0.3, 0.1, 0.9, -0.1])


def own(agent: Agent = AGENT) -> Floating:
    assert agent.floating is not None
    return agent.floating


def float_at(q: Vector, dq: Vector, agent: Agent = AGENT, age: float = 9.0, begun: Vector | None = None) -> Terms:
    return afloat(agent.model, agent.offline, own(agent), age, begun, q, dq)


def weight(q: Vector) -> Vector:
    return AGENT.model.evaluate(q, np.zeros(N)).g.copy()


speeds = st.lists(st.floats(-4.0, 4.0), min_size=N, max_size=N).map(np.array)
poses = st.lists(st.floats(-0.9, 0.9), min_size=N, max_size=N).map(np.array)


def test_at_rest_an_arm_has_the_torque_of_its_weight_and_nothing_else() -> None:
    terms = float_at(Q, np.zeros(N))
    assert np.allclose(terms.tau_cmd, weight(Q), atol=1e-12)
    assert np.abs(terms.tau_cmd).max() > 0.5
    assert not terms.tau_object.any()


def test_an_arm_that_holds_carries_its_share_too() -> None:
    terms = float_at(Q, np.zeros(N), HELD)
    k = HELD.model.evaluate(Q, np.zeros(N))
    share = CELL.arms[0].entry.load_share * CELL.file.object.mass_kg * 9.81
    assert np.allclose(terms.tau_object, k.Jt @ [0.0, 0.0, share, 0.0, 0.0, 0.0], atol=1e-9)


def test_the_weight_is_taken_up_within_a_twentieth_of_a_second() -> None:
    assert not float_at(Q, np.zeros(N), age=0.0).tau_cmd.any()
    assert np.allclose(float_at(Q, np.zeros(N), age=0.05).tau_cmd, weight(Q))


@settings(max_examples=60, deadline=None)
@given(poses, speeds)
def test_beside_the_weight_it_takes_energy_out_but_for_less_than_the_friction(q: Vector, dq: Vector) -> None:
    terms = float_at(q, dq, begun=q)
    drag = terms.tau_feedback
    tau, _ = limit(terms.tau_cmd.tolist(), terms.tau_cmd.tolist(), AGENT.limits)
    assert float(drag @ dq) <= 1e-9
    assert np.all(np.abs(terms.tau_friction) <= own().friction_Nm + 1e-12)
    assert np.all(terms.tau_friction * dq >= 0.0)
    least = np.array([servo.coulomb_Nm.value for servo in CELL.arms[0].servos]) * CELL.tolerance.friction[0]
    assert np.all(own().friction_Nm * (1.0 + CELL.tolerance.torque_constant) <= least)
    assert float((np.array(tau) - weight(q) - terms.tau_friction) @ dq) <= 1e-9, "limited, too"


@pytest.mark.parametrize(
    ("speed", "share"), [(0.0, 0.0), (0.15, 0.0), (0.16, 6.022144e-4), (0.275, 0.5), (0.4, 1.0), (-3.0, -1.0)]
)
def test_no_friction_is_compensated_at_rest_and_all_of_the_share_in_motion(speed: float, share: float) -> None:
    assert friction(own(), np.full(N, speed)) == pytest.approx(share * own().friction_Nm, abs=1e-12)


def test_the_damping_grows_from_drag_to_brake_up_to_the_largest_speed() -> None:
    wide = replace(own(), tau_max_Nm=np.full(N, 1e3))
    inertia = AGENT.model.evaluate(Q, np.zeros(N)).B.copy()
    rates = []
    for speed in (0.2, 0.5, 0.7, 0.9, 1.0, 2.0):
        dq = np.zeros(N)
        dq[2] = -speed
        terms = afloat(AGENT.model, AGENT.offline, wide, 9.0, None, Q, dq)
        rates.append(float(-terms.tau_feedback[2] / (inertia[2, 2] * dq[2])))
    assert rates[:2] == pytest.approx([5.0, 5.0])
    assert rates == sorted(rates)
    assert rates[-2:] == pytest.approx([own().brake_per_s] * 2)
    assert own().brake_per_s == 30.0
    quick = replace(own(), speed_max_rad_per_s=2.0)
    assert [damping(quick, 5.0, np.array([0.1, -speed])) for speed in (1.0, 2.0)] == [5.0, 30.0]
    assert damping(quick, 40.0, np.array([2.0])) == 40.0, "never less than what is asked for"


def test_damping_that_has_no_room_is_scaled_as_a_whole() -> None:
    rest, drag, bound = np.array([1.0, -0.5]), np.array([2.0, 3.0]), np.array([2.0, 2.0])
    part = room(rest, drag, bound)
    assert part == pytest.approx(0.5)
    assert np.all(np.abs(rest + part * drag) <= bound)
    assert room(np.array([3.0]), np.array([1.0]), np.array([2.0])) == 0.0
    assert room(np.array([3.0]), np.array([-1.0]), np.array([2.0])) == 1.0, "it makes it smaller"
    assert room(np.zeros(1), np.zeros(1), np.ones(1)) == 1.0
    assert room(np.array([3.0]), np.zeros(1), np.array([2.0])) == 1.0, "nothing to scale"


def test_a_fast_arm_is_damped_within_its_torques_in_the_direction_of_its_momentum() -> None:
    dq = np.array([3.0, -4.0, 4.0, 2.0, -3.0, 3.0])
    terms = float_at(Q, dq)
    momentum = AGENT.model.evaluate(Q, dq).B @ dq
    assert np.all(np.abs(terms.tau_cmd) <= own().tau_max_Nm + 1e-9)
    assert np.any(np.abs(own().brake_per_s * momentum) > own().tau_max_Nm), "which is not all that it would take"
    cosine = terms.tau_feedback @ momentum / (np.linalg.norm(terms.tau_feedback) * np.linalg.norm(momentum))
    assert cosine == pytest.approx(-1.0)


def test_damping_has_the_room_that_weight_load_friction_and_walls_leave() -> None:
    q, dq, bounds = Q.copy(), np.full(N, -0.9), np.full(N, 1e3)
    q[1], bounds[1] = own(HELD).low_rad[1] + 0.08, 9.0
    terms = afloat(HELD.model, HELD.offline, replace(own(HELD), tau_max_Nm=bounds), 9.0, Q, q, dq)
    unbounded = afloat(HELD.model, HELD.offline, replace(own(HELD), tau_max_Nm=np.full(N, 1e3)), 9.0, Q, q, dq)
    assert terms.tau_object[1] * terms.tau_friction[1] != 0.0
    assert terms.tau_cmd[1] == pytest.approx(9.0, rel=1e-12)
    assert unbounded.tau_cmd[1] > 9.5
    assert len(terms.wrench_cmd) == len(terms.wrench_internal) == 6, "not known"


def test_a_wall_is_as_stiff_as_the_inertia_that_the_joint_feels() -> None:
    """400 / s² into the wall and 40 / s on the way in; a joint that is in none is left alone."""
    two = replace(own(), low_rad=np.array([-1.0, -1.0]), high_rad=np.array([1.0, 1.0]))
    B, begun = np.array([[0.5, 0.2], [0.2, 0.4]]), np.zeros(2)
    felt = (0.5 - 0.2**2 / 0.4, 0.4 - 0.2**2 / 0.5)

    def wall(q: tuple[float, float], dq: tuple[float, float]) -> list[float]:
        return walls(two, B, begun, np.array(q), np.array(dq)).tolist()

    assert wall((-0.92, 0.3), (0.0, 0.7)) == pytest.approx([felt[0] * 400.0 * 0.02, 0.0])
    assert wall((-0.92, 0.3), (-0.1, -0.7)) == pytest.approx([felt[0] * (400.0 * 0.02 + 40.0 * 0.1), 0.0])
    assert wall((0.2, 0.93), (0.7, 0.1)) == pytest.approx([0.0, -felt[1] * (400.0 * 0.03 + 40.0 * 0.1)])
    assert wall((0.2, 0.93), (0.7, -0.1)) == pytest.approx([0.0, -felt[1] * 400.0 * 0.03])


@pytest.mark.parametrize(("limit_rad", "sign"), [("low_rad", 1.0), ("high_rad", -1.0)])
def test_a_wall_pushes_back_from_a_limit_and_damps_the_way_in_alone(limit_rad: str, sign: float) -> None:
    def wall(depth: float, speed: float, begun: float = -1.0) -> float:
        q = Q.copy()
        edge = getattr(own(), limit_rad)[1] + sign * own().wall_rad
        q[1], start = edge - sign * depth, Q.copy()
        start[1] = edge - sign * begun
        dq = np.zeros(N)
        dq[1] = speed * sign
        with_wall = float_at(q, dq, begun=start)
        without = float_at(q, dq, begun=q)
        return sign * float(with_wall.tau_feedback[1] - without.tau_feedback[1])

    assert wall(-0.01, 0.0) == 0.0
    assert wall(0.02, 0.0) == pytest.approx(0.5 * wall(0.04, 0.0), rel=1e-3)
    assert wall(0.02, 0.0) > 0.0
    assert wall(0.02, -0.1) > wall(0.02, 0.0)
    assert wall(0.02, 0.1) == pytest.approx(wall(0.02, 0.0))
    assert wall(0.02, 0.0, begun=0.02) == 0.0, "it does not push where the arm began"
    assert wall(0.05, 0.0, begun=0.02) == pytest.approx(wall(0.03, 0.0), rel=1e-2)


def test_a_sinking_arm_lets_its_weight_go_but_not_its_speed() -> None:
    def carried(age: float, speed: float) -> float:
        dq = np.zeros(N)
        dq[1] = speed
        terms = sinking(AGENT.model, AGENT.offline, own(), age, Q, dq)
        return float(terms.tau_gravity[1] / weight(Q)[1])

    assert carried(0.0, 0.0) == 1.0
    assert carried(1.5, 0.0) == pytest.approx(0.5)
    assert carried(3.0, 0.0) == 0.0
    assert carried(9.0, 0.25) == pytest.approx(0.5)
    assert carried(9.0, -1.0) == 1.0
    dq = np.full(N, 0.3)
    assert float(sinking(AGENT.model, AGENT.offline, own(), 9.0, Q, dq).tau_feedback @ dq) < 0.0


def test_a_standing_arm_pulls_back_no_harder_than_its_reach_says_and_is_damped() -> None:
    def back(away: float, speed: float = 0.0) -> float:
        q, dq = Q.copy(), np.zeros(N)
        q[2] += away
        dq[2] = speed
        return float(standing(AGENT.model, AGENT.offline, own(), Q, q, dq).tau_feedback[2])

    assert back(0.0) == 0.0
    assert back(0.05) < 0.0 < back(-0.05)
    assert back(0.5) == pytest.approx(back(0.1), rel=0.1)
    assert back(0.0, 0.1) < 0.0
    wide, away, dq = replace(own(), tau_max_Nm=np.full(N, 1e3)), np.full(N, 0.03), np.linspace(-0.2, 0.2, N)
    terms = standing(AGENT.model, AGENT.offline, wide, Q - away, Q, dq)
    inertia = AGENT.model.evaluate(Q, dq).B
    assert terms.tau_feedback == pytest.approx(-inertia @ (64.0 * away + 16.0 * dq)), "critically, at 8 / s"
    assert terms.tau_gravity == pytest.approx(weight(Q))
    q_hold = own().came_to_rest(Q, np.full(N, 0.4))
    assert np.allclose(q_hold - Q, 0.05)
    assert not standing(AGENT.model, AGENT.offline, own(), None, Q, np.zeros(N)).tau_feedback.any()


def test_a_tick_in_float_is_no_trouble_near_a_singular_pose_and_remembers_where_it_began() -> None:
    q = np.zeros(N)  # stretched out
    memory = initial_memory(AGENT)._replace(q_hold=q, age=9.0)
    outcome = step(AGENT, JointState(0, q, np.zeros(N), np.zeros(N)), 0.0, Mode.FLOAT, memory)
    assert int(outcome.flags) & ~4 == 0, "the step limit at most"
    assert outcome.memory.q_hold is q


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("floating.friction_share=0.6", "friction_share.*0.6.*0.55"),
        ('floating.arms=["nobody"]', "floating.arms.*nobody.*left"),
        ('floating.arms=["left", "left"]', "different arms"),
        ('hil.arms=["left"]', "one of them"),
    ],
)
def test_what_could_move_by_itself_and_what_is_not_there_is_refused(change: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        load_cell(Path("three_wx250s"), ['floating.arms=["left"]', change])


def test_an_arm_that_stands_and_is_pushed_away_stays_where_the_hand_leaves_it() -> None:
    memory = initial_memory(AGENT)._replace(q_hold=Q + 0.5, hold=(0.0,) * 7, age=1.0)
    state = JointState(0, Q, np.zeros(N), np.zeros(N))
    assert step(AGENT, state, 0.0, Mode.STAND, memory).memory.q_hold == pytest.approx(Q + own().stand_reach_rad)
    near = memory._replace(q_hold=Q - 0.05)
    assert step(AGENT, state, 0.0, Mode.STAND, near).memory.q_hold == pytest.approx(Q - 0.05)
    floating = step(AGENT, state, 0.0, Mode.FLOAT, memory)
    assert floating.memory.q_hold == pytest.approx(Q + 0.5)
    assert Flag.ADAPTATION_SATURATED not in floating.flags


def test_an_arm_that_could_float_is_held_by_its_law() -> None:
    state = JointState(0, Q, np.zeros(N), np.zeros(N))
    terms = step(AGENT, state, 0.0, Mode.HOLD, initial_memory(AGENT)).terms
    assert terms is not None
    assert terms.J_inv_P is not None
