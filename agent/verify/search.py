"""Climbs as high as constraints allow: a random search that learns in which directions steps succeed.

The (1+1) evolution strategy with covariance adaptation and constraint handling of D. V. Arnold and N. Hansen, "A
(1+1)-CMA-ES for constrained optimisation", GECCO 2012: a step that succeeds stretches the distribution along it, a step
that breaks a constraint shrinks it along the mean of the steps that broke the same one.  The same seed climbs the same
way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable
from typing import NamedTuple

import numpy as np

from drivers.interface import Vector

STEP, STEP_MIN = 0.2, 1e-4  # of the first try, and when a new distribution begins
TARGET, AVERAGED = 2.0 / 11.0, 1.0 / 12.0  # share of tries that succeed, and the weight of one in it
PATH_FULL = 0.44  # share of successes above which steps are too short to learn from


class Miss(NamedTuple):
    """By how much a point misses what must hold, at most zero when it does; and the constraint that says so."""

    excess: float
    of: Hashable


class Found(NamedTuple):
    """Where a climb ended."""

    x: Vector
    miss: Miss


def climb(
    x: Vector,
    value: Callable[[Vector], float],
    missed: Callable[[Vector, float], Miss],
    tries: Iterable[object],
    random: np.random.Generator,
) -> Found:
    """The largest value found that misses nothing; while none is found, the smallest miss.

    missed(x, enough): may stop at a miss above `enough`.  tries: one step for each.
    """
    steps, here, at_x = _Steps(len(x)), value(x), missed(x, math.inf)
    for _ in tries:
        if steps.spent:
            steps = _Steps(len(x))
        step, z = steps.draw(random)
        kept = at_x.excess <= 0.0
        if kept and value(x + step) < here:
            step, z = -step, -z  # the other way is up
        y = x + step
        at_y = missed(y, max(0.0, at_x.excess))
        if at_y.excess <= 0.0 if kept else at_y.excess < at_x.excess:
            x, here, at_x = y, value(y), at_y
            steps.succeeded(z)
        else:
            steps.failed(at_y.of if kept else None, z)
    return Found(x, at_x)


class _Steps:
    """Distribution of the steps σ A z, z normal."""

    def __init__(self, n: int) -> None:
        self._n, self._sigma, self._A = n, STEP, np.eye(n)
        self._success, self._path = TARGET, np.zeros(n)
        self._broken: dict[Hashable, Vector] = {}

    def draw(self, random: np.random.Generator) -> tuple[Vector, Vector]:
        """A step, and its z."""
        z = random.normal(size=self._n)
        return self._sigma * (self._A @ z), z

    @property
    def spent(self) -> bool:
        """Whether the steps have become too short to lead anywhere."""
        return self._sigma < STEP_MIN

    def succeeded(self, z: Vector) -> None:
        """It was taken."""
        self._measure(1.0)
        c, rate = 2.0 / (self._n + 2.0), 2.0 / (self._n**2 + 6.0)
        self._path *= 1.0 - c
        if self._success < PATH_FULL:
            self._path += math.sqrt(c * (2.0 - c)) * (self._A @ z)
        w = np.linalg.solve(self._A, self._path)
        length, keep = max(float(w @ w), 1e-12), math.sqrt(1.0 - rate)
        self._A = keep * self._A + (keep / length) * (math.sqrt(1.0 + rate * length / keep**2) - 1.0) * np.outer(
            self._path, w
        )

    def failed(self, constraint: Hashable | None, z: Vector) -> None:
        """It was not; constraint: what it broke, None when it broke nothing new."""
        self._measure(0.0)
        if constraint is None:
            return
        c, shrink = 1.0 / (self._n + 2.0), 0.1 / (self._n + 2.0)
        v = (1.0 - c) * self._broken.get(constraint, np.zeros(self._n)) + c * (self._A @ z)
        self._broken[constraint] = v
        w = np.linalg.solve(self._A, v)
        self._A = self._A - (shrink / max(float(w @ w), 1e-12)) * np.outer(v, w)

    def _measure(self, success: float) -> None:
        self._success += AVERAGED * (success - self._success)
        damping = 1.0 + self._n / 2.0
        self._sigma *= math.exp((self._success - TARGET) / (1.0 - TARGET) / damping)
