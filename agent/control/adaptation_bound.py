"""How fast the estimates may adapt at the loop's rate; offline, never in the loop.

From one tick to the next the adaptive wrench a changes by −T G e_v, with

    G = Σ_i J_i⁻ᵀ Y_i Γ_i Y_iᵀ J_i⁻¹ + Σ_i c_i² Y_O Γ_O Y_Oᵀ .

Two limits, for the arms' gain and for the object's:

along the trajectory: the loop of agent.control.stability with the state a added, u_k = … + a_k and
    a_{k+1} = a_k − T G (w_k + K x_k), G that of the desired motion: its spectral radius stays below one;
at the start: G grows with the square of the reference acceleration, which an error e_0 drives towards K' K e_0
    (K = 150 turns millimetres into 70 m/s²).  That lasts a few ticks, so it is no question of eigenvalues: one tick's
    adaptation may not turn e_v round, (1 + d) T² λ_max(M⁻¹ G) ≤ 1 with d periods of delay.

TRANSIENT_SHARE of K' K e_0 is what simulated starts of the paper's cell reach when they begin to diverge (200 and
500 Hz, with and without rotor columns, docs/adaptive.md): the limit is then passed by a factor of one to four.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.control.adaptation import JOINT_PARAMETERS, Adaptation
from agent.control.law import Offline
from agent.control.models import ArmModel, Matrix
from agent.control.quaternion import Mat3, Vec3, rotate_back, to_matrix
from agent.control.regressor import BODY_PARAMETERS, joint_regressor, object_regressor
from agent.control.stability import SampledLoop, task_gains
from drivers.interface import Vector

TRANSIENT_SHARE = 0.3
SMALLEST_START_ERROR = np.array([1e-3] * 3 + [5e-3] * 3)  # m, rad: no grasp is set up better


@dataclass(frozen=True, slots=True)
class ReferenceTwist:
    """What the regressors depend on beside the pose: reference twist and its derivative, (6,) world axes."""

    v: Vector
    dv: Vector


@dataclass(frozen=True, slots=True)
class Point:
    """One instant of the planned motion: joint angles of every arm, coupled inertia (m, m), desired motion."""

    q: Sequence[Vector]
    M: Matrix
    reference: ReferenceTwist


@dataclass(frozen=True, slots=True)
class GainLimits:
    """Largest factor on the configured gains that is stable; below 1 the configured gain is too large."""

    arm: float
    object: float


def gain_limits(
    models: Sequence[ArmModel],
    agents: Sequence[Offline],
    points: Sequence[Point],
    start_error: Vector,
    loop: SampledLoop,
) -> GainLimits:
    """Limits of the adaptation gains over the planned motion; start_error (6,) is e at the first point.

    Raises TypeError unless all agents are adaptive.
    """
    P = models[0].task_basis
    arm = body = math.inf
    for point in points:
        G_arm, G_object = _adaptation_matrices(models, agents, point.q, point.reference, P)
        arm = min(arm, _largest_stable(point.M, G_arm, P, loop))
        body = min(body, _largest_stable(point.M, G_object, P, loop))
    first, g = points[0], agents[0].gains
    e = np.maximum(np.abs(start_error), SMALLEST_START_ERROR)
    K, K_rate = np.array([*g.k_p, *g.k_eps]), np.array([*g.k_p_rate, *g.k_eps_rate])
    transient = ReferenceTwist(-K * e, TRANSIENT_SHARE * K_rate * K * e)
    G_arm, G_object = _adaptation_matrices(models, agents, first.q, transient, P)
    over = (1.0 + loop.delay_periods) * loop.period_s**2
    return GainLimits(
        arm=min(arm, _reciprocal(over * _largest_eigenvalue(first.M, G_arm))),
        object=min(body, _reciprocal(over * _largest_eigenvalue(first.M, G_object))),
    )


def believed_inertia(
    models: Sequence[ArmModel], agents: Sequence[Offline], q: Sequence[Vector], start: bool = True
) -> Matrix:
    """Coupled inertia (m, m) that the agents' estimates stand for: at the start, or as configured.

    It need not be positive definite: from an empty estimate it is zero.
    """
    P = models[0].task_basis
    M = np.zeros((len(P), len(P)))
    still = ReferenceTwist(np.zeros(6), np.zeros(6))
    for model, agent, q_i in zip(models, agents, q, strict=True):
        adaptation = _adaptive(agent)
        estimate = adaptation.start if start else adaptation.nominal
        n, zero = model.n, np.zeros(model.n)
        J_inv = np.linalg.pinv(P @ model.task_basis.T @ model.jacobian(q_i))
        split = BODY_PARAMETERS * n
        gravity = joint_regressor(model, q_i, zero, zero, zero)
        columns = [
            (joint_regressor(model, q_i, zero, zero, unit) - gravity) @ estimate.arm[:split] for unit in np.eye(n)
        ]
        B = np.stack(columns, axis=1) + np.diag(estimate.arm[split : split + n])
        M += J_inv.T @ B @ J_inv  # eq:parameter linearity 2, the arms' part of M̃
        weightless = replace(agent, gravity=(0.0, 0.0, 0.0))
        rows = [
            _object_rows(model, weightless, q_i, replace(still, dv=P.T @ unit), P) @ estimate.object
            for unit in np.eye(len(P))
        ]
        M += agent.load_share * np.stack(rows, axis=1)
    return M


def _adaptive(agent: Offline) -> Adaptation:
    if agent.adaptation is None:
        raise TypeError("only an adaptive agent has adaptation gains")
    return agent.adaptation


def adaptation_matrix(model: ArmModel, agent: Offline, q: Vector, reference: ReferenceTwist, P: Matrix) -> Matrix:
    """G (m, m) of one arm on the rows of P.  Raises TypeError unless it is adaptive."""
    G_arm, G_object = _adaptation_matrices([model], [agent], [q], reference, P)
    return G_arm + G_object


def _adaptation_matrices(
    models: Sequence[ArmModel], agents: Sequence[Offline], q: Sequence[Vector], reference: ReferenceTwist, P: Matrix
) -> tuple[Matrix, Matrix]:
    """The arms' and the object's part of G (m, m) in the rows of P."""
    G_arm, G_object = np.zeros((len(P), len(P))), np.zeros((len(P), len(P)))
    for model, agent, q_i in zip(models, agents, q, strict=True):
        gain = _adaptive(agent).gain
        Y, Y_O = estimated_wrench(model, agent, q_i, reference, P)
        G_arm += (Y * gain.arm) @ Y.T  # eq:tmp
        G_object += (Y_O * gain.object) @ Y_O.T
    return G_arm, G_object


def estimated_wrench(
    model: ArmModel, agent: Offline, q: Vector, reference: ReferenceTwist, P: Matrix
) -> tuple[Matrix, Matrix]:
    """The paper's Y_i (m, 16 n) and c_i Y_O (m, 10) in the rows of P: what estimates become at the object."""
    adaptation, n = _adaptive(agent), model.n
    J_inv = np.linalg.pinv(P @ model.task_basis.T @ model.jacobian(q))
    dq_ref, ddq_ref = J_inv @ P @ reference.v, J_inv @ P @ reference.dv
    Y = joint_regressor(model, q, np.zeros(n), dq_ref, ddq_ref)
    Y_O = agent.load_share * _object_rows(model, agent, q, reference, P)
    columns = np.zeros((JOINT_PARAMETERS, n))
    columns[:3] = ddq_ref, dq_ref, np.tanh(dq_ref / adaptation.smooth_rad_per_s)
    if adaptation.sticking:
        load = np.linalg.pinv(J_inv).T @ Y_O @ adaptation.nominal.object
        size = np.abs(Y @ adaptation.nominal.arm[: BODY_PARAMETERS * n] + load)
        columns[3:] = columns[2] * np.stack([np.ones(n), size, size])  # breakaway that has not fallen off
    return J_inv.T @ np.hstack([Y, *(np.diag(column) for column in columns)]), Y_O


