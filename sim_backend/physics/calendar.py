"""What befalls a plant at known times, to the substep: pushes, grasps that open, joints that seize, limp arms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from drivers.interface import Vector

Wrench = tuple[float, float, float, float, float, float]
WHOLE: Final = 1e-6  # of a substep: an instant so near to the begin of one is that
SEIZED_Nms_RAD: Final = 200.0  # viscous friction of a seized joint: it creeps by 5 mrad/s per N·m


@dataclass(frozen=True)
class Push:
    """A wrench on the object at its frame's origin, world axes, from one instant on for a time."""

    at_s: float  # on the plant's clock
    duration_s: float
    wrench: Wrench  # N, N·m


@dataclass(frozen=True)
class Opening:
    """A gripper that loses the object."""

    at_s: float  # on the plant's clock
    arm: str


@dataclass(frozen=True)
class Seizure:
    """An arm whose joints seize."""

    at_s: float  # on the plant's clock
    arm: str


@dataclass(frozen=True)
class Limpness:
    """An arm whose servos are told no torque any more; what is on its way to them still acts."""

    at_s: float  # on the plant's clock
    arm: str


Happening = Push | Opening | Seizure | Limpness


class Befallen(Protocol):
    """A plant, as far as something can befall it."""

    def push(self, wrench_world: Vector) -> None:
        """Push the object from now on."""
        ...

    def release(self, arm: str) -> None:
        """Open the grasp of one arm for good."""
        ...

    def brake(self, arm: str, viscous_Nms_rad: float) -> None:
        """Replace the viscous friction of one arm's joints."""
        ...


@dataclass(frozen=True, eq=False)
class _Part:
    """A wrench that acts from the begin of one substep to that of another."""

    begin: int
    end: int
    wrench: Vector  # (6,) N, N·m


class Calendar:
    """Times in substeps; what falls on one and the same instant happens in the order given, and pushes add up.

    In a substep that a push does not fill its wrench is smaller by as much, so that every push has its impulse.

    All of it may come later than planned, or wait until that is known.  Of arms that go limp it only says which are:
    their torque is with whoever tells it to the plant.
    """

    def __init__(self, happenings: Sequence[Happening], substep_s: float) -> None:
        due: list[tuple[int, _Part | Opening | Seizure]] = []
        self._limp: list[tuple[int, str]] = []
        for one in happenings:
            begin = round(one.at_s / substep_s)
            if isinstance(one, Limpness):
                self._limp.append((begin, one.arm))
            elif isinstance(one, Push):
                for part in _parts(one, substep_s):
                    due += [(part.begin, part), (part.end, part)]
            else:
                due.append((begin, one))
        self._due = sorted(due, key=lambda entry: entry[0])
        self._acting: list[_Part] = []
        self.wrench: Vector = np.zeros(6)  # of all pushes that act now
        self._substep_s = substep_s
        self._later: int | None = 0  # substeps; None: nobody knows yet

    def wait(self) -> None:
        """Let nothing happen until `go`."""
        self._later = None

    def go(self, later_s: float) -> None:
        """Everything happens so much later than its own time says."""
        self._later = round(later_s / self._substep_s)

    def limp(self, now: int) -> list[str]:
        """Arms whose servos are told no torque in this substep any more."""
        later = self._later
        return [] if later is None else [arm for begin, arm in self._limp if begin + later <= now]

    def stretches(self, plant: Befallen, now: int, substeps: int) -> Iterator[int]:
        """Numbers of the substeps from `now` on between which something happens; it has, when a stretch is given."""
        end = now + substeps
        while now < end:
            later = self._later
            while later is not None and self._due and self._due[0][0] + later <= now:
                self._happen(plant, self._due.pop(0)[1])
            until = min(end, self._due[0][0] + later) if later is not None and self._due else end
            yield until - now
            now = until

    def _happen(self, plant: Befallen, what: _Part | Opening | Seizure) -> None:
        if isinstance(what, Opening):
            plant.release(what.arm)
        elif isinstance(what, Seizure):
            plant.brake(what.arm, SEIZED_Nms_RAD)
        else:
            if what in self._acting:
                self._acting.remove(what)
            else:
                self._acting.append(what)
            self.wrench = sum((part.wrench for part in self._acting), np.zeros(6))
            plant.push(self.wrench)


def _parts(push: Push, substep_s: float) -> list[_Part]:
    """A push in whole substeps: in the first and the last of them as much as it covers of each."""
    begin, end = (_whole(t / substep_s) for t in (push.at_s, push.at_s + push.duration_s))
    wrench, first, last = np.array(push.wrench), math.ceil(begin), math.floor(end)
    if last < first:  # within one substep
        return [_Part(last, first, (end - begin) * wrench)]
    parts = [
        _Part(first - 1, first, (first - begin) * wrench),
        _Part(first, last, wrench),
        _Part(last, last + 1, (end - last) * wrench),
    ]
    return [part for part in parts if part.begin < part.end and part.wrench.any()]


def _whole(substeps: float) -> float:
    near = round(substeps)
    return near if abs(substeps - near) < WHOLE else substeps
