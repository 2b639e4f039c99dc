"""One tick at a singular pose: the last torque or a hold by gravity and springs, and how stiff these may be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import load_cell
from agent.control import joint_hold
from agent.loop import initial_memory, step
from agent.modes import Mode
from agent.process.build import HOLD_RATE_MAX_RAD_PER_S, build_agent
from agent.safety import Flag
from agent.standing import hold_here
from drivers.interface import JointState

ONE_ARM = configs.CELLS_DIR / "identify_wx200.toml"


@cache
def stretched() -> np.ndarray:
    """Elbow in line with shoulder and wrist: the Jacobian of the first link's direction is lost."""
    model = load_cell(ONE_ARM).model(load_cell(ONE_ARM).arms[0])
    grid = np.linspace(-1.8, 0.5, 2000)
    sigma = [joint_hold.sigma_min(model, np.array([0.5, elbow, 0.3])) for elbow in grid]
    return np.array([0.5, grid[int(np.argmin(sigma))], 0.3])


def test_a_jacobian_without_inverse_keeps_the_last_torque_and_says_so() -> None:
    cell = load_cell(ONE_ARM, ['controller.velocity="servo"'])
    agent = build_agent(cell, cell.arms[0])
    memory = initial_memory(agent)._replace(tau=np.array([0.1, 0.2, 0.3]))
    for q in (stretched(), stretched() + np.array([0.3, 0.0, -0.2])):
        outcome = step(agent, JointState(0, q, np.zeros(3), np.zeros(3)), 0.0, Mode.TRACK, memory)
        assert outcome.flags & Flag.SINGULAR
        assert np.all(np.abs(outcome.tau - memory.tau) <= np.array(agent.limits.tau_step_max_Nm) + 1e-12)


def test_a_hold_at_a_singular_pose_is_gravity_and_a_spring() -> None:
    cell = load_cell(ONE_ARM, ['controller.velocity="servo"'])
    agent = build_agent(cell, cell.arms[0])
    q = stretched()
    memory = hold_here(agent, q, initial_memory(agent))
    terms = step(agent, JointState(0, q, np.zeros(3), np.zeros(3)), 0.0, Mode.HOLD, memory).terms
    assert terms is not None
    carried = agent.model.model.copy()
    obj, frame = cell.file.object, carried.frames[agent.model.object_id]
    body = pin.Inertia(obj.mass_kg, np.zeros(3), np.array(obj.inertia_kg_m2.matrix()))
    carried.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    weight = pin.rnea(carried, carried.createData(), q, np.zeros(3), np.zeros(3))
    assert np.allclose(terms.tau_cmd, weight, atol=1e-12)
    aside = q + np.array([0.01, -0.02, 0.03])
    pulled = step(agent, JointState(0, aside, np.zeros(3), np.zeros(3)), 0.0, Mode.HOLD, memory).terms
    assert pulled is not None
    stiffness = agent.model.inertia(aside) * agent.hold_rate_rad_per_s**2
    assert np.allclose(pulled.tau_inertia, -stiffness @ (aside - q), atol=1e-12)


def test_a_jacobian_without_any_inverse_has_no_singular_value() -> None:
    flat: Any = SimpleNamespace(jacobian=lambda _: np.zeros((3, 3)), inertia=lambda _: np.eye(3))
    assert joint_hold.sigma_min(flat, np.zeros(3)) == 0.0


def test_six_joints_are_held_by_their_weight_and_share_whatever_the_pose() -> None:
    cell = load_cell(configs.CELLS_DIR / "three_wx250s.toml")
    agent, q = build_agent(cell, cell.arms[0]), np.array([0.1, -0.2, 0.3, 0.4, 0.9, -0.5])
    k = agent.model.evaluate(q, np.zeros(6))
    share = cell.arms[0].entry.load_share * cell.file.object.mass_kg * 9.81
    weight = k.g + k.Jt @ [0.0, 0.0, share, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(joint_hold.weight(agent.model, agent.offline, q, carries=True), weight, atol=1e-9)
    terms = joint_hold.torque(agent.model, agent.offline, q, np.zeros(6), q, 10.0)
    np.testing.assert_allclose(terms.tau_cmd, weight, atol=1e-9)
    assert (*terms.desired.v, *terms.desired.a) == (0.0,) * 12
    assert np.isnan((*terms.wrench_cmd, *terms.wrench_internal)).sum() == 12


def test_joint_errors_of_a_hold_fall_critically_damped_with_an_exact_model() -> None:
    """(1 + ωt) e^{−ωt}, for every joint on its own, at a pose where neither law has an inverse."""
    cell = load_cell(ONE_ARM)
    agent, q_hold, w = build_agent(cell, cell.arms[0]), stretched(), 10.0
    model = agent.model.model
    offline = replace(agent.offline, load_share=0.0)  # the arm alone: the object is no part of this model
    data, q, dq, h = model.createData(), q_hold + np.array([0.05, -0.1, 0.08]), np.zeros(3), 1e-3
    start = q - q_hold

    def acceleration(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        tau = joint_hold.torque(agent.model, offline, q, dq, q_hold, w).tau_cmd
        return np.array(pin.aba(model, data, q, dq, tau))

    for k in range(1, 401):
        middle_q, middle_dq = q + 0.5 * h * dq, dq + 0.5 * h * acceleration(q, dq)
        q, dq = q + h * middle_dq, dq + h * acceleration(middle_q, middle_dq)
        t = k * h
        assert np.allclose(q - q_hold, start * (1.0 + w * t) * np.exp(-w * t), atol=2e-5)


@pytest.mark.parametrize(
    ("rate_hz", "delay", "expected"), [(200.0, 1.0, 20.0), (500.0, 0.0, 20.0), (60.0, 1.0, 10.0), (60.0, 0.25, 16.0)]
)
def test_a_hold_is_no_stiffer_than_the_rate_allows(rate_hz: float, delay: float, expected: float) -> None:
    cell = load_cell(ONE_ARM, [f"rate_hz={rate_hz}", f"loop_delay_s={delay / rate_hz}"])
    assert HOLD_RATE_MAX_RAD_PER_S == 20.0
    assert build_agent(cell, cell.arms[0]).hold_rate_rad_per_s == pytest.approx(expected)
