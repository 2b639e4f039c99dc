"""How a hold is kept: when it brakes, by the observer's speed and by the servos' own, and what a brake expects."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import configs
from agent.calm import BRAKE, JOINTS, LAW, SEEN_TIMES, braking, felt, kept, slowed
from agent.config.cell import load_cell
from agent.control.memory import initial
from agent.loop import step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag, Limits
from drivers.interface import JointState
from tests.unit.test_hold import T, holding, tick
from tests.unit.test_step_rules import arm, start

ABOVE = 1.5
LIMITS = Limits((3.0, 3.0, 1.0), (1.5, 1.5, 0.5))
FREE, BOUND = (0.0, -2.9, 0.9), (0.0, -2.999, 0.0)
OBSERVED = load_cell(configs.CELLS_DIR / "paper.toml", ['controller.velocity="observer"'])


@pytest.mark.parametrize(
    ("believed", "measured", "tau", "before", "after"),
    [
        ((0.0, 0.0, 1.51), (0.0, 0.0, 1.4), FREE, LAW, BRAKE),
        ((0.0, 0.0, 1.4), (0.0, 0.0, 1.6), FREE, LAW, LAW),  # a push: the law resists it best
        ((0.0, 0.0, 1.4), (0.0, 0.0, -1.6), BOUND, LAW, BRAKE),  # and it cannot
        ((0.0, 0.0, 1.4), (0.0, 0.0, -1.5), BOUND, LAW, LAW),
        ((0.0, 0.0, 1.4), (0.0, 0.0, 1.6), BOUND, JOINTS, BRAKE),
        ((0.0, 0.0, 1.4), (0.0, 0.0, 1.6), (0.0, -0.999 * 3.0, 0.0), LAW, BRAKE),
        ((0.0, -0.6, 0.0), (0.0, -0.09, 0.0), FREE, LAW, BRAKE),  # imagined
        ((0.0, -0.6, 0.0), (0.0, -0.11, 0.0), FREE, LAW, LAW),
        ((0.0, -0.6, 0.0), (0.0, 0.2, 0.0), FREE, LAW, BRAKE),
        ((0.0, 0.5, 0.0), (0.0, 0.0, 0.0), FREE, LAW, LAW),
        ((0.0, -0.6, 0.0), (0.0, 0.6, 0.0), FREE, LAW, LAW),
        ((0.0, -0.2, 0.0), (0.0, 0.6, 0.0), FREE, LAW, LAW),  # pushed the other way
        ((0.0, -0.6, 0.0), (0.0, 0.0, 0.0), FREE, JOINTS, JOINTS),  # whose gains are not the law's
        ((0.0, 0.29, 0.0), (0.0, 9.0, 0.0), BOUND, BRAKE, JOINTS),
        ((0.0, 0.31, 0.0), (0.0, 0.0, 0.0), FREE, BRAKE, BRAKE),
        ((0.0, 0.0, 0.0), (0.0, -1.94, 0.0), FREE, LAW, LAW),
        ((0.0, 0.0, 0.0), (0.0, SEEN_TIMES * ABOVE, 0.0), FREE, LAW, LAW),
        ((0.0, 0.0, 0.0), (0.0, -1.96, 0.0), FREE, LAW, BRAKE),  # a push that the law hardly knows of
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.96), FREE, JOINTS, BRAKE),
        ((9.0, 9.0, 9.0), (0.0, 0.0, 0.0), BOUND, JOINTS + 3, JOINTS + 2),
    ],
)
@pytest.mark.fault("M5")
def test_a_hold_brakes_for_speed_where_it_is_overpowered_and_where_it_imagines_one(
    believed: Any, measured: Any, tau: Any, before: int, after: int
) -> None:
    memory = initial(3)._replace(calm=before, tau=np.array(tau), tau_before=np.array(tau))
    assert kept(np.array(believed), np.array(measured), memory, LIMITS, ABOVE) == after


@pytest.mark.parametrize(
    ("step", "before", "after"),
    [
        ((0.0, 1.49, -0.49), LAW, LAW),
        ((0.0, 1.499, 0.0), LAW, BRAKE),
        ((0.0, 0.0, -0.5), LAW, BRAKE),
        ((1.5, 0.0, 0.0), JOINTS, JOINTS),
    ],
)
@pytest.mark.fault("M5")
def test_a_hold_whose_law_steps_as_far_as_it_may_brakes(step: Any, before: int, after: int) -> None:
    memory = initial(3)._replace(calm=before, tau=np.array(FREE) + np.array(step), tau_before=np.array(FREE))
    assert kept(np.zeros(3), np.zeros(3), memory, LIMITS, ABOVE) == after


def test_a_law_that_was_not_heard_for_a_while_may_step_and_imagine_but_not_be_fast() -> None:
    memory = initial(3)._replace(tau=np.array(FREE) + np.array((0.0, 1.5, 0.0)), tau_before=np.array(FREE))
    still = np.zeros(3)
    for missed, imagined, after in ((1, ABOVE, LAW), (0, 0.0, BRAKE), (20, 1.01 * ABOVE, BRAKE)):
        believed = np.array([imagined, 0.0, 0.0])
        assert kept(believed, still, memory._replace(missed=missed), LIMITS, ABOVE) == after


def test_a_brake_is_for_the_larger_of_two_speeds_and_of_equal_ones_for_the_believed() -> None:
    believed, measured = np.array([0.5, -2.0, 1.0, 0.0]), np.array([-1.5, 1.0, -1.0, 0.1])
    assert felt(believed, measured).tolist() == [-1.5, -2.0, 1.0, 0.1]


def test_what_a_log_says_of_a_hold_keeps_its_meaning() -> None:
    assert (LAW, BRAKE, JOINTS) == (0, 1, 2)


def test_a_brake_begins_with_the_speed_that_the_servos_see() -> None:
    agent = arm(observer=build_agent(OBSERVED, OBSERVED.arms[0]).observer, damp_above_rad_per_s=ABOVE)
    imagining = holding(agent, dq=np.array([0.0, 5.0, 0.0]), ddq=np.array([0.0, 100.0, 0.0]))
    outcome = tick(agent, imagining, 1.0, dq=(0.1, -0.2, 0.3))
    assert Flag.DAMPED in outcome.flags
    np.testing.assert_array_equal(outcome.dq, [0.1, -0.2, 0.3])
    np.testing.assert_array_equal(outcome.q, start())
    assert not outcome.memory.ddq_before.any(), "nor is what the law asked for expected of the next one"
    again = tick(agent, imagining._replace(calm=BRAKE), 1.0, dq=(0.1, -0.2, 0.3))
    assert Flag.DAMPED in again.flags
    assert abs(again.dq[1]) > 1.0, "once it brakes, the observer has its say"


def test_a_brake_acts_against_the_larger_of_the_speeds_that_are_believed_and_seen() -> None:
    np.testing.assert_array_equal(felt(np.array([0.5, -0.5, 0.5]), np.array([0.6, 0.4, -0.7])), [0.6, -0.5, -0.7])
    agent = arm(observer=build_agent(OBSERVED, OBSERVED.arms[0]).observer, damp_above_rad_per_s=ABOVE)
    pushed = holding(agent, calm=BRAKE, dq=np.full(3, 0.5))
    outcome = tick(agent, pushed, 1.0, dq=(2.0, 2.0, 2.0))
    assert (outcome.dq < 1.9).all(), "news to the observer"
    assert outcome.terms is not None
    np.testing.assert_array_equal(outcome.tau, braking(outcome.terms, np.full(3, 2.0), 30.0))
    np.testing.assert_array_equal(outcome.memory.ddq, np.full(3, -60.0))


def test_a_brake_expects_nothing_of_a_joint_whose_torque_was_limited() -> None:
    dq = np.array([1.0, -2.0, 3.0])
    wanted = np.array([0.5, 0.6, 0.7])
    np.testing.assert_array_equal(slowed(dq, 30.0, wanted, np.array([0.5, 0.3, 0.7])), [-30.0, 0.0, -90.0])
    n = 3
    agent = arm(damp_above_rad_per_s=ABOVE, limits=Limits((50.0,) * n, (1e-9,) * n))
    state = JointState(0, start(), np.array([0.0, 2.0, 0.0]), np.zeros(n))
    outcome = step(agent, state, T, Mode.HOLD, holding(agent))
    assert Flag.DAMPED | Flag.RATE_LIMITED in outcome.flags
    np.testing.assert_array_equal(outcome.memory.ddq, np.zeros(n))
