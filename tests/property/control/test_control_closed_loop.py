"""Theorem 1 in motion: the law on the coupled body, integrated by an independent simulation (identity 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from agent.control import known
from agent.control.trajectory import Trajectory
from drivers.interface import Vector
from tests.support.control import coupled_motion, oracle
from tests.support.control.coupled_motion import Instant
from tests.support.control.gentle import gentle_cell
from tests.support.control.strategies import RandomCell, with_internal_wrenches

DURATION = 0.8  # s
SHORT = 0.2  # s: a balance is broken at once
STEP = 0.005  # s
LONG = (pytest.param(True, 2, marks=pytest.mark.long), pytest.param(False, 4, marks=pytest.mark.long))


@dataclass(frozen=True)
class Record:
    """What a run leaves; arrays over the steps."""

    V: Vector
    dissipated: Vector  # ∫ −V̇ of `eq:V_dot`
    shares: Vector  # sum of the agents' own Lyapunov shares
    e_p: Vector
    e_eta: Vector
    e_eps: Vector


def simulate(cell: RandomCell, trajectory: Trajectory, h: float, duration: float = SHORT) -> Record:
    """Run the law at every stage of the integrator."""
    gains = cell.arms[0].offline.gains
    K = np.array([*gains.k_p, *gains.k_eps])
    k_v = np.sum([a.offline.gains.k_v for a in cell.arms], axis=0)

    found: list[known.Terms] = []  # at the instant that was asked for last

    def torques(now: Instant) -> tuple[Sequence[Vector], float]:
        desired = trajectory.at(now.t)
        pairs = zip(cell.arms, now.motion.q, now.dq, strict=True)
        found[:] = terms = [known.torque(a.model, a.offline, q, dq, desired) for a, q, dq in pairs]
        e, e_v = np.array(terms[0].errors.e), np.array(terms[0].errors.e_v)
        return [t.tau_cmd for t in terms], float(e @ (K * e) + e_v @ (k_v * e_v))

    motion, rows = coupled_motion.start(cell), []
    for i in range(round(duration / h) + 1):
        now = coupled_motion.observe(cell, i * h, motion)
        e = oracle.error_signals(cell.arms[0], motion.p, motion.quat, cell.P.T @ motion.v, trajectory.at(i * h))
        torques(now)
        share = sum(t.lyapunov for t in found)
        V = oracle.lyapunov(e, now.terms.M, cell.P)
        rows.append((V, motion.work, share, np.linalg.norm(e.e_p), e.e_eta, np.linalg.norm(e.e_eps)))
        motion = coupled_motion.step(cell, now, torques, h)
    return Record(*np.array(rows).T)


def balance_error(record: Record) -> float:
    balance = record.V + record.dissipated
    return float(np.abs(balance - balance[0]).max() / record.V[0])


def share_error(record: Record) -> float:
    return float(np.abs(record.shares - record.V).max() / record.V[0])


@pytest.mark.parametrize(("planar", "arm_count"), [(False, 2), pytest.param(True, 3, marks=pytest.mark.long), *LONG])
def test_lyapunov_function_falls_by_exactly_what_the_theorem_says(planar: bool, arm_count: int) -> None:
    """V(t) + ∫ (eᵀKe + Σ k_v ‖e_v‖²) is constant, and the agents' shares sum to V, up to an integration error.

    The error vanishes with the step, to fourth order: halving the step leaves a sixteenth in the limit.
    """
    cell, trajectory = gentle_cell(11 + arm_count, planar, arm_count)
    coarse, fine = simulate(cell, trajectory, STEP), simulate(cell, trajectory, STEP / 2)
    assert np.diff(coarse.V).max() < 0.0
    assert np.diff(fine.V).max() < 0.0
    assert balance_error(fine) < 0.01
    assert balance_error(fine) < balance_error(coarse) / 8.0
    assert share_error(fine) < 1e-5
    assert share_error(fine) < share_error(coarse) / 8.0


@pytest.mark.parametrize(
    ("planar", "arm_count", "sign"),
    [
        pytest.param(True, 4, 1.0, marks=pytest.mark.long), (False, 3, -1.0),
        pytest.param(True, 4, -1.0, marks=pytest.mark.long), pytest.param(False, 3, 1.0, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_errors_converge_without_unwinding(planar: bool, arm_count: int, sign: float) -> None:
    """From e_η < 0 the attitude goes on to −1, the same attitude by the short way."""
    cell, trajectory = gentle_cell(23, planar, arm_count, sign)
    record = simulate(cell, trajectory, STEP, DURATION)
    assert record.e_eta[0] * sign > 0.0
    assert record.e_eta[-1] == pytest.approx(sign, abs=1e-5)
    assert record.e_eps.max() < 1.2 * record.e_eps[0]  # never the long way round
    assert record.e_p[-1] < 0.01 * record.e_p[0]
    assert record.e_eps[-1] < 0.01 * record.e_eps[0]
    assert record.V[-1] < 1e-4 * record.V[0]


def test_internal_forces_leave_the_motion_as_it_is() -> None:
    cell, trajectory = gentle_cell(5, False, 2)
    plain, pressed = (simulate(c, trajectory, STEP) for c in (cell, with_internal_wrenches(cell, 1)))
    assert np.allclose(pressed.V, plain.V, rtol=1e-6, atol=1e-9)
