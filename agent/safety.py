"""The last word on every torque: finite, bounded, rate-limited.

Finiteness comes first, because clipping lets NaN through.  Whatever the numbers are, a torque comes out for every
joint; only a wrong count of them raises, and `agent.loop.Agent` refuses wrong counts before the first tick.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

AT_BOUND = 0.999  # of the largest torque, or of its largest step: from there on a torque is at it


class Flag(enum.IntFlag):
    """What happened on this tick; bits of the log field `flags`."""

    NONE = 0
    NOT_FINITE = 1  # the law gave no number: the last torque was kept
    SATURATED = 2  # at least one joint hit its torque bound
    RATE_LIMITED = 4  # at least one joint hit its torque step bound
    SINGULAR = 8  # the object Jacobian was not safely invertible
    STALE = 16  # no fresh state this tick: the last torque was kept, unless BLIND
    ADAPTATION_SATURATED = 32  # an estimate of the adaptive law was held at its bound
    OFF_TRACK = 64  # the object does not follow: by this arm's kinematics it is too far from where it should be
    UNEXPECTED = 128  # more acts on the arm than its load share and the cell explain (agent.control.residual)
    DAMPED = 256  # the arm became too fast in a hold: it only brakes
    BLIND = 512  # no state for too long: the arm's weight and load share at the last pose, unless nothing was sent
    RESUMED = 1024  # the servos' watchdogs had fired and are armed again: torque began at zero, the hold where it was
    GAP = 2048  # cycles were missing before this one: what the arm holds begins here
    GENTLE = 4096  # a hold by joint angles, because the arm became too fast or states came too rarely


# Joining two flags takes half a microsecond, joining their numbers and looking up the flag a tenth of that.
_NONE, _NOT_FINITE, _SATURATED, _RATE_LIMITED = map(
    int, (Flag.NONE, Flag.NOT_FINITE, Flag.SATURATED, Flag.RATE_LIMITED)
)
_FLAGS = tuple(map(Flag, range((_NOT_FINITE | _SATURATED | _RATE_LIMITED) + 1)))


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one arm; sequences of length n."""

    tau_max_Nm: tuple[float, ...]
    tau_step_max_Nm: tuple[float, ...]  # largest change from one tick to the next


def limit(tau_cmd: Sequence[float], tau_last: Sequence[float], limits: Limits) -> tuple[list[float], Flag]:
    """Torque that may be sent, from the commanded one and the last one sent (all length n, N·m).

    Raises ValueError when the lengths differ: a shorter torque would be worse.
    """
    flags = _NONE
    rate_limited = saturated = False
    tau: list[float] = []
    isfinite = math.isfinite
    for wanted, last, bound, step in zip(tau_cmd, tau_last, limits.tau_max_Nm, limits.tau_step_max_Nm, strict=True):
        if not isfinite(wanted):
            flags |= _NOT_FINITE
            tau.append(last)
            continue
        allowed = wanted
        if allowed > last + step:
            allowed, rate_limited = last + step, True
        elif allowed < last - step:
            allowed, rate_limited = last - step, True
        if allowed > bound:
            allowed, saturated = bound, True
        elif allowed < -bound:
            allowed, saturated = -bound, True
        tau.append(allowed)
    if rate_limited:
        flags |= _RATE_LIMITED
    if saturated:
        flags |= _SATURATED
    return tau, _FLAGS[flags]
