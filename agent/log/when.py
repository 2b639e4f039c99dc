"""When an event was, and a row of the plant, on the time of the trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.telemetry.row.event import Event
from drivers.clock import LOCKSTEP_UTC_NS

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
    try:
        t, last_ns = float(last["t"][0]), int(last["stamp_ns"][0])
    except KeyError:  # rows of another release may lack one
        return math.nan
    return t + (stamp_ns - last_ns) * 1e-9 if t > STARTED_S else math.nan


def on_time_of(plant: Table, arms: Iterable[Table]) -> Table:
    """The plant's rows with `t` as the arms count it: the time since the trajectory's zero, or to it.

    The plant begins before that zero: by `simulation.ready_s` in lockstep, by the wait for a start in real time.  Each
    of its rows takes the zero that an arm's row had then, by the clock of the stamps, or by UTC where the stamps are of
    different clocks; in lockstep rows of one tick have the very same `t`.  NaN where no arm's rows are of its time.
    """
    stamp_ns, utc_ns = plant["stamp_ns"], plant["utc_ns"]
    used = [rows for rows in arms if len(rows)]
    if not len(plant) or not used:
        return plant.with_column("t", np.full(len(plant), math.nan))
    if in_lockstep([plant, *used]):
        return plant.with_column("t", _since_zero(stamp_ns + _skew_ns(plant, used[0]), used[0], "stamp_ns"))
    for rows in used:
        if _ahead_ns(plant, rows) <= SAME_CLOCK_NS:
            return plant.with_column("t", _since_zero(stamp_ns, rows, "stamp_ns"))
    for own_ns, clock in ((utc_ns, "utc_ns"), (stamp_ns, "stamp_ns")):
        for rows in used:
            if _beside(own_ns, rows[clock]):
                return plant.with_column("t", _since_zero(own_ns, rows, clock))
    return plant.with_column("t", np.full(len(plant), math.nan))


def in_lockstep(members: Iterable[Table]) -> bool:
    """Whether simulated time waited for all of them, so that rows of one sequence number are of one tick.

    Their clocks begin at a whole second of UTC then, and may differ by what the simulation makes them differ.
    """
    return all(len(rows) > 0 and not ((rows["utc_ns"] - rows["stamp_ns"]) % LOCKSTEP_UTC_NS).any() for rows in members)


def by_one_clock(arms: Mapping[str, Table]) -> dict[str, Table]:
    """The rows of arms in lockstep with `t` as the first of them counts it; of others as they are."""
    used = [rows for rows in arms.values() if len(rows)]
    if not in_lockstep(used):
        return dict(arms)
    skews_ns = {name: _skew_ns(rows, used[0]) if len(rows) else 0 for name, rows in arms.items()}
    return {
        name: rows if not skews_ns[name] else rows.with_column(
            "t", _since_zero(rows["stamp_ns"] + skews_ns[name], used[0], "stamp_ns")
        )
        for name, rows in arms.items()
    }  # fmt: skip


def _skew_ns(one: Table, other: Table) -> int:
    """By how much the stamps of `other` are ahead of those of `one` at the same ticks; 0 where they share none."""
    _, here, there = np.intersect1d(one["sequence"], other["sequence"], return_indices=True)
    return round(float(np.median(other["stamp_ns"][there] - one["stamp_ns"][here]))) if len(here) else 0


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
