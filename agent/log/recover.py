"""Mends a log whose recorder was killed: everything intact into a new, finished file, checked, then put in its place.

A log that is being written is refused, and the old file stays until the new one has been read back; where more is left
out than a record that was cut at the end, it stays under another name.  A finished log is left alone unless forced.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, Final

from mcap.records import Attachment, Channel, Metadata, Schema

from agent.atomic import is_full
from agent.log.chunk import LIBRARY
from agent.log.file import PROFILE, LogFileError, LogInTheWay
from agent.log.layout import OURS
from agent.log.locks import SUFFIX, alone_with, is_named, is_written
from agent.log.messages import Messages
from agent.log.read import RECOVERY, LogError
from agent.log.scan import LogScan, library_of, open_file
from agent.log.writer import BatchWriter
from agent.telemetry.row.sample import AGENT_STATE

KEPT: Final = "damaged"  # behind the name of a log: the original of one that was mended


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What was found and done."""

    path: Path
    repaired: bool  # False: there was nothing to repair, or it is finished and left alone
    messages: int
    problems: tuple[str, ...]
    damaged: bool = False  # something is wrong with it but that its end was cut
    original: Path | None = None  # where it is, when it was kept
    rows: int = 0  # of arms, among the messages
    program: str = ""  # that wrote it, by its head

    @property
    def line(self) -> str:
        """For a person."""
        left = "finished, and damaged: left as it is" if self.damaged else "nothing to repair"
        become, whose = "repaired" if self.repaired else left, f" written by {self.program}" if self.program else ""
        if not self.rows:
            return f"{become}; no row of an arm is in it, {self.messages} messages{whose}"
        return f"{become}, {self.messages} messages, read back"


def recover(path: Path, stop: Callable[[], bool] = lambda: False, *, force: bool = False) -> RecoverReport:
    """Repair a log in place; one that ends as finished logs do is left alone unless forced.

    An unfinished repair leaves the log as it was.  A damaged original is kept under another name.

    Raises LogError when it is no log, LogInTheWay when it is being written, LogFileError when the disk has no room.
    """
    try:
        file = open_file(path)
    except OSError as error:
        raise _unreadable(path, error) from error
    with file:
        if is_written(file.fileno()):
            raise LogInTheWay(
                f"{path} is being written",
                found="its recorder",
                expected="a log whose recorder has ended",
                remedy="stop that recorder; it finishes the file",
            )
        try:
            return _recover(path, file, stop, force=force)
        except OSError as error:
            raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> LogError:
    return LogError(f"cannot open {path}", found=error.strerror, expected="a log", remedy="correct the path")


def repair_leftovers(
    folder: Path, *, but: Path, stop: Callable[[], bool] = lambda: False
) -> tuple[tuple[RecoverReport, ...], tuple[str, ...]]:
    """Repair our own unfinished logs in a folder, but not `but`; return what was repaired, and what could not be."""
    repaired, failed = [], []
    for path in sorted(folder.glob("*.mcap")):
        if path == but or stop() or not path.is_file():
            continue
        try:
            if is_unfinished(path) and (done := recover(path, stop)).repaired:
                repaired.append(done)
        except (LogError, LogFileError) as error:
            failed.append(str(error))
    return tuple(repaired), tuple(failed)


def is_unfinished(path: Path) -> bool:
    """Cheaply: ours by its head, and without the closing magic.  Raises LogError."""
    try:
        with open_file(path) as file:
            head = file.read(4096)
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - 8))
            return library_of(BytesIO(head)) == LIBRARY and file.read() != head[:8]
    except OSError as error:
        raise _unreadable(path, error) from error


def _recover(path: Path, file: BinaryIO, stop: Callable[[], bool], *, force: bool) -> RecoverReport:
    program = library_of(file)
    if program is None:
        raise LogError(
            f"{path} is no MCAP file", found=f"{file.seek(0, 2)} bytes", expected="a log", remedy="correct the path"
        )
    scan = LogScan(file)
    seen = _Fingerprint()
    for record in scan:
        seen.add(record)
        if stop():
            return RecoverReport(path, False, 0, ("stopped",))
    problems = tuple(scan.problems)
    damaged = scan.finished or len(problems) > 1  # of a log that ends early without more, that alone is told
    if not problems or (scan.closed and not force):
        return RecoverReport(path, False, seen.count, problems, damaged and bool(problems), None, seen.rows, program)
    if scan.another_at is not None:
        at = scan.another_at
        raise LogError(
            f"{path} is two logs one behind the other", found=f"a second one from byte {at} on", expected="one log",
            remedy=f"take them apart: `head -c {at}`, `tail -c +{at + 1}`",
        )  # fmt: skip
    log, original = path.resolve(), None  # a link stays one: what it leads to is mended
    try:
        with alone_with(log) as copy:
            if copy is None or not is_named(log, file.fileno()):
                raise LogInTheWay(
                    f"{path} is being mended", found="another one that mends or removes it", expected="nobody",
                    remedy="wait for its end",
                )  # fmt: skip
            _rewrite(file, copy, scan)
            os.fchmod(copy, log.stat().st_mode & 0o777)
            _check(path, copy, seen)
            if damaged:
                original = _keep(log)
            log.with_name(log.name + SUFFIX).replace(log)
            _sync(log.parent, os.O_DIRECTORY)
    except OSError as error:
        full = is_full(error)
        raise LogFileError(
            f"cannot repair {path}", found=error.strerror,
            expected="room for a copy of it" if full else "a folder in which a copy of it can be written",
            remedy="make room" if full else "repair it as a user who may write there, or a copy of it elsewhere",
        ) from error  # fmt: skip
    return RecoverReport(path, True, seen.count, problems, damaged, original, seen.rows, program)


