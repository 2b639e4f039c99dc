"""Theorem 2 in motion: unknown masses on the coupled body, integrated by an independent simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from agent.control import adaptive
from agent.control.adaptation import Adaptation, Estimate
from agent.control.trajectory import Trajectory
from drivers.interface import Vector
from tests.support.control import coupled_motion, oracle
from tests.support.control.adaptive_cells import adaptation, nominal_of
from tests.support.control.coupled_motion import Instant
from tests.support.control.gentle import gentle_cell
from tests.support.control.strategies import RandomCell

STEP = 0.005  # s
LONG = pytest.mark.long
EVERY = 4  # steps to a record where no derivative is judged


@dataclass(frozen=True)
class Record:
    """What a run leaves; arrays over the steps."""

    V: Vector  # the paper's, with the coupled inertia and all parameter errors
    dissipated: Vector  # ∫ eᵀKe + Σ k_v ‖e_v‖²
    forgotten: Vector  # ∫ σ e_θᵀ Γ⁻¹ e_θ, from what is configured
    shares: Vector  # sum of what the agents log
    e_p: Vector
    e_eps: Vector
    theta: Vector  # (steps, all parameters)


def simulate(
    cell: RandomCell, trajectory: Trajectory, agents: Sequence[Adaptation], duration: float, h: float, every: int = 1
) -> Record:
    """Law and adaptation at every stage of the integrator: continuous time.  The estimates ride along as `work`.

    every: steps from one record to the next.
    """
    gains = cell.arms[0].offline.gains
    K, k_v = np.array([*gains.k_p, *gains.k_eps]), np.sum([a.offline.gains.k_v for a in cell.arms], axis=0)
    sizes = [len(x) for a in agents for x in a.start]
    cuts = np.cumsum(sizes)

    def estimates(work: Vector) -> list[Estimate]:
        parts = np.split(work[: cuts[-1]], cuts[:-1])
        return [Estimate(*pair) for pair in zip(parts[::2], parts[1::2], strict=True)]

    def laws(now: Instant):
        desired, rows = trajectory.at(now.t), zip(cell.arms, agents, now.motion.q, now.dq, strict=True)
        return [
            adaptive.torque(a.model, a.offline, data, estimate, q, dq, desired)
            for (a, data, q, dq), estimate in zip(rows, estimates(now.motion.work), strict=True)
        ]

    def torques(now: Instant) -> tuple[Sequence[Vector], Vector]:
        found = laws(now)
        e, e_v = np.array(found[0][0].errors.e), np.array(found[0][0].errors.e_v)
        rates, forgotten = [], 0.0
        for (_, grad), a, estimate in zip(found, agents, estimates(now.motion.work), strict=True):
            for x, dx, nominal, gain in zip(estimate, grad, a.nominal, a.gain, strict=True):
                rates.append(-gain * dx - a.leak_per_s * np.sign(gain) * (x - nominal))
            forgotten += 2.0 * a.leak_per_s * a.parameter_error(estimate)
        return [terms.tau_cmd for terms, _ in found], np.concatenate(
            [*rates, [e @ (K * e) + e_v @ (k_v * e_v), forgotten]]
        )

    start = np.concatenate([*(x for a in agents for x in a.start), [0.0, 0.0]])
    motion, rows, thetas = replace(coupled_motion.start(cell), work=start), [], []
    for i in range(round(duration / h) + 1):
        now = coupled_motion.observe(cell, i * h, motion)
        if i % every == 0:
            e = oracle.error_signals(cell.arms[0], motion.p, motion.quat, cell.P.T @ motion.v, trajectory.at(i * h))
            wrong = sum(a.parameter_error(x) for a, x in zip(agents, estimates(motion.work), strict=True))
            share = sum(terms.lyapunov for terms, _ in laws(now))
            V = oracle.lyapunov(e, now.terms.M, cell.P) + wrong
            rows.append((V, *motion.work[-2:], share, np.linalg.norm(e.e_p), np.linalg.norm(e.e_eps)))
            thetas.append(motion.work[:-2])
        motion = coupled_motion.step(cell, now, torques, h)
    return Record(*np.array(rows).T, np.array(thetas))


def agents_of(cell: RandomCell, scale: float, gamma: float = 0.03, gamma_object: float = 3.0) -> list[Adaptation]:
    return [
        adaptation(nominal_of(a), start=scale, gamma=gamma, gamma_object=gamma_object) for a in cell.arms
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("planar", "arm_count", "scale"),
    [
        (True, 2, 0.0), pytest.param(False, 3, 0.5, marks=LONG),
        pytest.param(True, 2, 2.0, marks=LONG), pytest.param(True, 2, 0.5, marks=LONG),
        pytest.param(False, 3, 0.0, marks=LONG), pytest.param(False, 3, 2.0, marks=LONG),
    ],
)  # fmt: skip
def test_lyapunov_function_falls_by_exactly_what_the_theorem_says(planar: bool, arm_count: int, scale: float) -> None:
    """V(t) + ∫ (eᵀKe + Σ k_v ‖e_v‖²) is constant up to an integration error that vanishes with the step."""
    cell, trajectory = gentle_cell(31 + arm_count, planar, arm_count)
    coarse, fine = (simulate(cell, trajectory, agents_of(cell, scale), 0.2, h) for h in (STEP, STEP / 2))
    assert np.diff(fine.V).max() < 0.0
    errors = [float(np.abs(r.V + r.dissipated - r.V[0]).max() / r.V[0]) for r in (coarse, fine)]
    assert errors[1] < 1e-4
    assert errors[1] < errors[0] / 8.0
    assert np.abs(fine.shares - fine.V).max() < 1e-6 * fine.V[0]


@pytest.mark.parametrize(("planar", "arm_count"), [pytest.param(True, 2, marks=LONG), (False, 3)])
def test_with_a_leak_towards_the_truth_it_falls_by_what_is_forgotten_too(planar: bool, arm_count: int) -> None:
    """V(t) + ∫ (eᵀKe + Σ k_v ‖e_v‖² + σ e_θᵀ Γ⁻¹ e_θ) is constant."""
    cell, trajectory = gentle_cell(31 + arm_count, planar, arm_count)
    agents = [replace(a, leak_per_s=2.0) for a in agents_of(cell, 0.5)]
    record = simulate(cell, trajectory, agents, 0.2, STEP / 2)
    assert np.diff(record.V).max() < 0.0
    assert record.forgotten[-1] > 0.1 * record.V[0]
    assert np.abs(record.V + record.dissipated + record.forgotten - record.V[0]).max() < 1e-4 * record.V[0]


def test_with_a_leak_towards_something_else_the_mean_dissipation_is_what_the_docs_bound() -> None:
    """∫ W ≤ V(0) + σ t ½‖θ − θ_nominal‖² in the norm of Γ⁻¹: bounded for ever, and not zero in the end."""
    cell, trajectory = gentle_cell(33, planar=True, arm_count=2)
    leak, duration, true = 2.0, 1.6, agents_of(cell, 1.0)
    wrong = [replace(a, leak_per_s=leak, nominal=Estimate(*(0.5 * x for x in a.nominal)), start=a.start) for a in true]
    distance = sum(a.parameter_error(b.nominal) for a, b in zip(true, wrong, strict=True))
    record = simulate(cell, trajectory, wrong, duration, STEP, EVERY)
    begun = record.V[0] - sum(b.parameter_error(a.start) for a, b in zip(true, wrong, strict=True))
    assert record.dissipated[-1] <= begun + leak * duration * distance
    late = record.e_p[-round(1.0 / (STEP * EVERY)) :]
    assert 1e-5 < late.max() < 0.1


@pytest.mark.parametrize(
    ("planar", "arm_count", "sign", "scale"),
    [
        (True, 2, -1.0, 2.0), pytest.param(False, 2, 1.0, 0.5, marks=LONG), pytest.param(True, 2, 1.0, 0.0, marks=LONG),
        pytest.param(True, 2, 1.0, 0.5, marks=LONG), pytest.param(True, 2, 1.0, 2.0, marks=LONG),
        pytest.param(True, 3, -1.0, 0.0, marks=LONG), pytest.param(True, 3, -1.0, 2.0, marks=LONG),
        pytest.param(True, 3, -1.0, 0.5, marks=LONG),
        pytest.param(False, 2, 1.0, 0.0, marks=LONG), pytest.param(False, 2, 1.0, 2.0, marks=LONG),
    ],
)  # fmt: skip
def test_errors_vanish_and_everything_stays_bounded(planar: bool, arm_count: int, sign: float, scale: float) -> None:
    cell, trajectory = gentle_cell(51 + arm_count, planar, arm_count, sign)
    agents = agents_of(cell, scale, gamma=0.1, gamma_object=10.0)
    record = simulate(cell, trajectory, agents, 3.5, STEP, EVERY)
    last = slice(-round(1.0 / (STEP * EVERY)), None)
    assert record.e_p[last].max() < 0.1 * record.e_p[0]
    assert record.e_eps[last].max() < 0.05 * record.e_eps[0]
    assert record.e_eps.max() < 1.3 * record.e_eps[0]  # never the long way round
    assert record.V.max() <= record.V[0] * (1.0 + 1e-6)
    # V bounds every estimate: ½ e_θᵀ Γ⁻¹ e_θ ≤ V(0)
    truth = np.concatenate([x for a in agents for x in a.nominal])
    weight = np.concatenate([x for a in agents for x in a.weight])
    assert (0.5 * (record.theta - truth) ** 2 @ weight <= record.V[0] * (1.0 + 1e-6)).all()
