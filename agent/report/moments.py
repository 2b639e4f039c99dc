"""What happened in a run and when, on the run's own time axis.

`agent.log.when` knows the time of an arm's events.  Others carry wall time, and so do those of an arm in logs of
earlier releases; in lockstep it runs differently from the run's own: they stand at the tick they name, or at the start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.log.columns import Table
from agent.log.when import trajectory_time
from agent.report.loss import told
from agent.report.prepared import Prepared
from agent.telemetry.row.event import Event, Level

BEFORE_S: Final = 3.0  # for so long what happened is shown beside a picture
MARKS_MAX: Final = 6  # on one axis
_APART: Final = 0.14  # of the axis
_SAME_PACE: Final = 0.02  # relative: a run that took as long by the wall as by its own time kept the wall's pace


@dataclass(frozen=True, slots=True)
class Moment:
    """Something that happened, and the time `t` s of the run at which it is shown: at its start what was before."""

    t: float
    source: str
    text: str
    grave: bool = False
    happened: float = math.nan  # s of the run, where that is known

    @property
    def weighty(self) -> bool:
        """A change of mode, or grave."""
        return self.grave or self.of_mode

    @property
    def of_mode(self) -> bool:
        """A change of mode, and not of a register."""
        return self.text.startswith("mode ")

    @property
    def line(self) -> str:
        """For a list."""
        return f"{self.t if math.isnan(self.happened) else self.happened:.3f} s {self.source}: {self.text}"


def moments_of(run: Prepared) -> list[Moment]:
    """The events of a run that has a row, by its time, and what became of the object by the plant's rows."""
    by_wall = _by_the_wall(run)
    found = [
        Moment(
            _time_of(e, _rows(run, e), run.info.rate_hz, by_wall),
            e.source,
            e.text,
            e.level >= Level.WARN,
            trajectory_time(e, _rows(run, e)),
        )
        for e in [*run.log.events, *told(run)]
    ]
    return sorted(found, key=lambda moment: moment.t)


def around(moments: Sequence[Moment], t: float) -> list[Moment]:
    """What happened in the last BEFORE_S before `t`, newest first."""
    return [m for m in reversed(moments) if t - BEFORE_S <= m.t <= t + 1e-9]


def _rows(run: Prepared, event: Event) -> Table:
    return run.rows.get(event.source, next(iter(run.rows.values())))


def _time_of(event: Event, rows: Table, rate_hz: float, by_wall: bool) -> float:
    known, ticks = trajectory_time(event, rows), event.data.get("ticks")
    if not math.isnan(known):
        return max(0.0, known)  # before the start everything stands still
    if isinstance(ticks, int):
        return ticks / rate_hz
    t, utc_ns = rows["t"], rows["utc_ns"]
    wall_s = 1e-9 * float(event.utc_ns - int(utc_ns[0])) if by_wall else 0.0
    return max(0.0, float(np.clip(t[0] + wall_s, t[0], t[-1])))


def _by_the_wall(run: Prepared) -> bool:
    """Whether the run kept the wall's pace; in simulation the agents say at their end how long it took."""
    for event in run.log.events:
        wall_s, ticks = event.data.get("wall_s"), event.data.get("ticks")
        if run.info.driver == "sim" and isinstance(wall_s, int | float) and isinstance(ticks, int):
            return abs(wall_s * run.info.rate_hz / max(ticks, 1) - 1.0) < _SAME_PACE
    return run.info.driver != "sim"


def marks(moments: Sequence[Moment], first: float, last: float) -> tuple[tuple[float, str], ...]:
    """What stands on a time axis, each once, nothing over its neighbour: changes of mode first, then what is grave."""
    found: dict[str, float] = {}
    for moment in sorted(moments, key=lambda m: (not m.of_mode, not m.grave, m.t)):
        label = (moment.text.rpartition("→")[2] if moment.of_mode else moment.text.removeprefix("safety:")).strip()
        clear = all(abs(moment.t - t) > _APART * (last - first) for t in found.values())
        if moment.weighty and clear and label not in found and first <= moment.t <= last and len(found) < MARKS_MAX:
            found[label] = moment.t
    return tuple(sorted((t, label) for label, t in found.items()))
