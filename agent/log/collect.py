"""Sorts what a scan of a log brings: rows to one place per member, events, attachments, metadata, and what is wrong."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Final, Generic, Protocol, TypeVar

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from numpy.typing import NDArray

from agent.log.cdr import text_of
from agent.log.chunk import LIBRARY
from agent.log.layout import OURS, differences, parse
from agent.log.messages import Messages, Run
from agent.log.scan import LogScan, library_of, open_file
from agent.telemetry.row.event import Event
from agent.telemetry.row.health import Health
from agent.telemetry.row.sample import Layout
from agent.telemetry.row.topics import Kind, parse_topic
from drivers.interface import Refusal

Needs = Mapping[str, frozenset[str]]  # names of fields by kind of row
_OTHER_RELEASE: Final = (
    "`coop export`, `coop replay` and `coop events` read it as it is, `coop view` if it has what a picture needs; for "
    "the rest take the release that recorded it"
)


class LogError(Refusal):
    """The file is no log that can be read."""


class NoRows(LogError):
    """The log can be read, and no row of an arm is in it."""


class RowSink(Protocol):
    """Where the rows of one member go."""

    def add(self, messages: NDArray[np.uint8]) -> None:
        """Take complete messages (k, size), in the order of the file."""
        ...


Sink = TypeVar("Sink", bound=RowSink)


class Collected(Generic[Sink]):
    """All of one log."""

    def __init__(
        self,
        path: Path,
        new_sink: Callable[[Layout], Sink],
        *,
        any_layout: bool = False,
        needs: Needs = MappingProxyType({}),
    ) -> None:
        """`new_sink` is called once per member that has a channel of rows; any_layout: rows of other releases too.

        needs: rows of other releases, if they have these fields.
        """
        self.cell = ""
        self.rows: dict[str, Sink] = {}
        self.events: list[Event] = []
        self.health: dict[str, list[Health]] = {}
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.problems: list[str] = []
        self.again = 0  # events that were there before
        self.layouts: dict[str, Layout] = {}
        self.path = path
        self._any_layout, self._needs = any_layout, needs
        self._new_sink = new_sink
        self._schemas: dict[int, Schema] = {}
        self._kinds: dict[int, tuple[str, Kind]] = {}  # member and kind by channel
        self._row_bytes: dict[str, int] = {}
        self._told: set[bytes] = set()  # digests of the events

    def read(self) -> None:
        """Read the file once.  Raises LogError."""
        with _opened(self.path) as file:
            _require_mcap(self.path, file)
            scan = LogScan(file)
            for record in scan:
                self._add(record)
        self.events.sort(key=_order)
        self.problems = [*scan.problems, *self.problems]

    def _add(self, record: object) -> None:
        if isinstance(record, Messages):
            for run in record.runs:
                self._add_run(record, run)
        elif isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._add_channel(record)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def _add_channel(self, channel: Channel) -> None:
        address = parse_topic(channel.topic)
        if address is None:
            return
        self.cell = address.cell
        self._kinds[channel.id] = (address.member, address.kind)
        if address.kind is Kind.STATE and address.member not in self.rows:
            layout = self.layouts[address.member] = self._layout(channel)
            self.rows[address.member] = self._new_sink(layout)
            self._row_bytes[address.member] = layout.dtype.itemsize

    def _layout(self, channel: Channel) -> Layout:
        schema = self._schemas.get(channel.schema_id)
        own = OURS.get(schema.name) if schema else None
        written = schema.data.decode(errors="replace") if schema else ""
        found = parse(schema.name, written) if schema else None
        if (
            found is None
            or own is None
            or not (self._any_layout or _numbers(found) == _numbers(own) or self._serves(found))
        ):
            told = "no schema" if schema is None else schema.name
            if found is not None and own is not None:
                told = f"{told} {differences(found.fields, own.fields) or 'in other units'}"
            release = self.metadata.get("versions", {}).get(LIBRARY)
            raise LogError(
                f"{self.path}: {channel.topic} has another layout",
                found=f"{told}, of release {release}" if release else told,
                expected="the layout of this release",
                remedy=_OTHER_RELEASE if found is not None else "read it with the release that recorded it",
            )
        return found

    def _serves(self, layout: Layout) -> bool:
        """Whether rows of another release have what the reader needs."""
        wanted = self._needs.get(layout.ros_name)
        return wanted is not None and wanted <= {f.name for f in layout.fields}

    def _add_run(self, messages: Messages, run: Run) -> None:
        if run.channel not in self._kinds:
            return
        member, kind = self._kinds[run.channel]
        payloads = messages.payloads(run)
        if kind is Kind.STATE:
            if payloads.shape[1] == self._row_bytes[member]:
                self.rows[member].add(payloads)
            else:
                self.problems += [f"{member}: a row of {payloads.shape[1]} bytes left out"] * run.number
        elif kind is Kind.EVENT:
            for payload in payloads:
                self._add_event(payload.tobytes())
        elif kind is Kind.HEALTH:
            for payload in payloads:
                self._add_health(member, payload.tobytes())

    def _add_event(self, payload: bytes) -> None:
        digest = hashlib.blake2b(payload, digest_size=16).digest()
        if digest in self._told:
            self.again += 1
            return
        self._told.add(digest)
        try:
            self.events.append(Event.from_json(text_of(payload)))
        except ValueError as error:
            self.problems.append(f"an event that is none: {error}")

    def _add_health(self, member: str, payload: bytes) -> None:
        try:
            self.health.setdefault(member, []).append(Health.from_json(text_of(payload)))
        except ValueError as error:
            self.problems.append(f"{member}: a health text that is none: {error}")


def _numbers(layout: Layout) -> list[tuple[str, str, int, str]]:
    """What a reader needs of a layout to read it rightly; in what words a field is described is not of it."""
    return [(f.name, f.ros_type, f.length, f.unit) for f in layout.fields]


def _order(event: Event) -> tuple[int, bool]:
    """By time; of what has the same the file's order, but what an agent tells before its first row comes before that.

    Telemetry tells of a row (`sequence`) before it looks for what the agent said, and simulated time may stand still.
    """
    return event.utc_ns, event.data.get("sequence") == 0


def require_log(path: Path) -> None:
    """Raise LogError for what is not there or no MCAP file; of the rest of the file nothing is read."""
    with _opened(path) as file:
        _require_mcap(path, file)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with open_file(path) as file:
            yield file
    except OSError as error:
        raise LogError(
            f"cannot read {path}", found=error.strerror, expected="a log file", remedy="correct the path"
        ) from error


def _require_mcap(path: Path, file: BinaryIO) -> None:
    if library_of(file) is None:
        file.seek(0)
        head = file.read(8)
        raise LogError(
            f"{path} is no MCAP file",
            found=f"{file.seek(0, 2)} bytes starting {head!r}",
            expected="a log that `coop record` made",
            remedy="give the path of the .mcap file of a run",
        )
