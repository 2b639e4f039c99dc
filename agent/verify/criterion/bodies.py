"""What the arms move, in four ways: an arm alone, with the object, all rigid, all on pads; true motion between samples.

A grasp that gives lets every arm be somewhere of its own.  With x_i the displacement of the object as arm i's joints
have it, x_O its true one, on the task rows (m,),

    s M_i ẍ_i + f V_i ẋ_i = u_i − W_i,      M_O ẍ_O = Σ_i W_i,      W_i = K_i (x_i − x_O) + C_i (ẋ_i − ẋ_O),

    M_i = J⁻ᵀ B J⁻¹ (a summand of `eq:coupled M`),   V_i = J⁻ᵀ F_v J⁻¹,
    K_i = A_iᵀ diag(k_t I, k_r I) A_i,   A_i = [[I, −S(r_i)], [0, I]],   C_i likewise, damped by `drivers.pads`,

with r_i the way from the object's centre to the grasp (`eq:coupled_kinematics`), s the true part of the believed
inertia of the arms and f that of their viscous friction; the object's inertia is off by a factor of its own.  The
springs' limits are cases of their own: nothing between arm and object (a gripper that opened), and one body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from agent.control.law import Offline
from agent.control.models import ArmModel, Matrix
from agent.verify.criterion.exponential import exponential
from drivers import pads
from drivers.interface import Vector


@dataclass(frozen=True, eq=False)
class Grip:
    """One arm at one pose of the object, on the task rows; a stack of poses has leading axes (…) in all arrays."""

    inertia: Matrix  # (m, m) M_i as believed
    viscous: Matrix  # (m, m) V_i as believed
    lever: Matrix  # (6, m) A_i Pᵀ: twist at the grasp of a twist of the object
    swinging: Vector  # (6,) kg, kg·m² with which the arm swings on its pad
    share: float  # c_i
    feeds_friction: bool  # the law adds the viscous friction of its reference velocity

    def springs(self, k_t: Vector, k_r: Vector) -> Matrix:
        """K_i (…, m, m) of pads of these stiffnesses (…,), N/m and N·m/rad."""
        return self._at_grasp(self._six(k_t, k_r))

    def dampers(self, k_t: Vector, k_r: Vector, inertia: Vector, ratio: float) -> Matrix:
        """C_i (…, m, m) of these pads; inertia (…,): the arm's, times the believed one."""
        swinging = np.asarray(inertia)[..., None] * self.swinging
        return self._at_grasp(pads.damping(self._six(k_t, k_r), swinging, ratio))

    def _at_grasp(self, diagonal: Vector) -> Matrix:
        found: Matrix = np.swapaxes(self.lever, -1, -2) @ (diagonal[..., None] * self.lever)
        return found

    @staticmethod
    def _six(k_t: Vector, k_r: Vector) -> Vector:
        k_t, k_r = np.asarray(k_t), np.asarray(k_r)
        return np.stack([k_t, k_t, k_t, k_r, k_r, k_r], axis=-1)


_OF_BODIES = ("inertia", "viscous", "lever", "swinging")


@dataclass(frozen=True, eq=False)
class Pose:
    """All arms of a cell, holding the object at one pose."""

    P: Matrix  # (m, 6) task basis
    object_inertia: Matrix  # (m, m) M_O
    grips: tuple[Grip, ...]


def pose(
    models: Sequence[ArmModel], offline: Sequence[Offline], viscous: Sequence[Vector], q: Sequence[Vector]
) -> Pose:
    """Matrices of all arms at q (n,) each.  viscous: (n,) N·m·s/rad of each arm's joints, by its file."""
    P, first = models[0].task_basis, offline[0]
    R = models[0].object_pose(q[0]).rotation
    M_O = np.zeros((6, 6))
    M_O[:3, :3] = first.object_mass_kg * np.eye(3)
    M_O[3:, 3:] = R @ np.reshape(first.object_inertia, (3, 3)) @ R.T
    each = zip(models, offline, viscous, q, strict=True)
    return Pose(P, P @ M_O @ P.T, tuple(_grip(model, own, d, q_i, P) for model, own, d, q_i in each))


