"""Who bears how much when an arm fails: the largest part of its stall torque, at every place and of each survivor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agent.control.models import Matrix


@dataclass(frozen=True, slots=True)
class Load:
    """The largest part of its stall torque that a joint of the others must give."""

    share: float
    arm: int
    joint: int
    place: int


@dataclass(frozen=True, slots=True)
class Loads:
    """Of one fault."""

    along: tuple[Load, ...]  # the largest of all survivors, at every place
    each: tuple[Load, ...]  # the largest of all places, of every survivor

    @property
    def most(self) -> Load:
        """The largest of all."""
        return max(self.along, key=lambda load: load.share)


def loads(shares: Mapping[int, Matrix]) -> Loads:
    """Of the parts of stall (T, n) that the joints of every survivor give."""
    worst = {i: [_joint(row, i, place) for place, row in enumerate(s.tolist())] for i, s in shares.items()}
    return Loads(
        along=tuple(max(here, key=lambda load: load.share) for here in zip(*worst.values(), strict=True)),
        each=tuple(max(own, key=lambda load: load.share) for own in worst.values()),
    )


def unbearable(others: Sequence[int], places: int) -> Loads:
    """Of weights that nothing balances."""
    return Loads(
        along=tuple(Load(math.inf, others[0], 0, place) for place in range(places)),
        each=tuple(Load(math.inf, i, 0, 0) for i in others),
    )


def _joint(row: Sequence[float], arm: int, place: int) -> Load:
    share = max(row)
    return Load(share, arm, row.index(share), place)