def _object_rows(model: ArmModel, agent: Offline, q: Vector, reference: ReferenceTwist, P: Matrix) -> Matrix:
    """Y_O (m, 10) in the rows of P with the object momentarily at rest."""
    R: Mat3 = to_matrix(model.evaluate(q, np.zeros(model.n)).quat_object)
    still: Vec3 = (0.0, 0.0, 0.0)

    def back(v: Vector) -> Vec3:
        x, y, z = v.tolist()
        return rotate_back(R, (x, y, z))

    v, dv = reference.v, reference.dv
    Y = object_regressor(
        still, still, back(v[:3]), back(v[3:]), back(dv[:3] - np.array(agent.gravity)), back(dv[3:])
    )  # fmt: skip
    rows: Matrix = P @ np.kron(np.eye(2), np.array(R).reshape(3, 3)) @ Y
    return rows


def _largest_eigenvalue(M: Matrix, G: Matrix) -> float:
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(M, G))).max())


def _reciprocal(x: float) -> float:
    return 1.0 / x if x > 0.0 else math.inf


def radius_with_adaptation(M: Matrix, G: Matrix, P: Matrix, loop: SampledLoop) -> float:
    """Largest modulus of the eigenvalues of the one-period map with adaptation; M (m, m) true and believed."""
    m, T, n = len(M), loop.period_s, loop.on_their_way
    K, K_rate, K_v, H = task_gains(P, loop.gains)
    # state: H x, w, a, u_{k−1} … u_{k−n}
    states = np.eye(m * (3 + n)).reshape(3 + n, m, -1)
    x, w, a = states[:3]
    u = -(K_v @ K + np.eye(m)) @ x - (M @ K_rate @ H + K_v) @ w + a
    torques = [u, *states[3:]]
    w_change, x_change = loop.moved(torques, M)
    rows = [x + H @ (T * w + x_change), w + w_change, a - T * G @ (w + K @ x), *torques[:n]]
    return float(np.abs(np.linalg.eigvals(np.vstack(rows))).max())


def _largest_stable(M: Matrix, G: Matrix, P: Matrix, loop: SampledLoop) -> float:
    """Largest factor on G that adds no growth to the loop, to 1 %; infinite when G is zero."""
    if not np.any(G):
        return math.inf
    # the states of a that no regressor reaches stay where they are: modulus exactly one
    allowed = max(1.0, radius_with_adaptation(M, 0.0 * G, P, loop)) + 1e-7
    low, high = 0.0, _reciprocal(loop.period_s**2 * _largest_eigenvalue(M, G)) * 16.0
    if radius_with_adaptation(M, high * G, P, loop) <= allowed:
        return high
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius_with_adaptation(M, middle * G, P, loop) <= allowed else (low, middle)
    return low
