"""Whether the other arms still hold the object, and the arm itself, when one arm fails: statics along the trajectory.

A limp arm hangs on the object: its weight needs the wrench J⁻ᵀ g there.  In HOLD the motors of survivor i give

    τ_i = g_i + J_iᵀ (c_i W_O + f_int,i − S_i x) + τ_f(−J_i⁻¹ K H x),

with S_i = (k_v K + c_i) H the stiffness of its law (`eq:control law` at rest), W_O the object's weight, f_int,i the
internal wrench that is asked of it, which nobody answers once an arm is limp, and τ_f the friction feed-forward, and
the object sags by the x at which, torque bounds and all,

    Σ_i (J_i⁻ᵀ (τ_i − g_i)) + f = W_O + J⁻ᵀ g,

f the friction of all joints: when any friction within its bounds balances the weights, it does, as in the limit
analysis of plastic bodies.  HELD is what sags by at most `HELD_SAG_M` with all weights at their largest and friction at
its least, as `[tolerance]` states them, breakaway not counted; NOT_HELD is what sags by more the other way round,
joints at rest resisting by more than moving ones; in between either may happen.  Friction that grows with load is that
of the torque that holds arm and share (the motors of a limp arm give none), for NOT_HELD that of the largest torque.

A locked arm carries itself; the others pull at it by what the desired pose moves on until they notice, in the time
that is meant for that; where the motion is slow it may take longer.  Where noticing is off they pull until they are
held for their errors, or as far as the motion goes (agent.verify.unnoticed).  An arm that holds gives way by its own
stiffness, and where it braces itself (agent.control.brace) by so much less as its pull back is worth, but no less than
a locked one.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agent.config import noticing
from agent.config.cell import Arm, Cell
from agent.control.errors import HALF_ANGLE
from agent.control.law import NO_WRENCH
from agent.control.models import ArmModel, Matrix
from agent.control.quaternion import to_matrix
from agent.verify.loads import Loads, loads, unbearable
from agent.verify.rubbing import Rubbing
from agent.verify.unnoticed import ahead, until_off_track
from drivers.interface import Vector

HELD_SAG_M = 0.02
NOTICED_S, NOTICED_MORE_S = 0.1, 0.5  # until a locked arm is noticed by one other, by more
STEPS = 200  # to the balance, at the most
STILL_RAD_PER_S, STILL_RAD = 1e-6, 1e-9
PRESLIDING_RAD = 1e-3  # way of a joint on which its friction builds up
BALANCED = 5e-3  # N, N·m
LOST_M = 10.0
LEAST_STIFFNESS = 1e-6  # where all torques are at their bounds, N/m, N·m/rad


class Fate(enum.StrEnum):
    """What becomes of the object when an arm goes limp."""

    HELD = "held"
    MAY_FALL = "may fall"
    NOT_HELD = "not held"


@dataclass(frozen=True, slots=True)
class Support:
    """What the others bear when one arm fails, over all places."""

    noticed_s: float | None  # after which a locked arm, or one that holds, is supposed to be noticed; None: never
    limp: Loads  # what motors give, feed-forward and all, where joints have no friction and torques no bounds
    sag_m: float  # as the files say, with both; infinite where it falls
    fate: Fate  # whatever of the stated tolerance is true
    locked: Loads
    holding: Loads
    sag_along_m: tuple[float, ...]  # the same at every place


@dataclass(frozen=True, eq=False)
class _Arm:
    """One arm at all places (T, …), on the task rows."""

    Jt: Matrix  # (T, n, m)
    J_inv: Matrix  # (T, n, m)
    g: Matrix  # (T, n)
    S: Matrix  # (m, m) stiffness of its law
    KH: Matrix  # (m, m)
    load: Matrix  # (T, m) c_i W_O + f_int,i
    held: Matrix  # (T, n) what holds arm and load, which presses on its gears
    stall: Vector  # (n,)
    rub: Rubbing
    smooth_rad_per_s: float | None  # of the friction feed-forward; None: there is none

    def wrench(self, tau: Matrix) -> Matrix:
        """J⁻ᵀ τ, (T, m) of joint torques (T, n)."""
        return _apply(np.swapaxes(self.J_inv, -1, -2), tau)

    def law(self, x: Matrix) -> tuple[Matrix, Matrix]:
        """τ (T, n) in HOLD with the object at x (T, m), and a slope (T, n, m) of −τ over x with which steps to where it
        is balanced do not overshoot: of the smooth sign not its own slope, but that of the line to the origin."""
        tau, slope = self.g + _apply(self.Jt, self.load - x @ self.S.T), self.Jt @ self.S
        if self.smooth_rad_per_s is None:
            return tau, slope
        dq_ref = -_apply(self.J_inv, x @ self.KH.T)
        turning = np.where(np.abs(dq_ref) < STILL_RAD_PER_S, STILL_RAD_PER_S, dq_ref)
        sign, viscous = np.tanh(turning / self.smooth_rad_per_s), self.rub.viscous
        steep = self.rub.fed(self.held, sign) * sign / turning
        steep = steep + viscous
        return tau + steep * dq_ref, slope + steep[..., None] * (self.J_inv @ self.KH)

    def rubs(self, x: Matrix, bound: Matrix) -> tuple[Matrix, Matrix]:
        """Friction (T, n), up to its bound (T, n), of joints that the object's way x (T, m) took along, and a slope as
        of `law`."""
        turned = _apply(self.J_inv, x)
        turned = np.where(np.abs(turned) < STILL_RAD, STILL_RAD, turned)
        steep = bound * np.tanh(turned / PRESLIDING_RAD) / turned
        return -steep * turned, steep[..., None] * self.J_inv


@dataclass(frozen=True, slots=True)
class _Reality:
    """Weights and friction, times what the files say."""

    arm: float
    object: float
    friction: float
    resists: Callable[[Rubbing, Matrix], Matrix]  # what joints do while their motors give so much, as the files say
    pressed: float = 0.0  # of stall, what motors may give where that is more than what holds arm and share


class Statics:
    """A cell at some places of its trajectory; along[k][i]: joint angles (n,) of arm i at instants[k], s."""

    def __init__(
        self, cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]], instants: Sequence[float]
    ) -> None:
        P, tolerance = models[0].task_basis, cell.tolerance
        self._P, self._bound = P, cell.file.safety.tau_max_fraction_of_stall
        self._weight = P @ np.concatenate([-cell.file.object.mass_kg * cell.gravity, np.zeros(3)])
        each = enumerate(zip(cell.arms, models, strict=True))
        desired = [cell.trajectory().at(t) for t in instants]
        R = np.reshape([to_matrix(d.quat) for d in desired], (-1, 3, 3))
        self._arms = [_arm(cell, arm, model, [q[i] for q in along], R, self._weight) for i, (arm, model) in each]
        twists = np.array([d.v for d in desired])
        self._speed = twists @ P.T
        self._along = _units(twists[:, :3]) @ P[:, :3].T
        brace = noticing.brace(cell)
        self._brace_N = 0.0 if brace is None else brace.limit_N
        safety = cell.file.safety
        self._limits = safety.tracking_error_max_m, safety.tracking_error_max_rad
        self._ahead = None if safety.noticing.enabled else ahead(cell, instants) @ P.T
        # an arm's weight against its torque: masses and torque constants are independent
        off = math.hypot(tolerance.masses, tolerance.torque_constant)
        low, high = tolerance.friction
        self._worst = _Reality(1.0 + off, 1.0 + tolerance.object, low, Rubbing.moving)
        self._best = _Reality(1.0 - off, 1.0 - tolerance.object, high, Rubbing.at_most, self._bound)

    def without(self, failed: int) -> Support:
        """What the others bear when this arm fails; there must be others."""
        others = [i for i in range(len(self._arms)) if i != failed]
        x = self._sag(failed, others, _Reality(1.0, 1.0, 0.0, Rubbing.moving), math.inf)
        as_said = _Reality(1.0, 1.0, 1.0, Rubbing.at_rest)
        sags = [self._sizes(self._sag(failed, others, r, self._bound)) for r in (self._worst, as_said, self._best)]
        worst, expected, best = (float(sizes.max()) for sizes in sags)
        fate = Fate.HELD if worst <= HELD_SAG_M else Fate.MAY_FALL
        if min(worst, expected, best) > HELD_SAG_M:
            fate = Fate.NOT_HELD
        noticed_s = NOTICED_S if len(others) == 1 else NOTICED_MORE_S
        S, S_others = self._arms[failed].S, np.sum([self._arms[i].S for i in others], axis=0)
        if self._ahead is None:
            gone = noticed_s * self._speed
            left = gone - self._given(S, S_others, gone)
        else:
            gone = self._until_off_track(self._ahead)
            left = self._until_off_track(self._ahead @ np.linalg.solve(S + S_others, S).T)
        limp, locked, holding = (self._loads(others, way) for way in (x, -gone, -left))
        return Support(
            noticed_s=noticed_s if self._ahead is None else None,
            limp=limp,
            sag_m=expected,
            fate=fate,
            locked=locked,
            holding=holding,
            sag_along_m=tuple(sags[1].tolist()),
        )

    def _given(self, S: Matrix, S_others: Matrix, gone: Matrix) -> Matrix:
        """(T, m) by which an arm that holds gives way: it stays where S x + pull = S_others (gone − x)."""
        drawn = gone @ S_others.T
        pull_N = np.clip(np.sum(drawn * self._along, axis=1), 0.0, self._brace_N)
        given: Matrix = np.linalg.solve(S + S_others, (drawn - pull_N[:, None] * self._along).T).T
        return given

    def _until_off_track(self, errors: Matrix) -> Matrix:
        """(T, m) of the others' errors (T, A, m) in the order of time."""
        return until_off_track(errors @ self._P, *self._limits) @ self._P.T

    def _need(self, failed: int, reality: _Reality) -> Matrix:
        """Wrench (T, m) that holds object and limp arm."""
        arm = self._arms[failed]
        need: Matrix = reality.object * self._weight + reality.arm * arm.wrench(arm.g)
        return need

    def _rubbing(self, i: int, reality: _Reality, *, limp: bool) -> Matrix:
        """Friction (T, n) up to which joints of arm i resist in this reality; motors of a limp one give nothing."""
        arm = self._arms[i]
        tau = np.zeros_like(arm.held) if limp else np.maximum(np.abs(arm.held), reality.pressed * arm.stall)
        return reality.friction * reality.resists(arm.rub, tau)

    def _sag(self, failed: int, others: Sequence[int], reality: _Reality, bound: float) -> Matrix:
        """x (T, m) in this reality, with torques up to a part of stall; infinite where there is none."""
        need = self._need(failed, reality)
        rubbing = {i: self._rubbing(i, reality, limp=i == failed) for i in (failed, *others)}
        x: Matrix = np.zeros_like(need)
        for _ in range(STEPS):
            missing, slope = need.copy(), np.tile(LEAST_STIFFNESS * np.eye(need.shape[-1]), (len(need), 1, 1))
            for i in (failed, *others):
                arm, tau = self._arms[i], np.zeros_like(self._arms[i].g)
                steep = np.zeros_like(arm.Jt)
                if i != failed:
                    wanted, steep = arm.law(x)  # which believes in the weights of the files
                    given = np.clip(wanted, -bound * arm.stall, bound * arm.stall)
                    tau = given - reality.arm * arm.g
                    still = wanted == 0.0  # far from its bound: the whole slope
                    steep = np.where(still, 1.0, given / np.where(still, 1.0, wanted))[..., None] * steep
                stuck, resists = arm.rubs(x, rubbing[i])
                missing -= arm.wrench(tau + stuck)
                slope += np.swapaxes(arm.J_inv, -1, -2) @ (steep + resists)
            if float(np.abs(missing).max()) < BALANCED:
                return x
            x = x - np.linalg.solve(slope, missing[..., None])[..., 0]
            if not self._sizes(x).max() <= LOST_M:
                break
        return np.full_like(x, math.inf)

    def _loads(self, others: Sequence[int], x: Matrix) -> Loads:
        """What the others give with the object at x (T, m)."""
        if not np.isfinite(x).all():  # no way of the object balances the weights
            return unbearable(others, len(x))
        return loads({i: np.abs(self._arms[i].law(x)[0]) / self._arms[i].stall for i in others})

    def _sizes(self, x: Matrix) -> Vector:
        """(T,) displacements of the object, m; infinite where x is."""
        with np.errstate(invalid="ignore"):
            sizes: Vector = np.linalg.norm(x @ self._P[:, :3], axis=-1)
        return np.where(np.isfinite(x).all(axis=-1), sizes, math.inf)


