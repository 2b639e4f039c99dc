"""What alignment took off the arms' disagreement: like with like, on the last ticks on which all of them track."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from agent.log.columns import Table
from agent.modes import Mode
from agent.report.prepared import Prepared
from agent.report.series import Array, column, same_ticks

WINDOW_S: Final = 0.2  # of the mean, long beside the steps of encoders


@dataclass(frozen=True, slots=True)
class FoundTogether:
    """Two distances of one window, each the largest of all pairs, of the mean of the differences."""

    apart_m: float  # of where arms see the object
    left_m: float  # of what they pull to: what their shifts leave of it


def found_together(run: Prepared) -> FoundTogether | None:
    """What the shifts took off in the last 0.2 s of tracking after the transient, before an arm holds or is struck.

    None where that is not more than the differences scatter within that time (rms): steps of encoders, no alignment.
    """
    tracked = [_tracked_until(run.whole[name], run.info.struck_s.get(name, math.inf)) for name in run.seen]
    end_s = min(tracked, default=-math.inf)
    begin_s = end_s - WINDOW_S
    half_s = 0.5 / run.info.rate_hz
    if not begin_s >= run.info.transient_s - half_s:
        return None
    apart_m, left_m, scatter_m = [0.0], [0.0], [0.0]
    for one, other in combinations(run.seen, 2):
        a, b = (_between(run.seen[name], begin_s + half_s, end_s + half_s) for name in (one, other))
        here, there = same_ticks(a, b, 1.0 / run.info.rate_hz)
        if not len(here):
            continue
        seen = column(a, "p_object")[here] - column(b, "p_object")[there]
        shifts = [column(rows, "shift", slice(0, 3))[at] for rows, at in ((a, here), (b, there))]
        apart_m.append(_size(seen.mean(axis=0)))
        left_m.append(_size((seen - shifts[0] + shifts[1]).mean(axis=0)))
        scatter_m.append(_size(seen.std(axis=0)))
    together = FoundTogether(max(apart_m), max(left_m))
    return together if together.apart_m - together.left_m > max(scatter_m) else None


def _tracked_until(rows: Table, struck_s: float) -> float:
    """When an arm last tracks before it first does something else or is struck, s; -inf where it never tracks."""
    t, tracks = column(rows, "t"), np.asarray(rows["mode"] == Mode.TRACK)
    begun = np.flatnonzero(tracks)
    if not len(begun):
        return -math.inf
    ended = np.flatnonzero(~tracks[begun[0] :])
    tracking = t[begun[0] :][: ended[0] if len(ended) else None]
    before = tracking[tracking < struck_s]
    return float(before[-1]) if len(before) else -math.inf


def _between(rows: Table, begin_s: float, end_s: float) -> Table:
    return rows[(rows["t"] > begin_s) & (rows["t"] < end_s)]


def _size(vector: Array) -> float:
    return float(np.linalg.norm(vector))
