"""Mends a log whose recorder was killed: everything intact into a new, finished file, checked, then put in its place.

Never touches a log that is being written, and never gives up the old file before the new one has been read back.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from agent.log.file import CHUNK_BYTES, LIBRARY, PROFILE, LogFileError, lock
from agent.log.read import RECOVERY, LogError
from agent.log.scan import MESSAGE_HEAD, LogScan, Messages, library_of

SUFFIX: Final = ".repairing"


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What was found and done."""

    path: Path
    repaired: bool  # False: there was nothing to repair
    messages: int
    problems: tuple[str, ...]


def recover(path: Path, stop: Callable[[], bool] = lambda: False) -> RecoverReport:
    """Repair a log in place; a finished one is left alone.  An unfinished repair leaves the log as it was.

    Raises LogError when it is no log, LogFileError when it is being written or the disk has no room.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise _unreadable(path, error) from error
    try:
        if not lock(fd):
            raise LogFileError(
                f"{path} is being written",
                found="a recorder's lock",
                expected="a log whose recorder has ended",
                remedy="stop that recorder; it finishes the file",
            )
        try:
            data = path.read_bytes()
        except OSError as error:
            raise _unreadable(path, error) from error
        return _recover(path, memoryview(data), stop)
    finally:
        os.close(fd)


def _unreadable(path: Path, error: OSError) -> LogError:
    return LogError(f"cannot open {path}", found=error.strerror, expected="a log", remedy="correct the path")


def repair_leftovers(
    folder: Path, *, but: Path, stop: Callable[[], bool] = lambda: False
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Repair our own unfinished logs in a folder, but not `but`; return those repaired, and what could not be."""
    repaired, failed = [], []
    for path in sorted(folder.glob("*.mcap")):
        if path == but or stop() or not _is_unfinished(path):
            continue
        try:
            if recover(path, stop).repaired:
                repaired.append(path)
        except (LogError, LogFileError) as error:
            failed.append(str(error))
    return tuple(repaired), tuple(failed)


def _is_unfinished(path: Path) -> bool:
    """Cheaply: ours by its head, and without the closing magic."""
    with path.open("rb") as file:
        head = file.read(4096)
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 8))
        return library_of(memoryview(head)) == LIBRARY and file.read() != head[:8]


def _recover(path: Path, data: memoryview, stop: Callable[[], bool]) -> RecoverReport:
    if library_of(data) is None:
        raise LogError(
            f"{path} is no MCAP file", found=f"{len(data)} bytes", expected="a log", remedy="correct the path"
        )
    scan = LogScan(data)
    seen = _Fingerprint()
    for record in scan:
        seen.add(record)
        if stop():
            return RecoverReport(path, False, 0, ("stopped",))
    problems = tuple(scan.problems)
    if not problems:
        return RecoverReport(path, False, seen.count, ())
    temporary = path.with_name(path.name + SUFFIX)
    try:
        _rewrite(data, temporary, scan)
        temporary.chmod(path.stat().st_mode & 0o777)
        again = LogScan(memoryview(temporary.read_bytes()))
        check = _Fingerprint()
        for record in again:
            check.add(record)
        if again.problems or check != seen:
            raise LogError(
                f"the repaired copy of {path} is not what it should be",
                found=f"{check.count} messages, {again.problems}",
                expected=f"{seen.count} messages",
                remedy="keep the original; see whether the disk is sound",
            )
        temporary.replace(path)
        _sync(path.parent, os.O_DIRECTORY)
    except OSError as error:
        raise LogFileError(
            f"cannot repair {path}", found=error.strerror, expected="room for a copy of it", remedy="make room"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    return RecoverReport(path, True, seen.count, problems)


class _Fingerprint:
    """Checksum of all messages by topic, and of what is beside them: equal exactly when the contents are."""

    def __init__(self) -> None:
        self.count = 0
        self._topics: dict[int, str] = {}
        self._sums: dict[str, int] = {}
        self._attachments: dict[str, int] = {}

    def add(self, record: object) -> None:
        if isinstance(record, Channel):
            self._topics[record.id] = record.topic
        elif isinstance(record, Attachment):
            self._attachments[record.name] = zlib.crc32(record.data)
        elif isinstance(record, Messages):
            view = memoryview(record.data)
            for channel, begin, end in record.places:
                topic = self._topics.get(channel)
                if topic is not None:
                    self.count += 1
                    self._sums[topic] = zlib.crc32(view[begin - MESSAGE_HEAD.size + 2 : end], self._sums.get(topic, 0))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Fingerprint) and (self.count, self._sums, self._attachments) == (
            other.count,
            other._sums,
            other._attachments,
        )

    __hash__ = None  # type: ignore[assignment]


def _rewrite(data: memoryview, target: Path, scan: LogScan) -> None:
    with target.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(PROFILE, LIBRARY)
        copy = _Copy(writer)
        for record in LogScan(data):
            copy.add(record)
        told = {"utc_ns": str(time.time_ns()), "damaged": str(scan.damaged), "problems": "\n".join(scan.problems)}
        writer.add_metadata(RECOVERY, told)
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fsync(file.fileno())


class _Copy:
    """Puts records into a writer that numbers its channels anew."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def add(self, record: Any) -> None:
        if isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Schema):
            if record.id not in self._schemas:
                self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            if record.id not in self._channels and record.schema_id in self._schemas:
                self._channels[record.id] = self._writer.register_channel(
                    record.topic, record.message_encoding, self._schemas[record.schema_id], record.metadata
                )
        elif isinstance(record, Messages):
            self._add_messages(record)

    def _add_messages(self, messages: Messages) -> None:
        for channel, begin, end in messages.places:
            if channel in self._channels:
                _, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(messages.data, begin - MESSAGE_HEAD.size)
                self._writer.add_message(
                    self._channels[channel], log_time, messages.data[begin:end], publish_time, sequence
                )


def _sync(path: Path, flags: int) -> None:
    fd = os.open(path, os.O_RDONLY | flags)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
