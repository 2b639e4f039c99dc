"""Two logs row by row: the same bit for bit in all but timing, or the first row and field in which they differ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import BLOCK_ROWS, Table
from agent.log.read import ColumnLog
from agent.log.run import members_of
from agent.replay.comparison import TORQUES, ArmComparison, Comparison, Difference
from agent.replay.source import ReplayError
from agent.telemetry.row.sample import Layout


def same(a: ColumnLog, b: ColumnLog) -> Comparison:
    """Arms and plant of both logs; rows that only one of them has are left out, and then they are not equal.

    Raises ReplayError for logs of different releases, or without a row in common.
    """
    mine, theirs = members_of(a), members_of(b)
    arms, notes = [], []
    for name in dict.fromkeys((*mine, *theirs)):
        if name not in mine or name not in theirs:
            only = a if name in mine else b
            notes.append(f"{name}: only in {only.path}")
            arms.append(ArmComparison(name, 0, 0, len(members_of(only)[name]), None, 0.0))
            continue
        if a.layouts[name] != b.layouts[name]:
            raise ReplayError(
                f"rows of {name}", found=f"other fields in {b.path} than in {a.path}", expected="logs of one release",
                remedy="compare their figures: `coop compare`",
            )  # fmt: skip
        arms.append(_of_member(name, mine[name], theirs[name], a.layouts[name]))
    compared = Comparison(tuple(arms), tuple(notes))
    if not compared.rows:
        raise ReplayError(
            f"{a.path} and {b.path}", found="no row of the same arm and number", expected="logs of one cell",
            remedy="compare their figures: `coop compare`",
        )  # fmt: skip
    return compared


def _of_member(name: str, a: Table, b: Table, layout: Layout) -> ArmComparison:
    _, i, j = np.intersect1d(a["sequence"], b["sequence"], assume_unique=True, return_indices=True)
    fields = [f.name for f in layout.fields if not f.timing]
    different, first, largest = 0, None, 0.0
    for one, other in _pairs(a[i], b[j], layout):
        apart = _bytes_differ(one, other, fields)
        different += int(np.count_nonzero(apart))
        for torque in TORQUES.intersection(fields):
            mine, theirs = one[torque], other[torque]
            with np.errstate(invalid="ignore", over="ignore"):  # of runs that went astray
                gap = np.abs(mine - theirs)
            largest = max(largest, float(np.nanmax(gap, initial=0.0)))
        if first is None and apart.any():
            first = _difference(name, one[apart][0], other[apart][0], fields)
    return ArmComparison(name, len(i), different, len(a) + len(b) - 2 * len(i), first, largest)


def _pairs(a: Table, b: Table, layout: Layout) -> Iterator[tuple[NDArray[np.void], NDArray[np.void]]]:
    for one, other in zip(a.blocks(BLOCK_ROWS), b.blocks(BLOCK_ROWS), strict=True):
        rows = [np.ascontiguousarray(part.messages()).reshape(-1).view(layout.dtype) for part in (one, other)]
        yield rows[0], rows[1]


def _bytes_differ(a: NDArray[np.void], b: NDArray[np.void], fields: list[str]) -> NDArray[np.bool_]:
    """Rows (k,) in which some field has other bits."""
    found = np.zeros(len(a), np.bool_)
    for name in fields:
        x, y = (np.ascontiguousarray(rows[name]).view(np.uint8).reshape(len(rows), -1) for rows in (a, b))
        found |= np.any(x != y, axis=1)
    return found


def _difference(name: str, a: np.void, b: np.void, fields: list[str]) -> Difference:
    """recorded: of the first log; replayed: of the second."""
    differing = tuple(f for f in fields if a[f].tobytes() != b[f].tobytes())
    x, y, index = a[differing[0]], b[differing[0]], None
    if isinstance(x, np.ndarray):
        bits = (np.ascontiguousarray(v).view(np.uint64) for v in (x, y))
        index = int(np.flatnonzero(np.not_equal(*bits))[0])
        x, y = x[index], y[index]
    return Difference(name, int(a["sequence"]), float(a["t"]), differing[0], index, x.item(), y.item(), differing)
