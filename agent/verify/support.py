"""Whether the other arms still hold the object, and the arm itself, when one arm fails: statics along the trajectory.

A limp arm hangs on the object: its weight needs the wrench J⁻ᵀ g there.  In HOLD the motors of survivor i give

    τ_i = g_i + J_iᵀ (c_i W_O + f_int,i − S_i x) + τ_f(−J_i⁻¹ K H x),

with S_i = (k_v K + c_i) H the stiffness of its law (`eq:control law` at rest), W_O the object's weight, f_int,i the
internal wrench that is asked of it, which nobody answers once an arm is limp, and τ_f the friction feed-forward, and
the object sags by the x at which, torque bounds and all,

    Σ_i (J_i⁻ᵀ (τ_i − g_i)) + f = W_O + J⁻ᵀ g,

f the friction of all joints: when any friction within its bounds balances the weights, it does, as in the limit
analysis of plastic bodies.  But joints creep where motors are at their bounds and friction alone bears the rest, so
HELD is what sags by at most `HELD_SAG_M` without any friction, with all weights at their largest and what motors give
at its least, as `[tolerance]` states them; NOT_HELD is what sags by more the other way round, with the most friction,
joints at rest resisting by more than moving ones; in between either may happen.  Friction that grows with load is that
of the torque that holds arm and share (the motors of a limp arm give none), for NOT_HELD that of the largest torque.

A locked arm carries itself; the others pull at it by what the desired pose moves on until they feel it
(agent.verify.felt), but for no less than the time that is meant for noticing, by what their law gives for the
velocity that the object lacks, k_v + B K' H by way of the arm's inertia, and by what their estimates learn of it.
Where noticing is off they pull until they are held for their errors, or as far as the motion goes
(agent.verify.unnoticed).  An arm that holds gives way by its own stiffness, and where it braces itself
(agent.control.brace) by so much less as its pull back is worth, but no less than a locked one.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.config import coordination, noticing
from agent.config.cell import Cell
from agent.control.models import ArmModel, Matrix
from agent.verify.felt import STEP_S, Feeling, summed
from agent.verify.loads import Loads, loads, unbearable
from agent.verify.rubbing import Rubbing
from agent.verify.static_arm import applied, static_arm
from agent.verify.unnoticed import to_the_end, until_off_track
from drivers.interface import Vector

HELD_SAG_M = 0.02
NOTICED_S, NOTICED_MORE_S = 0.1, 0.5  # until a locked arm is noticed by one other, by more
STEPS = 200  # to the balance, at the most
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

    noticed_s: float | None  # after which a locked arm, or one that holds, is noticed at the soonest; None: never
    locked_s: tuple[float, ...]  # after which one is at every place; infinite: later than is looked at, or never
    holding_s: tuple[float, ...]
    limp: Loads  # what motors give, feed-forward and all, where joints have no friction and torques no bounds
    sag_m: float  # as the files say, with both; infinite where it falls
    crept_m: float  # to which it sags in the end without friction, within the bounds of torque; infinite likewise
    fate: Fate  # whatever of the stated tolerance is true
    locked: Loads
    holding: Loads
    sag_along_m: tuple[float, ...]  # the same at every place


@dataclass(frozen=True, slots=True)
class _Reality:
    """Weights, friction, and what motors give of a torque that is asked of them, times what the files say."""

    arm: float
    object: float
    torque: float
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
        self._arms = [
            static_arm(cell, arm, model, [q[i] for q in along], desired, self._weight) for i, (arm, model) in each
        ]
        twists = np.array([d.v for d in desired])
        self._along = _units(twists[:, :3]) @ P[:, :3].T
        brace = noticing.brace(cell)
        self._brace_N = 0.0 if brace is None else brace.limit_N
        safety = cell.file.safety
        self._limits = safety.tracking_error_max_m, safety.tracking_error_max_rad
        self._ahead = None if safety.noticing.enabled else to_the_end(cell, instants) @ P.T
        sense = coordination.residual(cell, cell.arms[0])
        self._feeling = None if sense is None else Feeling(cell, sense, instants)
        off, weak, most = tolerance.masses, tolerance.torque_constant, tolerance.friction[1]
        self._worst = _Reality(1.0 + off, 1.0 + tolerance.object, 1.0 - weak, 0.0, Rubbing.moving)
        self._best = _Reality(1.0 - off, 1.0 - tolerance.object, 1.0 + weak, most, Rubbing.at_most, self._bound)

    def without(self, failed: int) -> Support:
        """What the others bear when this arm fails; there must be others."""
        others = [i for i in range(len(self._arms)) if i != failed]
        smooth, as_said = _Reality(1.0, 1.0, 1.0, 0.0, Rubbing.moving), _Reality(1.0, 1.0, 1.0, 1.0, Rubbing.at_rest)
        x = self._sag(failed, others, smooth, math.inf)
        limp = self._loads(others, x)
        crept = x if limp.most.share <= self._bound else self._sag(failed, others, smooth, self._bound)
        sags = [self._sizes(self._sag(failed, others, r, self._bound)) for r in (self._worst, as_said, self._best)]
        worst, expected, best = (float(sizes.max()) for sizes in sags)
        fate = Fate.HELD if worst <= HELD_SAG_M else Fate.MAY_FALL
        if min(worst, expected, best) > HELD_SAG_M:
            fate = Fate.NOT_HELD
        noticed_s = NOTICED_S if len(others) == 1 else NOTICED_MORE_S
        S, S_others = self._arms[failed].S, np.sum([self._arms[i].S for i in others], axis=0)
        locked_s = holding_s = tuple(math.inf for _ in x)
        if (feeling := self._feeling) is not None:
            ways = feeling.ways @ self._P.T
            locked, locked_s = self._until_felt(feeling, others, ways, noticed_s)
            holding, holding_s = self._until_felt(feeling, others, ways - self._given(S, S_others, ways), noticed_s)
        elif self._ahead is not None:
            gone = self._until_off_track(self._ahead)
            left = self._until_off_track(self._ahead @ np.linalg.solve(S + S_others, S).T)
            locked, holding = self._loads(others, -gone), self._loads(others, -left)
        return Support(
            noticed_s=noticed_s if feeling is not None else None,
            locked_s=locked_s,
            holding_s=holding_s,
            limp=limp,
            sag_m=expected,
            crept_m=max(expected, float(self._sizes(crept).max())),
            fate=fate,
            locked=locked,
            holding=holding,
            sag_along_m=tuple(sags[1].tolist()),
        )

    def _given(self, S: Matrix, S_others: Matrix, gone: Matrix) -> Matrix:
        """(T, A, m) by which an arm that holds gives way: it stays where S x + pull = S_others (gone − x)."""
        drawn, along = gone @ S_others.T, self._along[:, None]
        pull_N = np.clip(np.sum(drawn * along, axis=-1, keepdims=True), 0.0, self._brace_N)
        given: Matrix = (drawn - pull_N * along) @ np.linalg.inv(S + S_others).T
        return given

    def _until_felt(
        self, feeling: Feeling, others: Sequence[int], left: Matrix, least_s: float
    ) -> tuple[Loads, tuple[float, ...]]:
        """What the others give when one of them feels it, whose errors come to be left (T, A, m), and when, s."""
        lacks, every = np.gradient(left, STEP_S, axis=1), np.arange(len(left))
        arms = {i: self._arms[i] for i in others}
        pulls = {i: left @ arm.S.T + lacks @ np.swapaxes(arm.D, -1, -2) for i, arm in arms.items()}
        at, when = feeling.until_felt([pull @ self._P for pull in pulls.values()], least_s)
        beside = {i: applied(arm.D, lacks[every, at]) for i, arm in arms.items()}
        for i, arm in arms.items():
            if arm.G is not None:
                learnt = summed((lacks + left @ arm.KH.T) @ np.swapaxes(arm.G, -1, -2), arm.leak_per_s)
                beside[i] += learnt[every, at]
        return self._loads(others, -left[every, at], beside), tuple(when.tolist())

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
                    given = reality.torque * np.clip(wanted, -bound * arm.stall, bound * arm.stall)
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

    def _loads(self, others: Sequence[int], x: Matrix, beside: Mapping[int, Matrix] | None = None) -> Loads:
        """What the others give with the object at x (T, m); beside: wrenches (T, m) beside what holds it there."""
        if not np.isfinite(x).all():  # no way of the object balances the weights
            return unbearable(others, len(x))
        given = {i: self._arms[i].law(x)[0] for i in others}
        for i, wrench in (beside or {}).items():
            given[i] = given[i] + applied(self._arms[i].Jt, wrench)
        return loads({i: np.abs(tau) / self._arms[i].stall for i, tau in given.items()})

    def _sizes(self, x: Matrix) -> Vector:
        """(T,) displacements of the object, m; infinite where x is."""
        with np.errstate(invalid="ignore"):
            sizes: Vector = np.linalg.norm(x @ self._P[:, :3], axis=-1)
        return np.where(np.isfinite(x).all(axis=-1), sizes, math.inf)


def _units(v: Matrix) -> Matrix:
    """Rows (T, 3) of length one, or zero where there is no motion."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    units: Matrix = np.divide(v, length, out=np.zeros_like(v), where=length > 0.0)
    return units
