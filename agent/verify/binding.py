"""Which stated tolerance binds where no gains are found, and how much of it may stay.

A short search from where the failed one ended proposes how much.  What is named has been tried by the search that
`coop tune` will do of the cell that states it: from the configured or usual gains, with as many tries.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from agent.verify.criterion.bodies import Pose
from agent.verify.criterion.cases import Loop, Ranges
from agent.verify.stiffest import KEEPS, Search, Wanted

TOLD: Final = 3  # that are enough, at most
HALVINGS: Final = 3  # of the part of what binds that can stay
TRIED: Final = 10  # searches at most, one more for two together

Stated = Mapping[str, Ranges]  # by key, the ranges of which the cell is to state that key
Tried = Callable[[Stated], float]  # radius that the search of `coop tune` comes to then; 0: it finds gains; inf: none


@dataclass(frozen=True)
class Binding:
    """Which of the stated tolerances bind."""

    enough: tuple[Stated, ...] = ()  # gains are found with each of these, of several keys with all of it
    nearest: tuple[Stated, float] | None = None  # where nothing is: what came nearest by itself, and its radius
    pair: Stated | None = None  # which is not enough either


def binding(poses: Sequence[Pose], loop: Loop, ranges: Ranges, wanted: Wanted, inertia: str, tried: Tried) -> Binding:
    """Less of a stated tolerance with which gains are found: up to three, that of which the most can stay first.

    Where that is not enough of any, as much of one as may stay beside none of it; else of the two that come nearest.

    loop: where the failed search ended.  inertia: the key that states the arms' error.
    """
    narrowed = {key if key != "inertia" else inertia: narrow for key, narrow in _narrowed(ranges).items()}
    narrowed = {key: narrow for key, narrow in narrowed.items() if narrow(0.0) != ranges}
    bound = wanted.radius * (1.0 + KEEPS)

    def radius(key: str, part: float) -> float:
        return Search(poses, loop, narrowed[key](part), wanted).nearest()

    radii = {key: radius(key, 0.0) for key in narrowed}
    parts = {
        key: _most(key, lambda key, part: radius(key, part) <= bound) if r <= bound else 0.0 for key, r in radii.items()
    }
    trials = _Trials(tried)
    for key in sorted(narrowed, key=lambda key: -parts[key]):
        if parts[key] > 0.0 and len(trials.found) < TOLD:
            trials.hold({key: narrowed[key](parts[key])})
    if trials.found:
        return Binding(tuple(trials.found))
    short = {key: trials.short.get(key, radii[key] if parts[key] == 0.0 else math.inf) for key in narrowed}
    for key in sorted(narrowed, key=lambda key: (parts[key] > 0.0, short[key])):
        if trials.hold({key: narrowed[key](0.0)}):
            part = _most(key, lambda key, part: trials.hold({key: narrowed[key](part)}))
            return Binding(({key: narrowed[key](part)},))
    return trials.together()


class _Trials:
    """What was tried by the search of the command, as often as there is time for."""

    def __init__(self, tried: Tried) -> None:
        self._tried, self._left = tried, TRIED
        self.found: list[Stated] = []
        self.short: dict[str, float] = {}  # radius of what was tried last of each key, not enough
        self._last: dict[str, Stated] = {}

    def hold(self, stated: Stated) -> bool:
        """Whether gains are found with this, of one key; not where there is no time to try."""
        if not self._left:
            return False
        radius, (key,) = self._tried(stated), stated
        if radius == 0.0:
            self.found.append(stated)
        elif math.isfinite(radius):
            self.short[key], self._last[key] = radius, stated
        self._left -= math.isfinite(radius)
        return radius == 0.0

    def together(self) -> Binding:
        """The two that came nearest by what was tried last of each, tried together."""
        ranked = sorted(self.short, key=lambda key: self.short[key])[:2]
        if not ranked:
            return Binding()
        nearest = self._last[ranked[0]], self.short[ranked[0]]
        if len(ranked) == 1:
            return Binding(nearest=nearest)
        pair = {key: self._last[key][key] for key in ranked}
        return Binding(nearest=nearest, pair=pair) if self._tried(pair) else Binding((pair,))


def _most(key: str, holds: Callable[[str, float], bool]) -> float:
    """The largest of the parts looked at with which it holds; with none at all it is known to."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        part = 0.5 * (low + high)
        low, high = (part, high) if holds(key, part) else (low, part)
    return low


def _narrowed(ranges: Ranges) -> dict[str, Callable[[float], Ranges]]:
    """By key, the ranges with a part of what is stated there; 0: it is exact."""
    shortest, believed, longest = ranges.delay_periods

    def pads(ends: tuple[float, float], part: float) -> tuple[float, float]:
        return ends[1] * (ends[0] / ends[1]) ** part, ends[1]

    return {
        "tolerance.delay": lambda part: replace(
            ranges,
            delay_periods=(believed - part * (believed - shortest), believed, believed + part * (longest - believed)),
        ),
        "inertia": lambda part: replace(ranges, inertia_error=part * ranges.inertia_error),
        "tolerance.object": lambda part: replace(ranges, object_error=part * ranges.object_error),
        "tolerance.friction": lambda part: replace(ranges, friction=1.0 - part * (1.0 - ranges.friction)),
        "tolerance.pads_N_per_m": lambda part: replace(ranges, pads_N_per_m=pads(ranges.pads_N_per_m, part)),
        "tolerance.pads_Nm_per_rad": lambda part: replace(ranges, pads_Nm_per_rad=pads(ranges.pads_Nm_per_rad, part)),
        "tolerance.pads_damping_ratio": lambda part: replace(
            ranges, pads_damping_ratio=1.0 - part * (1.0 - ranges.pads_damping_ratio)
        ),
    }
