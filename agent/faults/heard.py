"""What struck listeners cost: each torque bit by bit against the run that nobody disturbed, and what the logs lack."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.faults.judge import RowResult
from agent.faults.listeners import Rehearsed
from agent.log.read import COMPLETENESS, LogError, RunLog, read_log
from agent.study.lab import Laboratory, Run
from agent.telemetry.row.topics import PLANT

_REJECTED: Final = "rejected."


@dataclass(frozen=True)
class Torque:
    """An arm's torques against those of the undisturbed run."""

    rows: int  # of the undisturbed run
    differs_at: int | None  # first row that is not the same to the bit, or not there; None: all are
    t: float | None = None  # of the trajectory, then

    @property
    def same(self) -> bool:
        """Whether every bit is."""
        return self.differs_at is None


@dataclass(frozen=True)
class Kept:
    """A member's rows in the logs."""

    written: int  # in its ring
    logged: int  # of these, in any of the logs
    foreign: int  # rows in a log that the member never wrote

    @property
    def missing(self) -> int:
        """Rows in no log."""
        return self.written - self.logged


@dataclass(frozen=True)
class Heard:
    """What a run with struck listeners shows."""

    torque: Mapping[str, Torque]  # by arm
    kept: Mapping[str, Kept]  # by arm and of the plant
    complete: bool  # all logs are
    problems: tuple[str, ...]  # of their files, for a person
    left_out: Mapping[str, int]  # messages by reason
    sent: int  # by strangers

    @property
    def verdict(self) -> RowResult:
        """Whether no torque differs, no log has what its member never wrote, and none that lacks rows is complete."""
        same = all(one.same for one in self.torque.values())
        own = not any(one.foreign for one in self.kept.values())
        honest = not self.complete or not any(one.missing for one in self.kept.values())
        return RowResult.MET if same and own and honest else RowResult.MISSED

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "verdict": self.verdict.value,
            "torque": {
                arm: {"rows": one.rows, "same": one.same, "differs_at_row": one.differs_at, "differs_at_s": one.t}
                for arm, one in self.torque.items()
            },
            "complete": self.complete,
            "rows": {
                name: {"written": one.written, "logged": one.logged, "missing": one.missing, "foreign": one.foreign}
                for name, one in self.kept.items()
            },
            "problems": list(self.problems),
            "strange_messages": self.sent,
            "left_out": dict(self.left_out),
        }


def heard(run: Rehearsed) -> Heard:
    """Hold a run against the same cell in one process, which nobody listens to.  Raises Refusal."""
    expected = undisturbed(run.cell)
    logs, problems = _read(run.logs)
    return Heard(
        torque={arm: compared(tau, run.rows.get(arm)) for arm, tau in expected.items()},
        kept={member: kept(rows, member, logs) for member, rows in run.rows.items()},
        complete=0 < len(logs) == len(run.logs) and all(log.complete for log in logs),
        problems=problems,
        left_out=left_out(logs),
        sent=run.sent,
    )


def undisturbed(cell: Cell) -> dict[str, NDArray[np.float64]]:
    """(ticks, n) limited torques of each arm in a lockstep run, N·m, bit for bit.  Raises Refusal."""
    file = cell.file
    run = Run(Laboratory(cell), None)
    ticks = run.ready_ticks + round(file.duration_s * file.rate_hz)
    tau = {place.agent.name: np.empty((ticks, place.agent.model.n)) for place in run.places}
    for tick in range(ticks):
        run.advance()
        for place in run.places:
            assert place.outcome is not None
            tau[place.agent.name][tick] = place.outcome.tau
    return tau


def compared(expected: NDArray[np.float64], rows: NDArray[np.void] | None) -> Torque:
    """expected: (ticks, n); rows: of the arm's ring, None where it has none."""
    if rows is None:
        return Torque(len(expected), 0)
    found = np.ascontiguousarray(rows["tau_limited"][:, : expected.shape[1]])
    both = min(len(expected), len(found))
    same = (expected[:both].view(np.uint64) == found[:both].view(np.uint64)).all(axis=1)
    if not same.all():
        at = int(np.argmin(same))
        return Torque(len(expected), at, float(rows["t"][at]))
    return Torque(len(expected), None if len(expected) == len(found) else both)


def kept(rows: NDArray[np.void], member: str, logs: Sequence[RunLog]) -> Kept:
    """What the logs have of a member's rows, and of others under its name."""
    by_sequence = {int(row["sequence"]): row.tobytes() for row in rows}
    logged, foreign = set(), 0
    for log in logs:
        found = log.plant if member == PLANT else log.agents.get(member)
        for row in () if found is None else found:
            sequence = int(row["sequence"])
            if by_sequence.get(sequence) == row.tobytes():
                logged.add(sequence)
            else:
                foreign += 1
    return Kept(len(rows), len(logged), foreign)


def left_out(logs: Sequence[RunLog]) -> dict[str, int]:
    """Messages that did not get in, by reason in words."""
    counts: Counter[str] = Counter()
    for log in logs:
        for key, count in log.metadata.get(COMPLETENESS, {}).items():
            if key.startswith(_REJECTED):
                counts[key.removeprefix(_REJECTED).replace("_", " ")] += int(count)
    return dict(counts)


def _read(paths: Sequence[Path]) -> tuple[list[RunLog], tuple[str, ...]]:
    logs: list[RunLog] = []
    problems: list[str] = []
    for path in paths:
        try:
            log = read_log(path)
        except LogError as error:
            problems.append(str(error))
            continue
        logs.append(log)
        problems += [f"{path.name}: {text}" for text in log.problems]
    return logs, tuple(problems)
