"""How a hold is kept: by the law, by a brake, or by the joints alone; pure functions of a tick and its memory.

A hold brakes when a joint is faster than it may be.  By the observer that is told late where the torque does not do
what was asked for, so two signs more count, both with the servos' own speed: the observer believes in a motion that is
not there (its law asks for more than the arm can give, as gains that are too large do), and an arm whose torque is at
its bound is too fast (somebody pulls harder than it can hold).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.control.memory import Memory
from agent.control.terms import Terms
from drivers.interface import Vector

LAW, BRAKE, JOINTS = 0, 1, 2  # Memory.calm; above JOINTS: gently, for so many ticks more
BRAKE_PER_S = 30.0  # of a hold that became too fast, times the arm's inertia; less where four periods are longer
RESUME_SHARE = 0.2  # of the speed above which it brakes, below which it holds again, by its joints
DOUBT_SHARE = 1.0 / 3.0  # of that speed, by which the observer may believe in more than there is
AT_BOUND = 0.999  # of the largest torque


def kept(dq: Vector, measured: Vector, memory: Memory, tau_max_Nm: Sequence[float], above_rad_per_s: float) -> int:
    """How a hold is kept in this tick; dq, measured: (n,) the observer's and the servos' joint velocities.

    By the law, until a joint is faster than `above_rad_per_s`, or the law does not get what it asks for; then it brakes
    until it is nearly at rest, and holds its joints from then on.  Gently after states that came too rarely.
    """
    if memory.calm > JOINTS:
        return memory.calm - 1
    believed = dq.tolist()
    fastest: float = max(map(abs, believed))
    if memory.calm == BRAKE:
        return BRAKE if fastest > RESUME_SHARE * above_rad_per_s else JOINTS
    seen = measured.tolist()
    if fastest > above_rad_per_s or (
        max(map(abs, seen)) > above_rad_per_s and _at_bound(memory.tau.tolist(), tau_max_Nm)
    ):
        return BRAKE
    if memory.calm == LAW and _imagined(believed, seen, DOUBT_SHARE * above_rad_per_s):
        return BRAKE
    return memory.calm


def _at_bound(tau_Nm: Sequence[float], tau_max_Nm: Sequence[float]) -> bool:
    return any(abs(tau) >= AT_BOUND * most for tau, most in zip(tau_Nm, tau_max_Nm, strict=True))


def _imagined(believed: Sequence[float], seen: Sequence[float], most: float) -> bool:
    """Whether the observer believes in a motion that the servos do not see; a push is the other way round."""
    return any(abs(x) > abs(y) and abs(x - y) > most for x, y in zip(believed, seen, strict=True))


def brake_per_s(period_s: float) -> float:
    """Of the arm's inertia, that a brake gives at any sampling."""
    return min(BRAKE_PER_S, 0.25 / period_s)


def braking(terms: Terms, dq: Vector, rate_per_s: float) -> Vector:
    """(n,) weight and load share, and a torque against the motion dq (n,)."""
    tau: Vector = terms.tau_object - rate_per_s * terms.kinematics.B.dot(dq) + terms.kinematics.g
    return tau


def slowed(dq: Vector, rate_per_s: float, wanted: Vector, limited: Vector) -> Vector:
    """(n,) acceleration that a brake asks for; none is expected of a joint whose torque was limited on its way out."""
    ddq: Vector = np.where(limited == wanted, -rate_per_s * dq, 0.0)
    return ddq