def _arm(cell: Cell, arm: Arm, model: ArmModel, along: Sequence[Vector], R: Matrix, weight: Vector) -> _Arm:
    """R: (T, 3, 3) the object's attitudes."""
    offline, P = cell.offline(arm), model.task_basis
    gains = offline.gains
    J = np.array([P @ model.task_basis.T @ model.jacobian(q) for q in along])
    B_inv = np.linalg.inv([model.inertia(q) for q in along])
    Jt = np.swapaxes(J, -1, -2)
    KH = P @ np.diag(np.array([*gains.k_p, *gains.k_eps]) * HALF_ANGLE) @ P.T
    S = P @ np.diag(gains.k_v) @ P.T @ KH + offline.load_share * P @ np.diag(HALF_ANGLE) @ P.T
    g = np.array([model.evaluate(q, np.zeros(model.n)).g for q in along])
    asked = np.reshape(offline.internal_wrench or NO_WRENCH, (2, 3))
    load = offline.load_share * weight + np.reshape(asked @ np.swapaxes(R, -1, -2), (-1, 6)) @ P.T
    return _Arm(
        Jt=Jt,
        J_inv=B_inv @ Jt @ np.linalg.inv(J @ B_inv @ Jt),
        g=g,
        S=S,
        KH=KH,
        load=load,
        held=g + _apply(Jt, load),
        stall=arm.tau_stall_Nm,
        rub=Rubbing.of(arm.servos, cell.tolerance),
        smooth_rad_per_s=None if offline.friction is None else offline.friction.smooth_rad_per_s,
    )


def _units(v: Matrix) -> Matrix:
    """Rows (T, 3) of length one, or zero where there is no motion."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    units: Matrix = np.divide(v, length, out=np.zeros_like(v), where=length > 0.0)
    return units


def _apply(matrix: Matrix, vectors: Matrix) -> Matrix:
    """(T, a) of matrices (…, a, b) and vectors (T, b)."""
    result: Matrix = (matrix @ vectors[..., None])[..., 0]
    return result
