"""Motion through timed poses, smooth to the fourth derivative and at rest at both ends; pure.

Position and quaternion are quintic splines in R³ and R⁴; the quaternion is normalised where it is used.  The
spline is linear in its poses, so it does not depend on where the world frame is put: turning all poses turns the
motion.  With s the spline of the quaternion, q = s/|s| and, in world axes,

    ω = 2 vec(s' s*) / |s|²,    dω/dt = 2 vec(s'' s*) / |s|² − 2 (s·s') ω / |s|² .

Two poses alone give the minimum-jerk line.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from agent.control.quaternion import Quat, Vec3, angle_between
from agent.control.trajectory import Desired
from drivers.interface import Refusal

if TYPE_CHECKING:  # a motion is needed where no arm is computed
    from agent.control.models import Matrix
    from drivers.interface import Vector

CLOSEST_S = 1e-4  # between neighbouring poses
FARTHEST_RAD = 2.6  # between neighbouring attitudes; at half a turn there is no shorter way round
SMALLEST_NORM = 0.5  # of the quaternion spline, which swings far out between large turns at uneven times
_SAMPLES_PER_SEGMENT = 6


class TrajectoryError(Refusal):
    """The described motion cannot be used."""


class PoseSpline:
    """The motion through poses (p, quat) at strictly increasing times (s); before and after, at rest.

    Raises TrajectoryError when times do not increase or neighbouring attitudes are too far apart.
    """

    def __init__(self, times_s: Sequence[float], positions: Sequence[Vec3], quats: Sequence[Quat]) -> None:
        _refuse_close_times(times_s)
        _refuse_far_attitudes(times_s, quats)
        self._times = [float(t) for t in times_s]
        values = np.hstack([np.array(positions), same_hemisphere(np.array(quats))])
        self._last = values[-1]
        # (segment, power of time since its start; value of p and s, then their rates, then their second rates)
        coefficients = quintic(self._times, values)
        power = np.arange(6.0)[None, :, None]
        rates, accelerations = np.zeros_like(coefficients), np.zeros_like(coefficients)
        rates[:, :5] = (power * coefficients)[:, 1:]
        accelerations[:, :4] = (power * (power - 1.0) * coefficients)[:, 2:]
        self._segments = list(np.concatenate([coefficients, rates, accelerations], axis=2))
        _refuse_small_norm(self._times, self._segments)

    @property
    def times_s(self) -> Sequence[float]:
        """Times of the poses."""
        return self._times

    @property
    def period_s(self) -> float:
        """Time of the last pose."""
        return self._times[-1]

    def quickest(self, count: int, end_s: float, shorter_s: float) -> list[tuple[float, float]]:
        """Begin and length, s, of segments shorter than shorter_s that begin before end_s.

        At most `count` of the largest mean speed, and as many of the largest mean rate of the quaternion.
        """
        lengths = np.diff(np.array(self._times))
        ends = np.array([segment[0, :7] for segment in self._segments] + [self._last])
        rates = np.diff(ends, axis=0) / lengths[:, None]
        short = np.flatnonzero((lengths < shorter_s) & (np.array(self._times[:-1]) < end_s))
        sizes = np.linalg.norm(rates[short, :3], axis=1), np.linalg.norm(rates[short, 3:], axis=1)
        chosen = sorted({int(short[k]) for size in sizes for k in np.argsort(size)[-count:]})
        return [(self._times[k], float(lengths[k])) for k in chosen]

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        times = self._times
        t = min(max(t, times[0]), times[-1])
        k = min(bisect_right(times, t), len(times) - 1) - 1
        x = t - times[k]
        x2 = x * x
        x3 = x2 * x
        numbers = np.array((1.0, x, x2, x3, x2 * x2, x2 * x3)).dot(self._segments[k]).tolist()
        px, py, pz, w, i, j, l, vx, vy, vz, dw, di, dj, dl, ax, ay, az, ddw, ddi, ddj, ddl = numbers  # noqa: E741
        square = w * w + i * i + j * j + l * l
        n, f = 1.0 / math.sqrt(square), 2.0 / square
        g = f * (w * dw + i * di + j * dj + l * dl)
        wx = f * (w * di - i * dw + j * dl - l * dj)  # eq:propagation rule_2
        wy = f * (w * dj - j * dw + l * di - i * dl)  # eq:propagation rule_2
        wz = f * (w * dl - l * dw + i * dj - j * di)  # eq:propagation rule_2
        return Desired(
            p=(px, py, pz),
            quat=(n * w, n * i, n * j, n * l),
            v=(vx, vy, vz, wx, wy, wz),
            a=(
                ax,
                ay,
                az,
                f * (w * ddi - i * ddw + j * ddl - l * ddj) - g * wx,
                f * (w * ddj - j * ddw + l * ddi - i * ddl) - g * wy,
                f * (w * ddl - l * ddw + i * ddj - j * ddi) - g * wz,
            ),
        )


def _refuse_close_times(times_s: Sequence[float]) -> None:
    for k, (before, after) in enumerate(pairwise(times_s)):
        if not after - before >= CLOSEST_S:
            raise TrajectoryError(
                f"time of pose {k + 2}",
                found=f"{after:g} s after {before:g} s",
                expected=f"times that increase, by {CLOSEST_S:g} s at least",
                remedy="put the poses in order, one per instant",
            )


def _refuse_far_attitudes(times_s: Sequence[float], quats: Sequence[Quat]) -> None:
    for k, (before, after) in enumerate(pairwise(quats)):
        angle = angle_between(before, after)
        if angle > FARTHEST_RAD:
            raise TrajectoryError(
                f"attitudes at {times_s[k]:g} s and {times_s[k + 1]:g} s",
                found=f"{angle:.3g} rad apart",
                expected=f"at most {FARTHEST_RAD:g} rad",
                remedy="add a pose in between",
            )


def _refuse_small_norm(times_s: Sequence[float], segments: Sequence[Matrix]) -> None:
    for k, segment in enumerate(segments):
        x = np.linspace(0.0, times_s[k + 1] - times_s[k], _SAMPLES_PER_SEGMENT, endpoint=False)
        norm = float(np.linalg.norm(np.vander(x, 6, increasing=True) @ segment[:, 3:7], axis=1).min())
        if norm < SMALLEST_NORM:
            raise TrajectoryError(
                f"attitudes between {times_s[k]:g} s and {times_s[k + 1]:g} s",
                found=f"turns so large and uneven that their interpolation shrinks to {norm:.2f}",
                expected=f"at least {SMALLEST_NORM:g}",
                remedy="add a pose in between, or space the times evenly",
            )


def quintic(times_s: Sequence[float], values: Matrix) -> Matrix:
    """Quintic spline through values (k, m), at rest at both ends: coefficients (k - 1, 6, m).

    They are those of the powers of the time since each segment's start.
    Of all motions through these values it has the least ∫ ‖third derivative‖² dt.  On one segment of length h that is a
    quadratic form in the rates and second rates at its ends, so their sum has one minimum: a banded linear system.
    """
    h = np.diff(np.array(times_s, dtype=float))
    step = np.diff(values, axis=0) / h[:, None]
    rates = np.zeros((len(times_s), 2, values.shape[1]))
    if len(times_s) > 2:
        rates[1:-1] = _inner_rates(h, step)
    v0, a0, v1, a1 = rates[:-1, 0], rates[:-1, 1], rates[1:, 0], rates[1:, 1]
    h = h[:, None]
    third = (10.0 * step - 6.0 * v0 - 4.0 * v1 - (1.5 * a0 - 0.5 * a1) * h) / h**2
    fourth = (-15.0 * step + 8.0 * v0 + 7.0 * v1 + (1.5 * a0 - a1) * h) / h**3
    fifth = (6.0 * step - 3.0 * (v0 + v1) - 0.5 * (a0 - a1) * h) / h**4
    coefficients: Matrix = np.stack([values[:-1], v0, 0.5 * a0, third, fourth, fifth], axis=1)
    return coefficients


def _inner_rates(h: Vector, step: Matrix) -> Matrix:
    """Rates and second rates (k - 2, 2, m) between segments of length h (k - 1,) and mean rate `step` (k - 1, m)."""
    from agent.control import lapack  # noqa: PLC0415 - a telemetry process without poses has no need of it

    vv, va, aa, vv_, va_, aa_ = 192.0 / h**3, 36.0 / h**2, 9.0 / h, 168.0 / h**3, 24.0 / h**2, -3.0 / h
    count = 2 * (len(h) - 1)
    bands = np.zeros((4, count))  # of the symmetric matrix; row 3 - d: d places beside the diagonal
    bands[3, 0::2] = vv[:-1] + vv[1:]
    bands[3, 1::2] = aa[:-1] + aa[1:]
    bands[2, 1::2] = va[1:] - va[:-1]
    bands[2, 2::2] = va_[1:-1]
    bands[1, 2::2] = vv_[1:-1]
    bands[1, 3::2] = aa_[1:-1]
    bands[0, 3::2] = -va_[1:-1]
    pull = np.zeros((count, step.shape[1]))
    curved, bent = 360.0 * step / h[:, None] ** 3, 60.0 * step / h[:, None] ** 2
    pull[0::2] = curved[:-1] + curved[1:]
    pull[1::2] = bent[1:] - bent[:-1]
    _, solution, info = lapack.dpbsv(bands, pull)
    assert info == 0, "a form that is positive"
    return solution.reshape(len(h) - 1, 2, step.shape[1])  # type: ignore[no-any-return]


def same_hemisphere(quats: Matrix) -> Matrix:
    """Quaternions (k, 4) of the same attitudes with no sign flip from one to the next."""
    flips = np.where(np.einsum("ij,ij->i", quats[1:], quats[:-1]) < 0.0, -1.0, 1.0)
    signed: Matrix = quats * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    return signed
