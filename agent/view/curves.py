"""The curves beside the picture: figures over time, thin enough to be sent to a browser, with every peak in them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from agent.view.motion import ArmMotion, Motion
from agent.view.pose import Array, sizes

POINTS: Final = 400
BEYOND: Final = 1e6


@dataclass(frozen=True, slots=True)
class Curve:
    """One figure over the run."""

    title: str
    unit: str
    t: Array  # (n,) s
    lines: tuple[tuple[str, Array], ...]  # name and values (n,), NaN where there is none


def curves_of(motion: Motion) -> list[Curve]:
    """Error, disagreement of the arms, wrench and internal force, of the instants of a motion."""
    mm = {name: 1e3 * _apart(motion.object, arm.desired) for name, arm in motion.arms.items()}
    first = next(iter(mm))
    error = [("object − desired", mm[first])]
    pairs = list(combinations(motion.arms, 2))
    apart = [(f"{a} − {b}", 1e3 * _disagreement(motion.arms[a], motion.arms[b])) for a, b in pairs]
    force = [(name, sizes(arm.force_cmd)) for name, arm in motion.arms.items()]
    internal = [(name, sizes(arm.internal)) for name, arm in motion.arms.items()]
    every = [
        Curve("position error", "mm", motion.t, tuple(error)),
        Curve("arms disagree on the object by", "mm", motion.t, tuple(apart)),
        Curve("commanded force", "N", motion.t, tuple(force)),
        Curve("internal force", "N", motion.t, tuple(internal)),
    ]
    return [thinned(_numbers(curve)) for curve in every if curve.lines]


def _numbers(curve: Curve) -> Curve:
    """NaN where a value is none, or beyond all measure: a browser would show nothing at all."""
    lines = tuple((name, np.where(np.abs(values) < BEYOND, values, np.nan)) for name, values in curve.lines)
    return Curve(curve.title, curve.unit, curve.t, lines)


def thinned(curve: Curve, points: int = POINTS) -> Curve:
    """At most so many points: each stretch of time by the value that is furthest from zero."""
    n = len(curve.t)
    if n <= points:
        return curve
    starts = np.arange(points) * n // points
    lines = []
    for name, values in curve.lines:
        sized = np.where(np.isfinite(values), np.abs(values), -1.0)
        stretches = zip(starts, [*starts[1:], n], strict=True)
        lines.append((name, np.array([values[a + int(np.argmax(sized[a:b]))] for a, b in stretches])))
    return Curve(curve.title, curve.unit, curve.t[starts], tuple(lines))


def _disagreement(one: ArmMotion, other: ArmMotion) -> Array:
    """Of the instants at which both grasps are closed: an empty gripper sees no object."""
    return np.where(one.grasps & other.grasps, _apart(one.belief, other.belief), np.nan)


def _apart(a: Array, b: Array) -> Array:
    return sizes(a[:, :3] - b[:, :3])
