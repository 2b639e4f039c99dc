"""How arms that disagree about where the object is find together, each by itself and without a message.

Calibration errors make every arm see the object elsewhere.  Each follows the common motion shifted by (d, ρ), which at
the start is what it sees beside the pose that the cell states; all but one, the anchor, go on shifting towards what
they see, slowly and beyond a dead zone only, so that a lasting disagreement ends as an offset and not as a force:

    ḋ = α dz(e_p, d_0) − β (d − d_s),   ρ̇ = α dz(−2 e_η e_ε, ρ_0) − β (ρ − ρ_s),   |d| ≤ d_max, |ρ| ≤ ρ_max

with the errors (`eq:quat_error`) to the shifted pose; a shift beyond them at the start does not grow.  During the
motion it goes back (β) to what the start left, (d_s, ρ_s), or, where arms had no time before the start or a session has
taken their shifts away, to what they have found after a while.  An arm that all others have left would otherwise follow
its own lag, and the object would go on and on: its error does not become less by its shift, as that of arms does that
disagree.  The shift is a part of `Memory`, and frozen while an arm holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agent.control.errors import Errors
from agent.control.quaternion import Quat, Vec3, conjugate, multiply
from agent.control.trajectory import Desired

Shift = tuple[float, float, float, float, float, float]  # d (m) and ρ (rad, rotation vector), world axes
NO_SHIFT: Shift = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FOUND = 4.0  # time constants after which arms have found together
_SMALL_ANGLE = 1e-9


@dataclass(frozen=True, slots=True)
class Alignment:
    """Rates, dead zones and limits of one arm's shift."""

    follows: bool  # False: the anchor, whose shift stays what it was at the start
    ready_per_s: float = 2.0  # α while READY
    track_per_s: float = 0.3  # α while TRACK
    return_per_s: float = 0.3  # β while TRACK
    dead_zone_m: float = 1.5e-3
    dead_zone_rad: float = 8e-3
    max_m: float = 0.02
    max_rad: float = 0.1

    def advance(self, shift: Shift, settled: Shift, errors: Errors, dt: float, *, ready: bool) -> Shift:
        """The shift after dt seconds at this error; ready: before the start, when there is time to find together.

        settled: what the start left of it, to which it goes back during the motion; NO_SHIFT: to nothing yet.
        """
        if not self.follows:
            return shift
        gain = dt * (self.ready_per_s if ready else self.track_per_s)
        k, e_eps = -2.0 * errors.e_eta, errors.e_eps
        turned = (k * e_eps[0], k * e_eps[1], k * e_eps[2])
        d = _towards(shift[:3], errors.e_p, gain, self.dead_zone_m, self.max_m)
        rho = _towards(shift[3:], turned, gain, self.dead_zone_rad, self.max_rad)
        if ready or settled == NO_SHIFT:
            return (*d, *rho)
        return _less((*d, *rho), shift, settled, dt * self.return_per_s)

    def settle(self, settled: Shift, shift: Shift, since_s: float) -> Shift:
        """What the shift goes back to from then on, since_s into the motion without anybody taking shifts away."""
        if settled == NO_SHIFT and since_s * self.track_per_s >= FOUND:
            return shift
        return settled


def shifted(desired: Desired, shift: Shift) -> Desired:
    """The motion that an arm with this shift follows; twist and acceleration are those of all."""
    if shift is NO_SHIFT or shift == NO_SHIFT:
        return desired
    p = desired.p
    moved = (p[0] + shift[0], p[1] + shift[1], p[2] + shift[2])
    return Desired(moved, multiply(_quaternion(shift[3:]), desired.quat), desired.v, desired.a)


def between(p: Vec3, quat: Quat, p_from: Vec3, quat_from: Quat) -> Shift:
    """The shift that takes the second pose to the first."""
    w, x, y, z = multiply(quat, conjugate(quat_from))
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    size = _size((x, y, z))
    k = 2.0 if size < _SMALL_ANGLE else 2.0 * math.atan2(size, w) / size
    return (p[0] - p_from[0], p[1] - p_from[1], p[2] - p_from[2], k * x, k * y, k * z)


def _towards(now: Vec3, error: Vec3, gain: float, dead_zone: float, bound: float) -> Vec3:
    size = _size(error)
    if not size > dead_zone:  # also when the error is no number
        return now
    bound = max(bound, _size(now))  # a start from beyond goes no further, and is not torn back
    k = gain * (size - dead_zone) / size
    moved = (now[0] + k * error[0], now[1] + k * error[1], now[2] + k * error[2])
    length = _size(moved)
    if length <= bound:
        return moved
    return (moved[0] * bound / length, moved[1] * bound / length, moved[2] * bound / length)


def _less(x: Shift, a: Shift, b: Shift, k: float) -> Shift:
    """x − k (a − b)."""
    return (
        x[0] - k * (a[0] - b[0]), x[1] - k * (a[1] - b[1]), x[2] - k * (a[2] - b[2]),
        x[3] - k * (a[3] - b[3]), x[4] - k * (a[4] - b[4]), x[5] - k * (a[5] - b[5]),
    )  # fmt: skip


def _quaternion(rho: Vec3) -> Quat:
    angle = _size(rho)
    if angle < _SMALL_ANGLE:
        return (1.0, 0.5 * rho[0], 0.5 * rho[1], 0.5 * rho[2])
    s = math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), s * rho[0], s * rho[1], s * rho[2])


def _size(v: Vec3) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