def _grip(model: ArmModel, offline: Offline, viscous: Vector, q: Vector, P: Matrix) -> Grip:
    k = model.evaluate(q, np.zeros(model.n))
    # rows of one arm's task basis and those of the first span the same plane, perhaps turned
    J = P @ model.task_basis.T @ k.J
    B_inv = np.linalg.inv(k.B)
    M: Matrix = np.asarray(np.linalg.inv(J @ B_inv @ J.T), dtype=np.float64)  # eq:coupled M
    J_inv = B_inv @ J.T @ M  # dynamically consistent where there are more joints than rows
    rx, ry, rz = (-x for x in k.p_ee_object)
    A = np.eye(6)
    A[:3, 3:] = [[0.0, rz, -ry], [-rz, 0.0, rx], [ry, -rx, 0.0]]  # −S(r), eq:coupled_kinematics
    J_ee = A @ k.Jt.T
    V = J_inv.T @ (viscous[:, None] * J_inv)
    swinging = pads.swinging_inertia(J_ee @ B_inv @ J_ee.T)
    return Grip(M, V, A @ P.T, swinging, offline.load_share, offline.friction is not None)


def together(poses: Sequence[Pose]) -> Pose:
    """A stack of poses (K, …) for what is asked of the bodies; what only the laws ask for is that of the first."""
    grips = [
        replace(each[0], **{part: np.array([getattr(g, part) for g in each]) for part in _OF_BODIES})
        for each in zip(*(at.grips for at in poses), strict=True)
    ]
    return replace(poses[0], object_inertia=np.array([at.object_inertia for at in poses]), grips=tuple(grips))


@dataclass(frozen=True, eq=False)
class Truth:
    """What the arms and the object are, relative to what their files say; arrays (…,) are a stack of variants."""

    inertia: Vector  # s, of the arms
    load: Vector  # of the object's inertia
    friction: float  # f, of the viscous friction


class Springs:
    """How the grasps give; arrays (…,) like those of the truth that they go with."""

    def __init__(self, k_t: Vector, k_r: Vector, damping_ratio: float) -> None:
        """N/m, N·m/rad, and the damping ratio of an arm that swings on its pad."""
        self.k_t, self.k_r, self.damping_ratio = k_t, k_r, damping_ratio


@dataclass(frozen=True, eq=False)
class Motion:
    """Bodies from one sample to the next, y⁺ = F y + G_first u_{k−n} + G_rest u_{k−n+1}; axes (…) are a stack."""

    F: Matrix  # (…, s, s)
    G_first: Matrix  # (…, s, r) of the oldest torque that still acts, and then of the one after it
    G_rest: Matrix
    sees_x: Matrix  # (…, r, s) displacement of the object as the arms have it
    sees_w: Matrix  # and its rate
    on_their_way: int  # n

    def only(self, k: int) -> Motion:
        """Variant k of the stack alone."""
        F, first, rest, x, w = (v[k : k + 1] for v in (self.F, self.G_first, self.G_rest, self.sees_x, self.sees_w))
        return Motion(F, first, rest, x, w, self.on_their_way)

    def reordered(self, rows: Sequence[int] | Vector) -> Motion:
        """The same with the arms' displacements and torques in another order."""
        F, first, rest, x, w, late = (getattr(self, f.name) for f in fields(self))
        return Motion(F, first[..., rows], rest[..., rows], x[..., rows, :], w[..., rows, :], late)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies in modal coordinates: z̈ = −ω² z − D ż + Cᵀ u, x = C z; leading axes (…) are a stack of variants."""

    frequency: Matrix  # (…, n) ω, rad/s; zero where nothing holds the bodies
    damping: Matrix  # (…, n, n) D
    arms: Matrix  # (…, r, n) C: displacement of the object as the arms have it, one after the other

    def seen_by(self, count: int) -> Bodies:
        """The same, each arm's displacement so many times: what several see and move alike."""
        return Bodies(self.frequency, self.damping, np.concatenate([self.arms] * count, axis=-2))

    def motion(self, period_s: float, delay_periods: float) -> Motion:
        """Motion over one period (exactly) when torques act so late: whole periods and a share of one."""
        late = int(np.ceil(delay_periods))
        share = delay_periods - (late - 1) if late else 0.0
        n, rows = self.frequency.shape[-1], self.arms.shape[-2]
        # displacements in units of a speed: both blocks of A are then alike, and few squarings are needed
        unit = np.maximum(self.frequency, 1.0 / period_s)
        A = np.zeros((*self.frequency.shape[:-1], 2 * n, 2 * n))
        k = np.arange(n)
        A[..., k, n + k] = unit
        A[..., n + k, k] = -(self.frequency**2) / unit
        A[..., n:, n:] = -self.damping
        B = np.zeros((*A.shape[:-1], rows))
        B[..., n:, :] = np.swapaxes(self.arms, -1, -2)
        (F1, G1), (F2, G2) = _held(A, B, (share * period_s, (1.0 - share) * period_s))
        zero = np.zeros_like(self.arms)
        sees_x = np.concatenate([self.arms / unit[..., None, :], zero], axis=-1)
        sees_w = np.concatenate([zero, self.arms], axis=-1)
        return Motion(F2 @ F1, F2 @ G1, G2, sees_x, sees_w, late)