def _keep(log: Path) -> Path:
    """A second name for a log, which takes no room.  Raises LogFileError where it cannot have one."""
    names = (log.with_name(f"{log.name}.{KEPT}{number or ''}") for number in count())
    for name in names:
        try:
            name.hardlink_to(log)
        except FileExistsError:
            continue
        except OSError as error:
            raise LogFileError(
                f"cannot keep the damaged original of {log} as {name.name}", found=error.strerror,
                expected="a file system in which a file can have two names", remedy="mend a copy on another disk",
            ) from error  # fmt: skip
        return name
    raise AssertionError("unreachable")


def _check(path: Path, copy: int, seen: _Fingerprint) -> None:
    """Raises LogError unless the copy can be read and holds what was seen."""
    found = _Fingerprint()
    with os.fdopen(os.dup(copy), "rb") as file:
        file.seek(0)
        scan = LogScan(file)
        for record in scan:
            found.add(record)
    if scan.problems or found != seen:
        raise LogError(
            f"the repaired copy of {path} is not what it should be",
            found=f"{found.count} messages, {scan.problems}",
            expected=f"{seen.count} messages",
            remedy="keep the original; see whether the disk is sound",
        )


class _Fingerprint:
    """Checksum of all messages by topic, and of what is beside them: equal exactly when the contents are."""

    def __init__(self) -> None:
        self.count = self.rows = 0
        self._row_schemas: set[int] = set()
        self._row_channels: set[int] = set()
        self._topics: dict[int, str] = {}
        self._sums: dict[str, int] = {}
        self._attachments: dict[str, int] = {}

    def add(self, record: object) -> None:
        if isinstance(record, Schema):
            if OURS.get(record.name) is AGENT_STATE:
                self._row_schemas.add(record.id)
        elif isinstance(record, Channel):
            self._topics[record.id] = record.topic
            if record.schema_id in self._row_schemas:
                self._row_channels.add(record.id)
        elif isinstance(record, Attachment):
            self._attachments[record.name] = zlib.crc32(record.data)
        elif isinstance(record, Messages):
            view = memoryview(record.data)
            for run in record.runs:
                topic = self._topics.get(run.channel)
                if topic is not None:
                    self.count += run.number
                    self.rows += run.number if run.channel in self._row_channels else 0
                    end = run.begin + run.stride * run.number
                    self._sums[topic] = zlib.crc32(view[run.begin : end], self._sums.get(topic, 0))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Fingerprint) and (self.count, self._sums, self._attachments) == (
            other.count,
            other._sums,
            other._attachments,
        )

    __hash__ = None  # type: ignore[assignment]


def _rewrite(source: BinaryIO, target: int, scan: LogScan) -> None:
    with os.fdopen(os.dup(target), "wb") as file:
        writer = BatchWriter(file.write)
        writer.start(PROFILE, LIBRARY)
        copy = _Copy(writer)
        for record in LogScan(source):
            copy.add(record)
        writer.end_chunk()
        told = {"utc_ns": str(time.time_ns()), "damaged": str(scan.damaged), "problems": "\n".join(scan.problems)}
        writer.add_metadata(RECOVERY, told)
        writer.finish()
        file.flush()
        os.fsync(file.fileno())


class _Copy:
    """Puts records into a writer; schemas and channels keep their numbers."""

    def __init__(self, writer: BatchWriter) -> None:
        self._writer = writer
        self._schemas = {0}
        self._channels: set[int] = set()

    def add(self, record: Any) -> None:
        if isinstance(record, Attachment):
            self._writer.add_attachment(record)
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Schema):
            if record.id not in self._schemas:
                self._schemas.add(record.id)
                self._writer.add_schema(record)
        elif isinstance(record, Channel):
            if record.id not in self._channels and record.schema_id in self._schemas:
                self._channels.add(record.id)
                self._writer.add_channel(record)
        elif isinstance(record, Messages):
            self._add_messages(record)

    def _add_messages(self, messages: Messages) -> None:
        copy = messages.copy(self._channels)
        if copy.content:
            self._writer.append_copy(copy)
        if self._writer.full:
            self._writer.end_chunk()


def _sync(path: Path, flags: int) -> None:
    fd = os.open(path, os.O_RDONLY | flags)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
