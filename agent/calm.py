"""How a hold is kept: by the law, by a brake, or by the joints alone; pure functions of a tick and its memory.

A hold brakes when a joint is faster than it may be.  By the observer that is told late where the torque does not do
what was asked for, so four signs more count: the observer believes in a motion that the servos do not see, and the
torque steps as far as it may (the law asks for more than the arm can give, as gains that are too large do); the servos
see too fast a joint of an arm whose torque is at its bound, or one that is much too fast (somebody is stronger).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.control.memory import Memory
from agent.control.terms import Terms
from agent.safety import AT_BOUND, Limits
from drivers.interface import Vector

LAW, BRAKE, JOINTS = 0, 1, 2  # Memory.calm; above JOINTS: gently, for so many ticks more
BRAKE_PER_S = 30.0  # of a hold that became too fast, times the arm's inertia; less where four periods are longer
SEEN_TIMES = 1.3  # of the speed above which it brakes, above which it does so by the servos' own count alone
RESUME_SHARE = 0.2  # of the speed above which it brakes, below which it holds again, by its joints
DOUBT_SHARE = 1.0 / 3.0  # of that speed, by which the observer may believe in more than there is


def kept(dq: Vector, measured: Vector, memory: Memory, limits: Limits, above_rad_per_s: float) -> int:
    """How a hold is kept in this tick; dq, measured: (n,) the observer's and the servos' joint velocities.

    By the law, until a joint is faster than `above_rad_per_s`, or the law does not get what it asks for; then it brakes
    until it is nearly at rest, and holds its joints from then on.  Gently while states come too rarely.
    """
    if memory.calm > JOINTS:
        return memory.calm - 1
    believed = dq.tolist()
    fastest: float = max(map(abs, believed))
    if memory.calm == BRAKE:
        return BRAKE if fastest > RESUME_SHARE * above_rad_per_s else JOINTS
    seen = measured.tolist()
    moves: float = max(map(abs, seen))
    if (
        fastest > above_rad_per_s
        or moves > SEEN_TIMES * above_rad_per_s
        or (moves > above_rad_per_s and _at_bound(memory.tau.tolist(), limits.tau_max_Nm))
    ):
        return BRAKE
    if (
        memory.calm == LAW
        and not memory.missed
        and (  # a law that was not heard for a while has something to make up
            _imagined(believed, seen, DOUBT_SHARE * above_rad_per_s)
            or _at_bound((memory.tau - memory.tau_before).tolist(), limits.tau_step_max_Nm)
        )
    ):
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


def felt(dq: Vector, measured: Vector) -> Vector:
    """(n,) the speeds to brake, of the observer's and the servos' the larger: a push is news to an observer."""
    speed: Vector = np.where(np.abs(measured) > np.abs(dq), measured, dq)
    return speed


def braking(terms: Terms, dq: Vector, rate_per_s: float) -> Vector:
    """(n,) weight and load share, and a torque against the motion dq (n,)."""
    tau: Vector = terms.tau_object - rate_per_s * terms.kinematics.B.dot(dq) + terms.kinematics.g
    return tau


def slowed(dq: Vector, rate_per_s: float, wanted: Vector, limited: Vector) -> Vector:
    """(n,) acceleration that a brake asks for; none is expected of a joint whose torque was limited on its way out."""
    ddq: Vector = np.where(limited == wanted, -rate_per_s * dq, 0.0)
    return ddq
