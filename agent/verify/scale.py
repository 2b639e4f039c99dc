"""Gains of law and observer relative to the configured ones, rounded to what a proposal prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from agent.control.errors import Gains
from agent.control.estimator import Observer
from drivers.interface import Vector

DIGITS: Final = 3  # of a proposed gain
FARTHEST: Final = 5.0  # natural logarithm of a factor
SLOPE_MAX_PER_S: Final = 1e3  # of what a surprise in position makes of velocity


@dataclass(frozen=True, slots=True)
class Scale:
    """Times the configured gains; every axis and every arm keeps its proportion."""

    LAW: ClassVar[int] = 5  # numbers that a search without an observer has
    SIZE: ClassVar[int] = 8

    pose: float = 1.0  # k_p, k_eps and their forms in v̇_r
    rate: float = 1.0  # the latter once more
    k_v_linear: float = 1.0
    k_v_angular: float = 1.0
    turn: float = 1.0  # k_eps and its form in v̇_r once more
    position_gain: float = 1.0  # of the observer, as the next two
    velocity_gain: float = 1.0
    velocity_from_position: float = 1.0

    @classmethod
    def at(cls, x: Vector) -> Scale:
        """Of a point of a search, the logarithms of the factors (LAW or SIZE of them)."""
        return cls(*np.exp(np.clip(x, -FARTHEST, FARTHEST)).tolist())

    def of(self, g: Gains) -> Gains:
        """These gains, scaled and rounded down to what a proposal prints."""
        turn = self.pose * self.turn
        return Gains(
            k_p=_times(g.k_p, self.pose),
            k_eps=_times(g.k_eps, turn),
            k_p_rate=_times(g.k_p_rate, self.pose * self.rate),
            k_eps_rate=_times(g.k_eps_rate, turn * self.rate),
            k_v=(*_times(g.k_v[:3], self.k_v_linear), *_times(g.k_v[3:], self.k_v_angular)),
        )

    def of_observer(self, observer: Observer | None) -> Observer | None:
        """This observer, scaled and rounded likewise; no share is above one."""
        if observer is None:
            return None
        return replace(
            observer,
            position_gain=_scaled(observer.position_gain, self.position_gain, 1.0),
            velocity_gain=_scaled(observer.velocity_gain, self.velocity_gain, 1.0),
            velocity_from_position_per_s=_scaled(
                observer.velocity_from_position_per_s, self.velocity_from_position, SLOPE_MAX_PER_S
            ),
        )


def _scaled(value: float, factor: float, most: float) -> float:
    return value if factor == 1.0 or value == 0.0 else min(rounded_down(value * factor), most)


def _times(values: Sequence[float], factor: float) -> tuple[float, float, float]:
    a, b, c = (x if factor == 1.0 else rounded_down(x * factor) for x in values)
    return a, b, c


def rounded_down(x: float) -> float:
    """To what a proposal prints."""
    unit = 10.0 ** (math.floor(math.log10(x)) + 1 - DIGITS)
    return float(f"{math.floor(x / unit + 1e-9) * unit:.{DIGITS}g}")
