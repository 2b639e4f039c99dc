"""A log as numpy arrays: rows, events, attachments, and what is missing.

`read_log` brings all of it into memory; `open_log` leaves the rows of a long log on the disk and gives them by column.
A file is read and left as it is, and a row that is absent stays absent.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from agent.host.info import RUN_FILE
from agent.log.collect import Collected, LogError, Needs, NoRows
from agent.log.columns import ColumnFile, StoredRows, Table
from agent.log.lacking import lacking, missing
from agent.log.misfits import config_id_of, misnumbered, of_another_configuration
from agent.log.servos import ServoTable, servo_table
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE, Layout
from agent.telemetry.row.topics import PLANT, RECORDER

__all__ = ["AnyLog", "ColumnLog", "Event", "Level", "LogError", "NoRows", "RunLog", "open_log", "read_log"]

COMPLETENESS: Final = "completeness"
RECOVERY: Final = "recovery"  # what `coop recover` says of a log it repaired

Rows = TypeVar("Rows")
Gaps = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Log(Generic[Rows]):
    """One run."""

    path: Path
    cell: str
    agents: dict[str, Rows]  # by arm: rows of AGENT_STATE.dtype, by sequence, each once
    plant: Rows | None  # rows of PLANT_STATE.dtype; None on real arms
    events: list[Event]  # by time, each once
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    complete: bool  # the recorder finished the file, no row of an arm or of the plant is missing, nothing is damaged
    gaps: dict[str, Gaps]  # by member: absent sequence numbers, first and last of each gap; the plant writes every k-th
    problems: tuple[str, ...] = field(default=())  # what is wrong with the file, for a person
    lacks: tuple[str, ...] = field(default=())  # what of the run is not in it, for a person
    layouts: Mapping[str, Layout] = field(default_factory=dict)  # by member, as the log's own schemas have them
    servos: Mapping[str, ServoTable] = field(default_factory=dict)  # by arm; simulated arms have no servos, so no entry
    unjudged: tuple[str, ...] = field(default=())  # of problems and lacks: those with which no figure is of the run
    misnumbered: Mapping[str, Rows] = field(default_factory=dict)  # by member: rows left out for their numbers, if any

    @property
    def remarks(self) -> list[str]:
        """What whoever works with the log must be told first: a line for each problem, one for all that it lacks."""
        return [*self.problems, *([f"not all of the run is in it: {'; '.join(self.lacks)}"] if self.lacks else [])]

    def run_info(self) -> dict[str, Any]:
        """The run's description.  Raises LogError when the log has none."""
        try:
            return _described(json.loads(self.attachments[RUN_FILE]))
        except (KeyError, ValueError, RecursionError) as error:
            raise LogError(
                f"{self.path} does not say which run it is",
                found=repr(error),
                expected=f"an attachment {RUN_FILE}",
                remedy="take a log that `coop record` made",
            ) from error


def _described(info: Any) -> dict[str, Any]:
    if not isinstance(info, dict):
        raise ValueError(f"a {type(info).__name__}")
    return info


RunLog = Log[NDArray[np.void]]  # rows as structured arrays, read-only
ColumnLog = Log[Table]  # rows by column
AnyLog = RunLog | ColumnLog


def read_log(path: Path) -> RunLog:
    """Read a log, finished or not, into memory: 3 kB for each row of an arm.

    Raises LogError for what is no log of ours or of another layout; what is merely cut or damaged is read up to there
    and told of in `problems`.
    """
    collected = Collected(path, _RowsInMemory)
    collected.read()
    return _log(collected, {member: sink.rows() for member, sink in collected.rows.items()})


@contextmanager
def open_log(
    path: Path, folder: Path | None = None, *, any_layout: bool = False, needs: Needs = MappingProxyType({})
) -> Iterator[ColumnLog]:
    """The same with rows by column, for the time of the block: memory is needed for the columns in use.

    `folder`: where the temporary file with the columns lies, about as large as the log; see ColumnFile.
    any_layout: rows of another release are read too, with the fields that `layouts` has; needs: if they have these.
    """
    with ColumnFile(folder) as file:
        collected = Collected(path, lambda layout: StoredRows(file, layout.dtype), any_layout=any_layout, needs=needs)
        collected.read()
        for stored in collected.rows.values():
            stored.finish()
        yield _log(collected, {member: Table(stored) for member, stored in collected.rows.items()})


class _RowsInMemory:
    """Rows one behind the other."""

    def __init__(self, layout: Layout) -> None:
        self._dtype = layout.dtype
        self._bytes = bytearray()

    def add(self, messages: NDArray[np.uint8]) -> None:
        self._bytes += messages.tobytes()

    def rows(self) -> NDArray[np.void]:
        rows: NDArray[np.void] = np.frombuffer(self._bytes, self._dtype)
        rows.flags.writeable = False
        return rows


AnyRows = TypeVar("AnyRows", NDArray[np.void], Table)


