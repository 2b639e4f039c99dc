"""Runs that go on from where another one is, so that tests of what befalls a cell at one time share the way to it."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

from agent.config.schema.fault import Fault
from agent.study.lab import Laboratory, Run

_OF_ITS_OWN = {"spec", "calendar", "_chain", "_observer", "_armature"}  # of a rigid plant: as its faults and chains are


def branched(run: Run, lab: Laboratory, *faults: Fault) -> Run:
    """What `run`, which goes on as if nothing were, would be with these faults ahead; its agents are those of `lab`.

    lab: of the same plant.  The grasps of the run are closed.
    """
    other: Any = Run(lab, None, faults)
    assert all(fault.cycle(run.period_ns) >= run.tick - run.ready_ticks for fault in faults), "nothing is too late"
    _take(other.plant, run.plant, _OF_ITS_OWN)
    for place, begun in zip(other.places, run.places, strict=True):
        _take(place, begun, {"agent"})
    other.tick, other.trips, other.peak_Nm = run.tick, list(run.trips), run.peak_Nm.copy()
    return other  # type: ignore[no-any-return]


def _take(mine: Any, theirs: Any, but: set[str]) -> None:
    for name, value in vars(theirs).items():
        if name not in but:
            setattr(mine, name, deepcopy(value))


def ways(lab: Laboratory) -> Callable[[float], Run]:
    """Runs of a laboratory without faults up to a time, to be branched and not to be advanced.

    None is carried out twice, nor what one before it has been through.
    """
    known: dict[float, Run] = {}

    def until(end_s: float) -> Run:
        if end_s not in known:
            before = max((t for t in known if t < end_s), default=None)
            run = Run(lab, None) if before is None else branched(known[before], lab)
            while run.t < end_s:
                run.advance()
            known[end_s] = run
        return known[end_s]

    return until
