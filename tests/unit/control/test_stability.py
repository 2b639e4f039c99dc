"""The sampled-loop check against the documented table, and against the linearised step on a coupled body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import Cell, load_cell, placement
from agent.control import ik
from agent.control.memory import initial
from agent.control.models import ArmModel
from agent.control.stability import SampledLoop, coupled_inertia, spectral_radius
from agent.control.trajectory import Desired
from agent.loop import Agent, step
from agent.modes import Mode
from agent.process.build import build_agent
from drivers.interface import JointState, Vector
from tests.support.control import coupled_motion
from tests.support.control.coupled_motion import Motion
from tests.support.control.strategies import Holder, RandomCell, quaternion_of
from tests.support.few import few

PAPER = configs.CELLS_DIR / "paper.toml"
# loop rate, periods of delay, whether the paper's gains are stable there (docs/controller.md)
TABLE = [
    (200.0, 0.0, True),
    (200.0, 1.0, True),
    (500.0, 1.0, True),
    (120.0, 1.0, False),
    (200.0, 2.0, False),
    (120.0, 0.5, True),
    (100.0, 0.75, False),
    (150.0, 1.6, False),
]


LONG = pytest.mark.long


def paper_cell(*overrides: str) -> Cell:
    return load_cell(PAPER, ["controller.friction_feedforward=false", *overrides])


def configurations(cell: Cell, models: Sequence[ArmModel], t: float) -> list[Vector]:
    """Joint angles of every arm with the object where it is desired at time t."""
    desired = cell.trajectory().at(t)
    T = placement(desired.p, desired.quat)
    return [ik.solve(m, T, np.array(a.entry.q_near_rad)) for m, a in zip(models, cell.arms, strict=True)]


def inertia_at(cell: Cell, models: Sequence[ArmModel], q: Sequence[Vector]) -> Vector:
    obj = cell.file.object
    R = models[0].object_pose(q[0]).rotation
    return coupled_inertia(models, q, obj.mass_kg, R @ np.array(obj.inertia_kg_m2.matrix()) @ R.T)


def radius(cell: Cell, rate_hz: float, delay: float, t: float) -> float:
    models = [cell.model(a) for a in cell.arms]
    loop = SampledLoop(1.0 / rate_hz, delay, [cell.offline(a).gains for a in cell.arms])
    M = inertia_at(cell, models, configurations(cell, models, t))
    return spectral_radius(M, M, models[0].task_basis, loop)


@pytest.mark.parametrize(("rate_hz", "delay", "stable"), TABLE)
def test_documented_rates_and_delays(rate_hz: float, delay: float, stable: bool) -> None:
    radii = [radius(paper_cell(), rate_hz, delay, t) for t in (0.0, 3.75, 11.25)]
    assert (max(radii) < 1.0) == stable


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.0])
def test_the_gains_of_the_authors_own_code_are_stable_at_the_rate_they_reached(delay: float) -> None:
    """K = 100, 90, 100 in the reference velocity, 5, 2, 40 in its derivative, k_v = 3.5, 0.5, 0.3; 120 Hz."""
    per_arm = ("k_v_N_s_per_m=[3.5, 0.5, 0.5]", "k_v_Nm_s_per_rad=0.3")
    cell = paper_cell(
        "controller.k_p_per_s=[100.0, 90.0, 90.0]",
        "controller.k_p_rate_per_s=[5.0, 2.0, 2.0]",
        "controller.k_eps_rate_rad_per_s=40.0",
        *(f"arms.{arm}.{setting}" for arm in ("left", "right") for setting in per_arm),
    )
    assert max(radius(cell, 120.0, delay, t) for t in (0.0, 3.75, 11.25)) < 0.995


@pytest.mark.parametrize(("rate_hz", "stable"), [(200.0, False), (1000.0, True)])
def test_believing_in_an_inertia_that_is_not_there_needs_a_fast_loop(rate_hz: float, stable: bool) -> None:
    """Belief acts as a gain: the reference acceleration is fed back through it.  Here 0.05 kg·m² per joint too much."""
    cell = paper_cell()
    models, heavy = ([cell.model(a) for a in cell.arms] for _ in range(2))
    for model in heavy:
        model.model.armature = model.model.armature + 0.05
    q = configurations(cell, models, 0.0)
    loop = SampledLoop(1.0 / rate_hz, 0, [cell.offline(a).gains for a in cell.arms])
    true, believed = inertia_at(cell, models, q), inertia_at(cell, heavy, q)
    assert (spectral_radius(true, believed, models[0].task_basis, loop) < 1.0) == stable


def test_coupled_inertia_is_that_of_the_coupled_body() -> None:
    cell = paper_cell()
    agents = [build_agent(cell, a) for a in cell.arms]
    body = body_of(cell, agents, 2.0)
    now = coupled_motion.observe(body, 0.0, coupled_motion.start(body))
    models = [a.model for a in agents]
    found = inertia_at(cell, models, [a.q for a in body.arms])
    assert np.allclose(found, now.terms.M, rtol=1e-9, atol=1e-12)


class Still:
    """A trajectory that stays where another one is at one time."""

    period_s = 1.0

    def __init__(self, desired: Desired) -> None:
        nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.desired = Desired(desired.p, desired.quat, nothing, nothing)

    def at(self, _t: float) -> Desired:
        return self.desired


def body_of(cell: Cell, agents: Sequence[Agent], t: float) -> RandomCell:
    """The cell at rest on its trajectory, as the independent simulation wants it."""
    desired = Still(cell.trajectory().at(t)).desired
    holders = tuple(
        Holder(a.model, a.offline, arm.entry.model, arm.T_world_base, arm.T_object_ee, q, np.zeros(a.model.n))
        for a, arm, q in zip(agents, cell.arms, configurations(cell, [a.model for a in agents], t), strict=True)
    )
    P = agents[0].model.task_basis
    return RandomCell(holders, P, placement(desired.p, desired.quat), np.zeros(6), desired)


class SampledBody:
    """Agents and coupled body between two samples, as maps of small numbers around rest."""

    def __init__(self, cell: Cell, t: float) -> None:
        agents = [build_agent(cell, a) for a in cell.arms]
        self.body = body_of(cell, agents, t)
        self.agents = [replace(a, trajectory=Still(self.body.desired)) for a in agents]
        self.period_s = agents[0].period_s
        self.tau = [np.zeros(a.model.n) for a in agents]
        for _ in range(100):  # the rate limit lets the torque at rest come step by step
            self.tau = self.torques(np.zeros(6))
        self.at_rest = np.concatenate(self.tau)

    def motion(self, x: Vector) -> Motion:
        """Motion with the object displaced by x[:3] and moving with x[3:], both in the task rows."""
        P, T = self.body.P, self.body.T_world_object
        shift = P.T @ x[:3]
        moved = pin.SE3(pin.exp3(shift[3:]) @ T.rotation, T.translation + shift[:3])
        q = tuple(ik.solve(a.model, moved, a.q, tolerance=1e-14) for a in self.body.arms)
        return Motion(moved.translation, np.array(quaternion_of(moved)), x[3:], q)

    def torques(self, x: Vector) -> list[Vector]:
        """What the agents' own steps command at a sample."""
        motion, out = self.motion(x), []
        dq = coupled_motion.observe(self.body, 0.0, motion).dq
        for agent, q_i, dq_i, tau in zip(self.agents, motion.q, dq, self.tau, strict=True):
            memory = initial(agent.model.n)._replace(tau=tau)
            out.append(step(agent, JointState(0, q_i, dq_i, tau), 0.0, Mode.TRACK, memory).tau)
        return out

    def controller(self, x: Vector) -> Vector:
        return np.concatenate(self.torques(x)) - self.at_rest

    def plant(self, x: Vector, first: Vector, rest: Vector, share: float) -> Vector:
        """State one period later under one torque for a share of it and then another."""
        motion, substeps = self.motion(x), 3
        for tau, duration_s in ((first, share * self.period_s), (rest, (1.0 - share) * self.period_s)):
            held = np.split(self.at_rest + tau, np.cumsum([a.model.n for a in self.agents])[:-1])
            for _ in range(substeps if duration_s else 0):
                now = coupled_motion.observe(self.body, 0.0, motion)
                motion = coupled_motion.step(self.body, now, lambda _now, held=held: (held, 0.0), duration_s / substeps)
        P, T = self.body.P, self.body.T_world_object
        R = pin.Quaternion(*motion.quat.tolist()).matrix()
        shift = np.concatenate([motion.p - T.translation, pin.log3(R @ T.rotation.T)])
        return np.concatenate([P @ shift, motion.v])

    def radius(self, delay: float) -> float:
        """Spectral radius of the linearised map (x, τ_k, …, τ_{k−d}) → the same one period later, τ_k = K x."""
        n, whole = len(self.at_rest), int(delay)
        share = delay - whole  # of the period, in which the torque before still acts
        zero_x, zero = np.zeros(6), np.zeros(n)
        F = jacobian(lambda x: self.plant(x, zero, zero, share), 6)
        older = jacobian(lambda tau: self.plant(zero_x, tau, zero, share), n)
        newer = jacobian(lambda tau: self.plant(zero_x, zero, tau, share), n)
        count = whole + 2  # torques τ_k … τ_{k−d−1}; the last has no effect when the delay is whole
        state = np.eye(6 + count * n)
        x, taus = state[:6], [state[6 + i * n : 6 + (i + 1) * n] for i in range(count)]
        x_next = F @ x + newer @ taus[whole] + older @ taus[whole + 1]
        tau_next = jacobian(self.controller, 6) @ x_next
        return float(np.abs(np.linalg.eigvals(np.vstack([x_next, tau_next, *taus[:-1]]))).max())


def jacobian(f, n: int, h: float = 1e-5) -> Vector:
    columns = [(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(n)]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(("rate_hz", "delay", "stable"), few(TABLE, TABLE[1::4].__contains__))
def test_linearised_step_on_a_coupled_body_agrees(rate_hz: float, delay: float, stable: bool) -> None:
    cell = paper_cell(f"rate_hz={rate_hz}")
    numeric = SampledBody(cell, 2.0).radius(delay)
    analytic = radius(cell, rate_hz, delay, 2.0)
    assert (numeric < 1.0) == stable
    assert numeric == pytest.approx(analytic, rel=1e-4)
