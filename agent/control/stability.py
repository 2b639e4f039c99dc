"""Spectral radius of the sampled closed loop near the trajectory; offline, never in the loop.

With exact feed-forward the object's displacement x and its rate w obey, between two samples,

    ẋ = w,   M ẇ = u,   u_k = −(M̂ K' H + k_v) w_k − (k_v K + I) H x_k,

with M the true and M̂ the believed inertia of object and arms together (`eq:coupled M`), K and K' the gains in
v_r and v̇_r, k_v the sum over the agents, H = I for position and ½ I for attitude (e = −e_η e_ε is half the
angle), and u held for one period that begins the loop's delay after its sample: n − 1 whole periods and a part of
one, during which u_{k−n} still acts before u_{k−n+1} takes over.  With an observer the law sees its estimates of x
and w.  The loop is stable when the spectral radius of the map from one sample to the next is below one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.control.errors import Gains
from agent.control.estimator import Observer, held
from agent.control.models import ArmModel, Matrix
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """Rate and delay of the loop, and the gains of all agents."""

    period_s: float
    delay_periods: float  # from a sample to its torque, in control periods
    gains: Sequence[Gains]
    observer: Observer | None = None  # the same in all agents; None: the law takes what is measured

    @property
    def on_their_way(self) -> int:
        """How many torques before the newest have a part in the motion from one sample to the next."""
        return math.ceil(self.delay_periods)

    def moved(self, torques: Sequence[Matrix], M: Matrix) -> tuple[Matrix, Matrix]:
        """Change of the rate over one period, and of the displacement beyond period times rate.

        torques: u_k, u_{k−1} … u_{k−n} with n = on_their_way; M (m, m): coupled inertia.
        """
        n, M_inv = len(torques) - 1, np.asarray(np.linalg.inv(M), dtype=np.float64)
        first, rest = torques[-1], torques[max(n - 1, 0)]
        share = self.delay_periods - (n - 1) if n else 0.0
        return held(self.period_s, 0.5 * self.period_s * self.period_s, share, M_inv @ first, M_inv @ rest)


class TaskGains(NamedTuple):
    """Gains of the coupled loop in the task rows, each (m, m)."""

    K: Matrix
    K_rate: Matrix
    K_v: Matrix
    H: Matrix


def task_gains(P: Matrix, gains: Sequence[Gains]) -> TaskGains:
    """K, K', Σ k_v and H of all agents; K and K' are the same in all.  P: (m, 6) task basis."""
    first = gains[0]
    diagonals = (
        [*first.k_p, *first.k_eps],
        [*first.k_p_rate, *first.k_eps_rate],
        np.sum([g.k_v for g in gains], axis=0),
        [1.0, 1.0, 1.0, 0.5, 0.5, 0.5],
    )
    return TaskGains(*(P @ np.diag(d) @ P.T for d in diagonals))


def coupled_inertia(
    models: Sequence[ArmModel],
    q: Sequence[Vector],
    object_mass_kg: float,
    object_inertia_world: Matrix,
    arm_scale: float = 1.0,
) -> Matrix:
    """M̃ = M_O + Σ J⁻ᵀ B J⁻¹ (6, 6) projected on the task rows (m, m), `eq:coupled M`.

    q: joint angles of each arm, all holding the same object pose; arm_scale multiplies the arms' inertia.
    """
    P = models[0].task_basis
    M_object = np.zeros((6, 6))
    M_object[:3, :3] = object_mass_kg * np.eye(3)
    M_object[3:, 3:] = object_inertia_world
    M = P @ M_object @ P.T
    for model, q_i in zip(models, q, strict=True):
        # rows of one arm's task basis and those of the first span the same plane, perhaps turned
        J = P @ model.task_basis.T @ model.jacobian(q_i)
        B_inv = np.linalg.inv(model.inertia(q_i))
        M += arm_scale * np.linalg.inv(J @ B_inv @ J.T)  # eq:coupled M
    return M


def spectral_radius(M_true: Matrix, M_believed: Matrix, P: Matrix, loop: SampledLoop) -> float:
    """Largest modulus of the eigenvalues of the one-period map.  Arguments as of `modes`."""
    return float(np.abs(modes(M_true, M_believed, P, loop)).max())


def modes(M_true: Matrix, M_believed: Matrix, P: Matrix, loop: SampledLoop) -> NDArray[np.complex128]:
    """Eigenvalues (m (5 + n),) of the one-period map; those of states that the loop does not use are zero.

    M_true, M_believed: (m, m) coupled inertia; P: (m, 6) task basis; n: torques on their way.
    """
    m, T, n = len(M_true), loop.period_s, loop.on_their_way
    K, K_rate, K_v, H = task_gains(P, loop.gains)
    # Every quantity is a matrix (m, states): how it follows from the states at the sample before.
    states = np.eye(m * (5 + n)).reshape(5 + n, m, -1)
    x, w, x_seen, w_seen, a_before = states[:5]
    a = -(K_rate @ H @ w_seen)  # dv_r = −K' de, de = H w
    u = M_believed @ a - K_v @ (w_seen + K @ H @ x_seen) - H @ x_seen
    torques = [u, *states[5:]]  # u_k, u_{k−1} … u_{k−n}
    w_change, x_change = loop.moved(torques, M_true)
    x_next, w_next = x + T * w + x_change, w + w_change
    seen = (x_next, w_next)
    if loop.observer is not None:
        seen = loop.observer.follow(x_seen, w_seen, a_before, a, x_next, w_next)
    return np.linalg.eigvals(np.vstack([x_next, w_next, *seen, a, *torques[:n]])).astype(np.complex128)
