"""A way in joint space with a beginning and an end at rest, and how an arm travels it from wherever it stands; pure.

A path is made of legs, each at rest at both ends and timed by the minimum-jerk law s(t) of
`agent.control.trajectory_rest`.  A journey along it may begin anywhere and go either way: its clock σ starts from a
standstill within `ease_s`, and what the arm was beside the path at the beginning is taken away by the same law,

    q_d = path(σ(age)) + (q_0 − path(σ_0)) (1 − s(age / ease_s)),

so that position, speed and acceleration are continuous, and those of the path at its end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agent.control.models import Matrix
from agent.control.trajectory_rest import minimum_jerk
from drivers.interface import Vector

SAMPLES_PER_LEG = 64  # among which the nearest place of a path is looked for


class JointDesired(NamedTuple):
    """What the joints are to do now, each (n,)."""

    q: Vector  # rad
    dq: Vector  # rad/s
    ddq: Vector  # rad/s²


class Place(NamedTuple):
    """A place of a path, and how far the farthest joint is from it."""

    s: float  # s from the path's beginning
    off_rad: float


@dataclass(frozen=True, eq=False)
class Leg:
    """Through knots (K, n) at even steps of its parameter, at rest at both ends.  Raises ValueError below two knots."""

    knots: Matrix
    seconds: float
    _slopes: Matrix = field(init=False, repr=False)  # of the natural cubic spline

    def __post_init__(self) -> None:
        knots = np.array(self.knots, dtype=np.float64)
        if len(knots) < 2 or not self.seconds > 0.0:
            raise ValueError(f"a leg of {len(knots)} knots in {self.seconds} s")
        knots.flags.writeable = False
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "_slopes", _slopes(knots))

    def at(self, t: float) -> JointDesired:
        """Where the joints are t seconds into the leg; outside of it at rest at its end."""
        s, ds, dds = minimum_jerk(t, self.seconds)
        last = len(self.knots) - 1
        place = min(int(s * last), last - 1)
        x = s * last - place
        (a, b), (m, n) = self.knots[place : place + 2], self._slopes[place : place + 2]
        c2, c3 = 3.0 * (b - a) - 2.0 * m - n, 2.0 * (a - b) + m + n
        q = a + x * (m + x * (c2 + x * c3))
        first = last * (m + x * (2.0 * c2 + 3.0 * x * c3))
        second = last * last * (2.0 * c2 + 6.0 * x * c3)
        return JointDesired(q, ds * first, dds * first + ds * ds * second)


def _slopes(knots: Matrix) -> Matrix:
    """(K, n) slopes with which cubics between the knots have continuous second derivatives, none at the ends."""
    count = len(knots)
    system = np.diag(np.full(count, 4.0)) + np.diag(np.ones(count - 1), 1) + np.diag(np.ones(count - 1), -1)
    system[0, 0] = system[-1, -1] = 2.0
    rises = np.zeros_like(knots)
    rises[:-1] += knots[1:] - knots[:-1]
    rises[1:] += knots[1:] - knots[:-1]
    return np.linalg.solve(system, 3.0 * rises)


@dataclass(frozen=True, eq=False)
class JointPath:
    """Legs one after the other, each of which begins where the one before it ends."""

    legs: tuple[Leg, ...]
    _begins: tuple[float, ...] = field(init=False, repr=False)
    _samples: tuple[Vector, Matrix] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        begins, total = [], 0.0
        for leg in self.legs:
            begins.append(total)
            total += leg.seconds
        object.__setattr__(self, "_begins", (*begins, total))
        times = np.linspace(0.0, total, SAMPLES_PER_LEG * len(self.legs) + 1)
        object.__setattr__(self, "_samples", (times, np.array([self.at(t).q for t in times.tolist()])))

    @property
    def seconds(self) -> float:
        """How long the whole of it takes."""
        return self._begins[-1]

    def at(self, s: float) -> JointDesired:
        """Where the joints are s seconds into the path; outside of it at rest at its ends."""
        last = len(self.legs) - 1
        k = next((k for k in range(last) if s < self._begins[k + 1]), last)
        return self.legs[k].at(s - self._begins[k])

    def nearest(self, q: Vector) -> Place:
        """The sampled place from which no joint is as far as from any other, and that distance; q (n,)."""
        times, places = self._samples
        off = np.abs(places - q).max(axis=1)
        k = int(off.argmin())
        return Place(float(times[k]), float(off[k]))


@dataclass(frozen=True, slots=True)
class Journey:
    """From a standstill at q_from to one end of a path."""

    path: JointPath
    q_from: Vector
    forward: bool  # to the end of the path; else back to its beginning
    ease_s: float

    def at(self, age_s: float) -> JointDesired:
        """What the joints are to do age_s after the beginning."""
        begin = self.path.nearest(self.q_from).s
        way, rate, rate_per_s = _eased(age_s, self.ease_s)
        sign = 1.0 if self.forward else -1.0
        q, dq, ddq = self.path.at(begin + sign * way)
        s, ds, dds = minimum_jerk(age_s, self.ease_s)
        beside = self.q_from - self.path.at(begin).q
        return JointDesired(
            q + (1.0 - s) * beside,
            sign * rate * dq - ds * beside,
            rate * rate * ddq + sign * rate_per_s * dq - dds * beside,
        )

    def seconds(self) -> float:
        """How long it takes."""
        begin = self.path.nearest(self.q_from).s
        way = self.path.seconds - begin if self.forward else begin
        return max(self.ease_s, way + 0.5 * self.ease_s)


def _eased(age_s: float, ease_s: float) -> tuple[float, float, float]:
    """Way of a clock that starts within ease_s, its rate (0 to 1) and what that grows by per second."""
    if age_s >= ease_s:
        return age_s - 0.5 * ease_s, 1.0, 0.0
    rate, rate_per_s, _ = minimum_jerk(age_s, ease_s)
    u = max(0.0, age_s / ease_s)
    return ease_s * u**4 * (2.5 - 3.0 * u + u * u), rate, rate_per_s


def straight(q_from: Vector, q_to: Vector, speed_max_rad_per_s: float, least_s: float) -> Leg:
    """From one place to another, no joint faster than speed_max_rad_per_s; in least_s where it is short."""
    return timed(np.array([q_from, q_to]), speed_max_rad_per_s, least_s)


def timed(knots: Matrix, speed_max_rad_per_s: float, least_s: float) -> Leg:
    """Through knots (K, n) in the time that keeps the fastest joint at speed_max_rad_per_s or below."""
    leg = Leg(knots, 1.0)
    fastest = max(float(np.abs(leg.at(t).dq).max()) for t in np.linspace(0.0, 1.0, 8 * len(knots) + 1).tolist())
    return Leg(knots, max(least_s, round(1.01 * fastest / speed_max_rad_per_s, 3)))
