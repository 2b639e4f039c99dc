"""When an event was, and a row of the plant, on the time of the trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.telemetry.row.event import Event

SAME_CLOCK_NS: Final = 5_000_000_000  # stamps whose UTC is further apart are of different clocks
STARTED_S: Final = -43_200.0  # rows of an arm that nobody has started count towards a start a day ahead


def trajectory_time(event: Event, table: Table | None) -> float:
    """Time `t` of an event, s; NaN where it has no tie to the trajectory, or the trajectory never began.

    An event made from a row has the row's `t`, which says nothing until a start was given.  One that an agent tells
    itself has `stamp_ns`, on the clock of the stamps in its rows (`table`); the last of these says where on that clock
    the trajectory's zero was.
    """
    told, stamp_ns = event.data.get("t"), event.data.get("stamp_ns")
    if isinstance(told, int | float) and not isinstance(told, bool):
        return float(told) if told > STARTED_S else math.nan
    if table is None or not len(table) or type(stamp_ns) is not int:
        return math.nan
    last = table[len(table) - 1 : len(table)]
    t, last_ns = float(last["t"][0]), int(last["stamp_ns"][0])
    return t + (stamp_ns - last_ns) * 1e-9 if t > STARTED_S else math.nan


def on_time_of(plant: Table, arms: Iterable[Table]) -> Table:
    """The plant's rows with `t` as the arms count it: the time since the trajectory's zero, or to it.

    The plant begins before that zero: by `simulation.ready_s` in lockstep, by the wait for a start in real time.  Each
    of its rows takes the zero that an arm's row had then, by the clock of the stamps, or by UTC where the stamps are of
    different clocks; in lockstep rows of one stamp have the very same `t`.  NaN where no arm's rows are of its time.
    """
    stamp_ns, utc_ns = plant["stamp_ns"], plant["utc_ns"]
    used = [rows for rows in arms if len(rows)]
    if not len(plant) or not used:
        return plant.with_column("t", np.full(len(plant), math.nan))
    for rows in used:
        if _ahead_ns(plant, rows) <= SAME_CLOCK_NS:
            return plant.with_column("t", _since_zero(stamp_ns, rows, "stamp_ns"))
    for own_ns, clock in ((utc_ns, "utc_ns"), (stamp_ns, "stamp_ns")):
        for rows in used:
            if _beside(own_ns, rows[clock]):
                return plant.with_column("t", _since_zero(own_ns, rows, clock))
    return plant.with_column("t", np.full(len(plant), math.nan))


def _beside(one_ns: NDArray[np.int64], other_ns: NDArray[np.int64]) -> bool:
    """Whether two members were there at a common time."""
    return bool(one_ns.min() <= other_ns.max() and other_ns.min() <= one_ns.max())


def _ahead_ns(one: Table, other: Table) -> float:
    """How far the UTC of equal stamps is apart."""
    return float(abs(np.median(one["utc_ns"] - one["stamp_ns"]) - np.median(other["utc_ns"] - other["stamp_ns"])))


def _since_zero(own_ns: NDArray[np.int64], rows: Table, clock: str) -> NDArray[np.float64]:
    have_ns = np.maximum.accumulate(rows[clock])
    at = np.maximum(np.searchsorted(have_ns, own_ns, side="right") - 1, 0)
    zero_ns = rows[clock] - np.rint(rows["t"] * 1e9).astype(np.int64)
    return np.asarray((own_ns - zero_ns[at]) * 1e-9, dtype=np.float64)
