"""What identification takes from a log: joint positions and the torque that acted, evenly sampled.

The torque is the one that was sent, late by the loop's delay.  It is held between two cycles, so what acted around an
instant is the mean of the held torque over the period about it; what follows is then in phase.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Arm, Cell
from agent.log.columns import Table
from agent.log.read import AnyLog
from agent.modes import Mode
from agent.replay.source import recorded_cell
from drivers.interface import Refusal

Matrix = NDArray[np.float64]

MISSING_MAX: Final = 0.02  # share of the cycles without a fresh state
GAP_MAX: Final = 3  # such cycles in a row
SHORTEST_S: Final = 15.0


class IdentifyError(Refusal):
    """An arm cannot be identified from this log."""


@dataclass(frozen=True)
class Recording:
    """One arm holding one object, evenly sampled."""

    cell: Cell
    arm: Arm
    period_s: float
    q: Matrix  # (k, n) rad, as measured
    tau: Matrix  # (k, n) N·m that acted
    day: str  # of the run, UTC
    sent: Matrix  # (k, n) N·m
    delay_s: float  # from a sample to its torque, of which `tau` is made

    @property
    def source(self) -> str:
        """Where a figure comes from, for the arm file."""
        return f"coop identify, run of {self.day}, cell {self.cell.file.name} {self.cell.fingerprint[:12]}"

    def delayed(self, delay_s: float) -> Recording:
        """The same, with the torque as it acted if this was the loop's delay."""
        return replace(self, tau=acted(self.sent, delay_s / self.period_s), delay_s=delay_s)


def from_log(log: AnyLog, arm: str | None = None) -> Recording:
    """Recording of the one arm of a log, with the arm file that the run used.

    Raises IdentifyError for a log that is incomplete, of several arms, of one that a hand guided, or too short, and
    what `recorded_cell` raises.
    """
    cell = recorded_cell(log)
    _refuse_guided(log, arm)
    if len(cell.arms) > 1:
        raise IdentifyError(
            f"log {log.path.name}",
            found=f"{len(cell.arms)} arms on one object",
            expected="one arm: what several do to each other through the object is in no log",
            remedy="record a cell like identify_wx200.toml, one arm with a light object",
        )
    described = cell.arms[0] if arm is None else cell.arm(arm)
    _refuse_incomplete(log, described.name)
    return from_rows(cell, described, Table.of(log.agents[described.name]))


def from_rows(cell: Cell, arm: Arm, rows: Table) -> Recording:
    """Recording of the longest stretch in TRACK.

    Raises IdentifyError when it is too short, has holes, or was a rehearsal.
    """
    rows = _tracking(rows)
    _refuse_rehearsal(rows, arm.name)
    period_s, n = 1.0 / cell.file.rate_hz, arm.n
    if len(rows) * period_s < SHORTEST_S:
        raise IdentifyError(
            f"motion of arm {arm.name}", found=f"{len(rows) * period_s:.1f} s in TRACK",
            expected=f"at least {SHORTEST_S:g} s", remedy="record the whole trajectory",
        )  # fmt: skip
    stamps_s = (rows["stamp_ns"] - rows["stamp_ns"][0]) * 1e-9
    slots = np.rint(stamps_s / period_s).astype(int)
    steps = np.diff(slots)
    missing = 1.0 - (len(rows) - 1) / slots[-1]
    if steps.max() > GAP_MAX + 1 or missing > MISSING_MAX:
        raise IdentifyError(
            f"cycles of arm {arm.name}",
            found=f"{missing:.1%} without a fresh state, up to {steps.max() - 1} in a row",
            expected=f"at most {MISSING_MAX:.0%} and {GAP_MAX} in a row",
            remedy="find out what the bus loses (coop report), then record again",
        )
    grid = np.arange(slots[-1] + 1)
    q = np.stack([np.interp(grid * period_s, stamps_s, column) for column in rows["q_measured"].T[:n]], axis=1)
    sent = rows["tau_sent"][np.searchsorted(slots, grid, side="right") - 1, :n]  # a cycle without a state repeats it
    day = datetime.datetime.fromtimestamp(int(rows["utc_ns"][0]) * 1e-9, datetime.UTC).date().isoformat()
    return Recording(cell, arm, period_s, q, acted(sent, cell.file.delay_periods), day, sent, cell.file.delay_s)


def acted(tau_sent: Matrix, delay_periods: float) -> Matrix:
    """Torque (k, n), mean over half a period before to half after each sample, from what was sent at each (k, n).

    What is sent at a sample acts for one period, beginning delay_periods (≥ 0) after it.
    """
    count = len(tau_sent)
    oldest = math.ceil(delay_periods + 0.5)  # sent so many samples before, still acting when the mean begins
    share = oldest - (delay_periods + 0.5)  # of the mean that belongs to the torque after it
    before = np.concatenate([np.repeat(tau_sent[:1], oldest, axis=0), tau_sent])
    mean: Matrix = (1.0 - share) * before[:count] + share * before[1 : count + 1]
    return mean


def _refuse_guided(log: AnyLog, arm: str | None) -> None:
    """Before arms are counted: of a cell of several, one that floats holds nothing with the others."""
    for name in log.agents if arm is None else log.agents.keys() & {arm}:
        if np.any(Table.of(log.agents[name])["mode"] == Mode.FLOAT):
            raise IdentifyError(
                f"log {log.path.name}", found=f"arm {name} guided by a hand, whose force is in no log",
                expected="one arm that moves by itself",
                remedy="record a cell like identify_wx200.toml, one arm with a light object",
            )  # fmt: skip


def _refuse_rehearsal(rows: Table, arm: str) -> None:
    try:
        added = rows["twin_age_s"]
    except KeyError:  # a log of a release without rehearsals
        return
    if np.any(added):
        raise IdentifyError(
            f"log of arm {arm}", found="an arm in the loop: it held nothing, and its driver added torques",
            expected="an arm that holds what its cell says", remedy="record it without [hil]",
        )  # fmt: skip


def _refuse_incomplete(log: AnyLog, arm: str) -> None:
    gaps = sum(last - first + 1 for first, last in log.gaps.get(arm, ()))
    if log.complete and not gaps and arm in log.agents:
        return
    what = (*log.problems, *log.lacks, f"{gaps} rows missing" if gaps else "the recorder did not finish it")[0]
    raise IdentifyError(
        f"log {log.path.name}", found=what, expected="a complete log", remedy="record again, or try `coop recover`"
    )


def _tracking(rows: Table) -> Table:
    tracking = np.concatenate([[False], rows["mode"] == Mode.TRACK, [False]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(tracking) == 1), np.flatnonzero(np.diff(tracking) == -1)
    if not len(begins):
        return rows[:0]
    longest = int(np.argmax(ends - begins))
    return rows[begins[longest] : ends[longest]]
