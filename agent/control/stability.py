"""Spectral radius of the sampled closed loop near the trajectory; offline, never in the loop.

With exact feed-forward the object's error x and its rate w obey, between two samples,

    ẋ = H w,   M ẇ = u,   u_k = −(M̂ K' H + k_v) w_k − (k_v K + I) x_k,

with M the true and M̂ the believed inertia of object and arms together (`eq:coupled M`), K and K' the gains in
v_r and v̇_r, k_v the sum over the agents, H = I for position and ½ I for attitude (e = −e_η e_ε is half the
angle), and u held over the period and applied a whole number of periods late.  The loop is stable when the
spectral radius of the map from one sample to the next is below one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.control.errors import Gains
from agent.control.models import ArmModel, Matrix
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """Rate and delay of the loop, and the gains of all agents."""

    period_s: float
    delay_cycles: int
    gains: Sequence[Gains]


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
        M += arm_scale * np.linalg.inv(J @ B_inv @ J.T)
    return M


def spectral_radius(M_true: Matrix, M_believed: Matrix, P: Matrix, loop: SampledLoop) -> float:
    """Largest modulus of the eigenvalues of the one-period map.  Arguments as of `modes`."""
    return float(np.abs(modes(M_true, M_believed, P, loop)).max())


def modes(M_true: Matrix, M_believed: Matrix, P: Matrix, loop: SampledLoop) -> NDArray[np.complex128]:
    """Eigenvalues (m (2 + delay),) of the one-period map.

    M_true, M_believed: (m, m) coupled inertia; P: (m, 6) task basis.
    """
    m, T, d = len(M_true), loop.period_s, loop.delay_cycles
    first = loop.gains[0]
    K = P @ np.diag([*first.k_p, *first.k_eps]) @ P.T
    K_rate = P @ np.diag([*first.k_p_rate, *first.k_eps_rate]) @ P.T
    K_v = P @ np.diag(np.sum([g.k_v for g in loop.gains], axis=0)) @ P.T
    H = P @ np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5]) @ P.T
    u_w = -(M_believed @ K_rate @ H + K_v)  # dv_r = −K' de, de = H w
    u_x = -(K_v @ K + np.eye(m))
    accelerate = np.linalg.inv(M_true)
    size = m * (2 + d)
    A = np.zeros((size, size))
    x, w = slice(0, m), slice(m, 2 * m)
    A[x, x], A[x, w], A[w, w] = np.eye(m), T * H, np.eye(m)
    # state: x, w, u_{k−1}, …, u_{k−d}; the oldest acts now, or u_k itself without delay
    act_x, act_w = 0.5 * T * T * H @ accelerate, T * accelerate
    if d == 0:
        A[x, x] += act_x @ u_x
        A[x, w] += act_x @ u_w
        A[w, x] += act_w @ u_x
        A[w, w] += act_w @ u_w
    else:
        oldest, newest = slice(m * (1 + d), m * (2 + d)), slice(2 * m, 3 * m)
        A[x, oldest], A[w, oldest] = act_x, act_w
        A[newest, x], A[newest, w] = u_x, u_w
        for i in range(1, d):
            A[m * (2 + i) : m * (3 + i), m * (1 + i) : m * (2 + i)] = np.eye(m)
    return np.linalg.eigvals(A).astype(np.complex128)
