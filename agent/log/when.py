"""When an event was, on the trajectory's time."""

from __future__ import annotations

import math

from agent.log.columns import Table
from agent.telemetry.row.event import Event

STARTED_S = -43_200.0  # rows of an arm that nobody has started count towards a start a day ahead


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
