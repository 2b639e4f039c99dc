"""Rows of a log that are not of its run: of another configuration, or with a number that is of another time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.telemetry.row.sample import Layout
from drivers.clock import LOCKSTEP_UTC_NS

AnyRows = TypeVar("AnyRows", NDArray[np.void], Table)

_LOCKSTEP_PERIODS: Final = 0.5  # by which a number may be ahead of its time
_ARM_PERIODS: Final = 2.5  # a loop leaves out what it is late for, and no cycle begins before its deadline
_PLANT_STEPS: Final = 1000.0  # a plant catches up with real time
_PASSES: Final = 16
_HEX_OF_32_BITS: Final = 8


def config_id_of(fingerprint: Any, recorder: Mapping[str, str]) -> int | None:
    """The `config_id` that a log's rows are to have, by the run's description or its recorder; None: neither says."""
    try:
        return int(fingerprint[:_HEX_OF_32_BITS], 16)
    except (TypeError, ValueError):
        told = recorder.get("config_id", "")
        return int(told) if told.isdecimal() and len(told) <= len(str(2**32)) else None


def of_another_configuration(
    rows: Mapping[str, AnyRows], layouts: Mapping[str, Layout], config_id: int | None
) -> list[str]:
    """One line that counts them by member, with their `config_id`, or none.

    config_id: the cell's; None: that of the first row.
    """
    found = []
    for member, own in rows.items():
        if not len(own) or not _has(layouts[member], "config_id"):
            continue
        ids = own["config_id"]
        config_id = int(ids[0]) if config_id is None else config_id
        others = ids[ids != config_id]
        if len(others):
            found.append(f"{len(others)} of the {len(own)} of {member} ({int(others[0])})")
    return [f"rows of another configuration than {config_id} (`config_id`): {', '.join(found)}"] if found else []


def misnumbered(rows: AnyRows, layout: Layout, *, of_plant: bool) -> tuple[NDArray[np.intp], bool]:
    """Which rows, by sequence, have a number that their stamp and their `t` both contradict; whether that is all.

    A number counts as wrong where it is ahead of its time, for numbers may lag: a loop leaves out the cycles that it is
    late for.  Of two rows of which one must be wrong it is the one that its other neighbour contradicts as well.  One
    with a neighbour's number, at the time of another row, has a wrong stamp and no wrong number.
    """
    nothing, gone = np.zeros(0, np.intp), list[int]()
    if len(rows) < 3 or not all(_has(layout, name) for name in ("stamp_ns", "utc_ns", "t")):
        return nothing, True
    stamp_ns = rows["stamp_ns"]
    times = _Times(rows["sequence"].astype(np.float64), 1e-9 * stamp_ns.astype(np.float64), rows["t"])
    in_lockstep = bool(np.mean((rows["utc_ns"] - stamp_ns) % LOCKSTEP_UTC_NS == 0) > 0.5)
    kept = np.arange(len(rows))
    for _ in range(_PASSES if times.goes_on else 0):
        wrong = times.contradicted(kept, in_lockstep=in_lockstep, of_plant=of_plant)
        if not wrong:
            return np.array([k for k in sorted(gone) if times.is_stray(k, kept)], np.intp), True
        gone += kept[wrong].tolist()
        kept = np.delete(kept, wrong)
    return nothing, False


@dataclass(frozen=True, slots=True)
class _Times:
    """Numbers of rows (k,) and their times, s."""

    number: NDArray[np.float64]
    stamp: NDArray[np.float64]
    t: NDArray[np.float64]

    @property
    def goes_on(self) -> bool:
        """Whether time goes on with the numbers, on the whole."""
        return self._pace(np.arange(len(self.number)))[0] >= 0.0

    def contradicted(self, kept: NDArray[np.intp], *, in_lockstep: bool, of_plant: bool) -> list[int]:
        """Indices, among the rows that are kept, of those with a wrong number; of some of them if there are many."""
        if len(kept) < 3:
            return []
        steps = np.diff(self.number[kept])
        period_s, usual = self._pace(kept)
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged time may be anything
            behind_s = [np.diff(x[kept]) - steps * period_s for x in (self.stamp, self.t)]
            never_late = not np.any(behind_s[0] > _LOCKSTEP_PERIODS * period_s)
            allowed = _LOCKSTEP_PERIODS if in_lockstep and never_late else _ARM_PERIODS
            allowed_s = period_s * (_PLANT_STEPS * usual if of_plant and not in_lockstep else allowed)
            ahead, late = (behind_s[0] < -allowed_s) & (behind_s[1] < -allowed_s), behind_s[0] > allowed_s
        wrong = set[int]()
        for i in np.flatnonzero(ahead).tolist():
            below = i == 0 or late[i - 1]
            above = i + 1 < len(late) and late[i + 1]
            wrong.add(i if below and not above else i + 1)
        return sorted(wrong)

    def is_stray(self, k: int, kept: NDArray[np.intp]) -> bool:
        """Whether row k has no neighbour's number among the rows that are kept, or a time that none of them has."""
        period_s, usual = self._pace(kept)
        stamps, own = self.stamp[kept], self.stamp[k]
        alone = not np.isin(self.number[k] + np.array([-usual, usual]), self.number[kept]).any()
        apart = float(np.min(np.abs(stamps - own))) > 0.5 * usual * period_s
        return alone or (apart and bool(own > stamps[0] - _ARM_PERIODS * usual * period_s))

    def _pace(self, kept: NDArray[np.intp]) -> tuple[float, float]:
        """Time (s) of one number, and by how many the numbers usually go on."""
        steps = np.diff(self.number[kept])
        return float(np.median(np.diff(self.stamp[kept]) / steps)), float(np.median(steps))


def number_of(rows: Table, stamp_ns: int) -> int:
    """The number that a row of this stamp would have among these."""
    stamps_s = 1e-9 * rows["stamp_ns"].astype(np.float64)
    number = rows["sequence"]
    if len(rows) < 2:
        return int(number[0])
    at = int(np.argmin(np.abs(stamps_s - 1e-9 * stamp_ns)))
    period_s = float(np.median(np.diff(stamps_s) / np.diff(number)))
    return int(number[at]) + round((1e-9 * stamp_ns - float(stamps_s[at])) / period_s)


def _has(layout: Layout, name: str) -> bool:
    return any(f.name == name for f in layout.fields)
