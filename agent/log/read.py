"""A log as numpy arrays: rows, events, attachments, and what is missing.  Never changes a file, never guesses a row."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from numpy.typing import NDArray

from agent.log import ros_definitions
from agent.log.scan import LogScan, Messages, library_of
from agent.log.standard import text_of
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE, Layout
from agent.telemetry.row.topics import PLANT, Kind, parse_topic
from drivers.interface import Refusal

__all__ = ["Event", "Level", "LogError", "RunLog", "read_log"]

RUN_FILE: Final = "run.json"
COMPLETENESS: Final = "completeness"
RECOVERY: Final = "recovery"  # what `coop recover` says of a log it repaired
_LAYOUTS: Final = {ros_definitions.schema_name(layout.ros_name): layout for layout in (AGENT_STATE, PLANT_STATE)}


class LogError(Refusal):
    """The file is no log that can be read."""


@dataclass(frozen=True)
class RunLog:
    """One run.  Arrays are read-only."""

    path: Path
    cell: str
    agents: dict[str, NDArray[np.void]]  # by arm: rows of AGENT_STATE.dtype, by sequence, each once
    plant: NDArray[np.void] | None  # rows of PLANT_STATE.dtype; None on real arms
    events: list[Event]  # by time
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    complete: bool  # the recorder finished the file, nothing is missing, nothing is damaged
    gaps: dict[str, tuple[tuple[int, int], ...]]  # by member: absent sequence numbers, first and last of each gap
    problems: tuple[str, ...] = field(default=())  # what is wrong with the file, for a person

    def run_info(self) -> dict[str, Any]:
        """The run's description.  Raises LogError when the log has none."""
        try:
            info = json.loads(self.attachments[RUN_FILE])
        except (KeyError, ValueError) as error:
            raise LogError(
                f"{self.path} does not say which run it is",
                found=repr(error),
                expected=f"an attachment {RUN_FILE}",
                remedy="take a log that `coop record` made",
            ) from error
        return dict(info)


def read_log(path: Path) -> RunLog:
    """Read a log, finished or not.

    Raises LogError for what is no log of ours or of another layout; what is merely cut or damaged is read up to there
    and told of in `problems`.
    """
    data = _contents(path)
    scan, collected = LogScan(data), _Collected(path)
    for record in scan:
        collected.add(record)
    problems = [*scan.problems, *collected.problems]
    rows = {member: _by_sequence(collected.rows_of(member)) for member in collected.members()}
    agents = {member: r for member, r in rows.items() if member != PLANT}
    if not agents:
        raise LogError(
            f"{path} holds no rows",
            found=problems[0] if problems else "no agent's state",
            expected=f"messages of {AGENT_STATE.ros_name}",
            remedy="take a log that `coop record` made",
        )
    told = collected.metadata.get(COMPLETENESS, {}).get("complete") == "true"
    left_out = int(collected.metadata.get(RECOVERY, {}).get("damaged", "0"))
    return RunLog(
        path=path,
        cell=collected.cell,
        agents=agents,
        plant=rows.get(PLANT),
        events=sorted(collected.events, key=lambda event: event.utc_ns),
        attachments=collected.attachments,
        metadata=collected.metadata,
        complete=told and not problems and not left_out,
        gaps={member: _gaps(r) for member, r in rows.items()},
        problems=tuple(problems),
    )


class _Collected:
    """What a scan brings, sorted by kind."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._kinds: dict[int, tuple[str, Kind]] = {}
        self._rows: dict[str, bytearray] = {}
        self._layout_of: dict[str, Layout] = {}
        self.cell = ""
        self.events: list[Event] = []
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.problems: list[str] = []

    def add(self, record: object) -> None:
        if isinstance(record, Messages):
            self._add_messages(record)
        elif isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._add_channel(record)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def members(self) -> list[str]:
        """Members that have a channel of rows."""
        return list(self._layout_of)

    def rows_of(self, member: str) -> NDArray[np.void]:
        """Rows as they lie in the file."""
        rows: NDArray[np.void] = np.frombuffer(self._rows[member], self._layout_of[member].dtype)
        rows.flags.writeable = False
        return rows

    def _add_channel(self, channel: Channel) -> None:
        address = parse_topic(channel.topic)
        if address is None:
            return
        self.cell = address.cell
        self._kinds[channel.id] = (address.member, address.kind)
        if address.kind is Kind.STATE and address.member not in self._layout_of:
            self._layout_of[address.member] = self._layout(channel)
            self._rows[address.member] = bytearray()

    def _layout(self, channel: Channel) -> Layout:
        schema = self._schemas.get(channel.schema_id)
        layout = _LAYOUTS.get(schema.name) if schema else None
        if schema is None or layout is None or schema.data.decode(errors="replace") != layout.definition:
            raise LogError(
                f"{self._path}: {channel.topic} has another layout",
                found=schema.name if schema else "no schema",
                expected="the layout of this release",
                remedy="read it with the release that recorded it, which is in its metadata `recorder`",
            )
        return layout

    def _add_messages(self, messages: Messages) -> None:
        data = messages.data
        rows = {
            channel: (self._rows[member], self._layout_of[member].dtype.itemsize)
            for channel, (member, kind) in self._kinds.items()
            if kind is Kind.STATE
        }
        for channel, begin, end in messages.places:
            if channel in rows:
                buffer, size = rows[channel]
                if end - begin == size:
                    buffer += data[begin:end]
                else:
                    self.problems.append(f"{self._kinds[channel][0]}: a row of {end - begin} bytes left out")
            elif channel in self._kinds and self._kinds[channel][1] is Kind.EVENT:
                self._add_event(data[begin:end])

    def _add_event(self, payload: bytes) -> None:
        try:
            self.events.append(Event.from_json(text_of(payload)))
        except ValueError as error:
            self.problems.append(f"an event that is none: {error}")


def _contents(path: Path) -> memoryview:
    try:
        data = memoryview(path.read_bytes())
    except OSError as error:
        raise LogError(
            f"cannot read {path}", found=error.strerror, expected="a log file", remedy="correct the path"
        ) from error
    if library_of(data) is None:
        raise LogError(
            f"{path} is no MCAP file",
            found=f"{len(data)} bytes starting {bytes(data[:8])!r}",
            expected="a log that `coop record` made",
            remedy="give the path of the .mcap file of a run",
        )
    return data


def _by_sequence(rows: NDArray[np.void]) -> NDArray[np.void]:
    sequence = rows["sequence"]
    if np.all(sequence[1:] > sequence[:-1]):
        return rows
    _, first = np.unique(sequence, return_index=True)
    ordered: NDArray[np.void] = rows[first]
    ordered.flags.writeable = False
    return ordered


def _gaps(rows: NDArray[np.void]) -> tuple[tuple[int, int], ...]:
    sequence = rows["sequence"]
    where = np.flatnonzero(sequence[1:] - sequence[:-1] > 1)
    return tuple((int(sequence[i]) + 1, int(sequence[i + 1]) - 1) for i in where)
