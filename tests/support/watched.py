"""A simulated cell in one process whose arms watch themselves as in `agent.runner`; joints may lie to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from agent.config.cell import Cell
from agent.config.schema.reality import Reality
from agent.modes import Event
from agent.monitors.bounds import Bounds, Name
from agent.monitors.watch import Watch
from agent.study.lab import Laboratory, Place, Run
from drivers.interface import JointState, ServoHealth, Vector

Lie = Callable[[float, Vector], Vector]  # what an arm reads, from time and the reported angles (n,)


@dataclass
class Watched:
    """What a run left."""

    first: dict[str, tuple[float, str]] = field(default_factory=dict)  # time and text of each arm's first trip
    peak_rad_per_s: float = 0.0  # of any joint, before the first trip
    places: list[Place] = field(default_factory=list)

    @property
    def names(self) -> set[str]:
        """Monitors that held an arm."""
        return {text.split(":")[0].removeprefix("monitor ") for _, text in self.first.values()}


class _Watching:
    """`Place.cycle` with the monitors behind it, whose finding is the next cycle's trouble."""

    def __init__(self, place: Place, watch: Watch, seen: Watched, lie: Lie | None) -> None:
        self._place, self._watch, self._seen, self._lie = place, watch, seen, lie
        self._cycle = place.cycle
        self._trouble = Event.NONE

    def __call__(self, stamp_ns: int, zero_ns: int, reported: tuple[Vector, Vector, Vector], happened: Event) -> Vector:
        place, seen, t = self._place, self._seen, (stamp_ns - zero_ns) * 1e-9
        if self._lie is not None:
            q = reported[0].copy()
            q[place.joints] = self._lie(t, q[place.joints])
            reported = (q, *reported[1:])
        mode = place.mode
        tau = self._cycle(stamp_ns, zero_ns, reported, happened | self._trouble)
        if place.outcome is None or mode is not place.mode:
            return tau
        if not seen.first:
            seen.peak_rad_per_s = max(seen.peak_rad_per_s, float(np.abs(reported[1]).max()))
        state = JointState(stamp_ns, *(values[place.joints] for values in reported))
        found = self._watch.after(state, place.outcome, mode, lambda: ServoHealth.none(stamp_ns))
        if found:
            self._trouble = Event.TROUBLE
            seen.first.setdefault(place.agent.name, (t, found))
        return tau


def watched(
    cell: Cell,
    duration_s: float,
    *,
    believed: Cell | None = None,
    reality: Reality | None = None,
    lies: dict[str, Lie] | None = None,
    until_trip: bool = False,
    changed: Callable[[Bounds], Bounds] = lambda b: b,
    see: Callable[[float, Vector], None] | None = None,
) -> Watched:
    """A run until duration_s of the trajectory, in the cell as it is.

    believed: what the agents have for a cell; lies: by arm, what it reads; changed: other bounds; see: is told time and
    speeds of all joints after every tick.
    """
    own = believed or cell
    lab = Laboratory(own)
    run = Run(lab, reality) if believed is None else _run_of(lab, cell, reality)
    seen = Watched(places=run.places)
    for arm, place, usual in zip(own.arms, run.places, lab.bounds, strict=True):
        lie, place.watch = (lies or {}).get(arm.name), None
        setattr(place, "cycle", _Watching(place, Watch(changed(usual)), seen, lie))  # noqa: B010
    while run.t < duration_s and not (until_trip and seen.first):
        run.advance()
        if see is not None:
            see(run.t, run.plant.dq)
    return seen


def _run_of(lab: Laboratory, cell: Cell, reality: Reality | None) -> Run:
    """A run whose plant is of another cell than its agents believe."""
    true = Laboratory(cell)
    run: Any = Run(true, reality)
    for place, agent in zip(run.places, lab.agents, strict=True):
        place.agent = agent
    return run  # type: ignore[no-any-return]


def without(*names: Name) -> Callable[[Bounds], Bounds]:
    """Bounds with these monitors switched off."""
    return lambda b: replace(b, watched=b.watched - frozenset(names))


def only(*names: Name) -> Callable[[Bounds], Bounds]:
    """Bounds with these monitors alone."""
    return lambda b: replace(b, watched=frozenset(names))