def _held(A: Matrix, B: Matrix, durations_s: tuple[float, float]) -> list[tuple[Matrix, Matrix]]:
    """Transition and input matrix of ẏ = A y + B u with u held, for each of two durations."""
    taken = [duration for duration in durations_s if duration != 0.0]
    moved = zip(*exponential(*(np.stack([duration * M for duration in taken]) for M in (A, B))), strict=True)
    still = np.broadcast_to(np.eye(A.shape[-1]), A.shape), np.zeros_like(B)
    return [next(moved) if duration != 0.0 else still for duration in durations_s]


def bare(at: Pose, i: int, truth: Truth) -> Bodies:
    """Arm i without the object."""
    g = at.grips[i]
    return _free(_times(truth.inertia, g.inertia), truth.friction * g.viscous)


def holding(at: Pose, i: int, truth: Truth) -> Bodies:
    """Arm i alone with the whole object."""
    g = at.grips[i]
    return _free(_times(truth.inertia, g.inertia) + _times(truth.load, at.object_inertia), truth.friction * g.viscous)


def rigid(at: Pose, truth: Truth) -> Bodies:
    """All arms and the object as one body (`eq:coupled M`), which all arms see alike: as one."""
    inertia, viscous = (np.sum([getattr(g, part) for g in at.grips], axis=0) for part in ("inertia", "viscous"))
    return _free(_times(truth.inertia, inertia) + _times(truth.load, at.object_inertia), truth.friction * viscous)


def soft(at: Pose, truth: Truth, grasps: Springs) -> Bodies:
    """Every arm on its pads, and the object between them."""
    m, count, stack = len(at.P), len(at.grips), np.shape(truth.inertia)
    n, last = m * (count + 1), slice(m * count, None)
    mass, springs, dampers = (np.zeros((*stack, n, n)) for _ in range(3))
    mass[..., last, last] = _times(truth.load, at.object_inertia)
    for i, g in enumerate(at.grips):
        own = slice(m * i, m * (i + 1))
        mass[..., own, own] = _times(truth.inertia, g.inertia)
        dampers[..., own, own] = truth.friction * g.viscous
        K = g.springs(grasps.k_t, grasps.k_r)
        C = g.dampers(grasps.k_t, grasps.k_r, truth.inertia, grasps.damping_ratio)
        for matrix, between in ((springs, K), (dampers, C)):
            matrix[..., own, own] += between
            matrix[..., last, last] += between
            matrix[..., own, last] -= between
            matrix[..., last, own] -= between
    L_inv = np.linalg.inv(np.linalg.cholesky(mass))
    Lt_inv = np.swapaxes(L_inv, -1, -2)
    squared, U = np.linalg.eigh(L_inv @ springs @ Lt_inv)
    modes = Lt_inv @ U
    damping = np.swapaxes(modes, -1, -2) @ dampers @ modes
    return Bodies(np.sqrt(np.maximum(squared, 0.0)), damping, modes[..., : m * count, :])


def _free(mass: Matrix, viscous: Matrix) -> Bodies:
    """A body that nothing holds."""
    L_inv = np.linalg.inv(np.linalg.cholesky(mass))
    Lt_inv = np.swapaxes(L_inv, -1, -2)
    return Bodies(np.zeros(mass.shape[:-1]), L_inv @ viscous @ Lt_inv, Lt_inv)


def _times(factor: Vector, matrix: Matrix) -> Matrix:
    """(…, m, m) of factors (…,)."""
    return np.asarray(factor)[..., None, None] * matrix