def _log(collected: Collected[Any], every: Mapping[str, AnyRows]) -> Log[AnyRows]:
    rows, strays = _numbered(collected, every)
    problems = collected.problems
    run: dict[str, Any] = _described_run(collected)
    recorder: Mapping[str, str] = collected.metadata.get(RECORDER, {})
    config_id = config_id_of(run.get("fingerprint"), recorder)
    foreign: list[str] = of_another_configuration(rows, collected.layouts, config_id)
    problems += foreign
    agents = {member: own for member, own in rows.items() if member != PLANT}
    if not agents:
        raise NoRows(
            f"{collected.path} holds no rows",
            found=problems[0] if problems else "no agent's state",
            expected=f"messages of {AGENT_STATE.ros_name}",
            remedy="take a log that `coop record` made",
        )
    told: Mapping[str, str] = collected.metadata.get(COMPLETENESS, {})
    gaps = {member: _gaps(own["sequence"], of_plant=member == PLANT) for member, own in rows.items()}
    absent = {member: sum(last - first + 1 for first, last in own) for member, own in gaps.items() if member != PLANT}
    have: dict[str, int] = {member: len(own) + len(strays.get(member, ())) for member, own in rows.items()}
    members = [*_arms(run), *([PLANT] if recorder.get("plant") == "true" else [])]
    gone: dict[str, str] = lacking(told, have, absent, members)
    left_out = int(collected.metadata.get(RECOVERY, {}).get("damaged", "0"))
    complete = told.get("complete") == "true" and not problems and not gone and not left_out
    lacks = [*missing(told), *gone.values()]
    if not complete and not lacks and not problems:
        lacks = ["what is damaged was left out when it was mended" if left_out else _unfinished(told)]
    return Log(
        path=collected.path,
        cell=collected.cell,
        agents=agents,
        plant=rows.get(PLANT),
        events=collected.events,
        attachments=collected.attachments,
        metadata=collected.metadata,
        complete=complete,
        gaps=gaps,
        problems=tuple(problems),
        lacks=tuple(lacks),
        layouts=collected.layouts,
        servos=_servos(collected, agents),
        unjudged=(*foreign, *(text for member, text in gone.items() if not have.get(member))),
        misnumbered=strays,
    )


def _numbered(collected: Collected[Any], every: Mapping[str, AnyRows]) -> tuple[dict[str, AnyRows], dict[str, AnyRows]]:
    """Rows by member and sequence, each once, and those left out for their numbers; its problems are told of both."""
    rows = {member: _by_sequence(own) for member, own in every.items()}
    again = {f"the rows of {member}": len(own) - len(rows[member]) for member, own in every.items()}
    again["the events"] = collected.again
    twice = "are in the log more than once, and count once"
    collected.problems += [f"{count} of {what} {twice}" for what, count in again.items() if count]
    return rows, _without_strays(rows, collected.layouts, collected.problems)


def _described_run(collected: Collected[Any]) -> dict[str, Any]:
    """What the file tells of its run; nothing where that is not there."""
    try:
        return _described(json.loads(collected.attachments[RUN_FILE]))
    except (KeyError, ValueError, RecursionError):
        return {}


def _arms(told: Mapping[str, Any]) -> list[str]:
    """Names of the arms whose rows the log is to have, as far as the run tells; in older logs all of the cell."""
    named: Any = told.get("taking_part")
    if not isinstance(named, list):
        arms = told.get("arms")
        named = [arm.get("name") for arm in arms if isinstance(arm, dict)] if isinstance(arms, list) else []
    return [name for name in named if isinstance(name, str)]


def _unfinished(told: Mapping[str, str]) -> str:
    return "its recorder says so" if told else "its recorder did not finish it, and nothing says what was to come"


def _servos(collected: Collected[Any], agents: Mapping[str, AnyRows]) -> dict[str, ServoTable]:
    told = {arm: texts for arm, texts in collected.health.items() if texts and len(agents.get(arm, ()))}
    return {arm: servo_table(texts, agents[arm]["utc_ns"], agents[arm]["t"]) for arm, texts in told.items()}


def _by_sequence(rows: AnyRows) -> AnyRows:
    sequence = rows["sequence"]
    if np.all(sequence[1:] > sequence[:-1]):
        return rows
    _, first = np.unique(sequence, return_index=True)
    return _chosen(rows, first)


def _chosen(rows: AnyRows, which: NDArray[np.intp]) -> AnyRows:
    chosen = rows[which]
    if isinstance(chosen, np.ndarray):
        chosen.flags.writeable = False
    return chosen


def _without_strays(rows: dict[str, AnyRows], layouts: Mapping[str, Layout], problems: list[str]) -> dict[str, AnyRows]:
    """Take out of `rows`, and return, those whose number is of another time; `problems` is told of them."""
    strays: dict[str, AnyRows] = {}
    for member, own in rows.items():
        wrong, all_told = misnumbered(own, layouts[member], of_plant=member == PLANT)
        if not all_told:
            problems.append(f"the numbers of the rows of {member} do not go up with their times")
        if not len(wrong):
            continue
        strays[member] = taken = _chosen(own, wrong)
        rows[member] = _chosen(own, np.delete(np.arange(len(own)), wrong))
        number, t = int(taken["sequence"][0]), float(taken["t"][0])
        problems.append(
            f"{len(wrong)} of the rows of {member} are left out: their numbers do not fit their times (the first: "
            f"{number} at {t:.3f} s)"
        )
    return strays


def _gaps(sequence: NDArray[np.uint64], *, of_plant: bool) -> Gaps:
    steps = sequence[1:] - sequence[:-1]
    usual = int(np.median(steps)) if of_plant and len(steps) else 1  # it may tell the truth less often than it ticks
    where = np.flatnonzero(steps > usual)
    return tuple((int(sequence[i]) + usual, int(sequence[i + 1]) - usual) for i in where)
