"""Spectral radius of the sampled closed loop near the trajectory; offline, never in the loop.

With exact feed-forward the object's displacement x and its rate w obey, between two samples,

    ẋ = w,   M ẇ = u,   u_k = −(M̂ K' H + k_v) w_k − (k_v K + I) H x_k,

with M the true and M̂ the believed inertia of object and arms together (`eq:coupled M`), K and K' the gains in
v_r and v̇_r, k_v the sum over the agents, H = I for position and ½ I for attitude (e = −e_η e_ε is half the
angle), and u held over the period and applied a whole number of periods late.  With an observer the law sees its
estimates of x and w.  The loop is stable when the spectral radius of the map from one sample to the next is below one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.control.errors import Gains
from agent.control.estimator import Observer
from agent.control.models import ArmModel, Matrix
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """Rate and delay of the loop, and the gains of all agents."""

    period_s: float
    delay_cycles: int
    gains: Sequence[Gains]
    observer: Observer | None = None  # the same in all agents; None: the law takes what is measured


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
    """Eigenvalues (m (5 + delay),) of the one-period map; those of states that the loop does not use are zero.

    M_true, M_believed: (m, m) coupled inertia; P: (m, 6) task basis.
    """
    m, T, d = len(M_true), loop.period_s, loop.delay_cycles
    first = loop.gains[0]
    K = P @ np.diag([*first.k_p, *first.k_eps]) @ P.T
    K_rate = P @ np.diag([*first.k_p_rate, *first.k_eps_rate]) @ P.T
    K_v = P @ np.diag(np.sum([g.k_v for g in loop.gains], axis=0)) @ P.T
    H = P @ np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5]) @ P.T
    # Every quantity is a matrix (m, states): how it follows from the states at the sample before.
    states = np.eye(m * (5 + d)).reshape(5 + d, m, -1)
    x, w, x_seen, w_seen, a_before = states[:5]
    a = -(K_rate @ H @ w_seen)  # dv_r = −K' de, de = H w
    u = M_believed @ a - K_v @ (w_seen + K @ H @ x_seen) - H @ x_seen
    acceleration = np.linalg.inv(M_true) @ (states[-1] if d else u)  # states[5:]: u_{k−1} … u_{k−d}
    x_next, w_next = x + T * w + 0.5 * T * T * acceleration, w + T * acceleration
    seen = (x_next, w_next)
    if loop.observer is not None:
        expected = a_before if loop.observer.delay_cycles else a
        seen = loop.observer.follow(x_seen, w_seen, expected, x_next, w_next)
    in_flight = [u, *states[5:-1]] if d else []
    return np.linalg.eigvals(np.vstack([x_next, w_next, *seen, a, *in_flight])).astype(np.complex128)
