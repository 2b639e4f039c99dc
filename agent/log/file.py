"""An MCAP file that is being written: on the disk chunk by chunk; a disk that fails ends it and raises nothing.

The name must be free, and a lock keeps others away.  A write that fails (full disk, lost mount) ends the file at its
last complete chunk; the caller goes on without it.  A folder that is moved meanwhile takes the whole file with it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from agent.log.chunk import LIBRARY, Group
from agent.log.disk import Sink, Syncer, free_bytes, has_a_name, require_a_name, sync_directory
from agent.log.locks import alone_with, create_written, is_written
from agent.log.writer import BatchWriter, Records
from drivers.interface import Refusal

PROFILE: Final = "ros2"
FLUSH_S: Final = 0.25
MIN_FREE_BYTES: Final = 64 << 20


def _nothing() -> None:
    """Where nothing waits."""


class LogFileError(Refusal):
    """The log cannot be written where it was asked for."""

    exit_code = 4


class LogInTheWay(LogFileError):
    """A log is there already, or another recorder is at work: nothing is begun."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside the log."""

    name: str
    media_type: str
    data: bytes


class LogFile:
    """One log.  Once it has failed or is finished, everything is a no-op but the counting of what is lost."""

    def __init__(
        self,
        path: Path,
        attachments: Iterable[Attachment],
        metadata: Mapping[str, Mapping[str, str]],
        *,
        created_ns: int,
        min_free_bytes: int = MIN_FREE_BYTES,
    ) -> None:
        """Create the file, lock it, and have attachments and metadata on the disk before returning.

        Raises LogInTheWay when it exists, LogFileError when it cannot be written or the disk is nearly full.
        """
        self.path = path
        self.failure: str | None = None
        self.removed = False  # nothing of it is left
        self.nearly_full = False  # there is just room enough to finish
        self.lost: Counter[int] = Counter()  # messages by channel that came and are not in the file
        self.before_flush: Callable[[], None] = _nothing  # writes what waits to be written
        self._open = True
        self._schemas: dict[str, int] = {}
        self._channel_count = 0
        self._unsafe: Counter[int] = Counter()  # the same, since the last whole chunk
        self._min_free = min_free_bytes
        self._fd = _create(path, min_free_bytes)
        self._sink = Sink(self._fd)
        self._writer = BatchWriter(self._sink.write)
        self._flushed_s = time.monotonic()
        try:
            self._write_head(attachments, metadata, created_ns)
        except OSError as error:
            with suppress(OSError):  # the first error is what is told
                os.close(self._fd)
            with suppress(OSError):
                path.unlink()
            raise _cannot_write(path, error) from error
        self._syncer = Syncer(self._fd)

    def _write_head(
        self, attachments: Iterable[Attachment], metadata: Mapping[str, Mapping[str, str]], created_ns: int
    ) -> None:
        self._writer.start(PROFILE, LIBRARY)
        for a in attachments:
            self._writer.add_attachment(AttachmentRecord(created_ns, created_ns, a.name, a.media_type, a.data))
        for name, values in metadata.items():
            self._writer.add_metadata(name, values)
        self._flush()
        os.fsync(self._fd)
        sync_directory(self.path.parent)

    def channel(self, topic: str, schema_name: str, definition: str, metadata: Mapping[str, str]) -> int:
        """Register a channel of ROS 2 messages in CDR; returns its number."""
        if schema_name not in self._schemas:
            number = self._schemas[schema_name] = len(self._schemas) + 1
            self._writer.add_schema(Schema(number, definition.encode(), "ros2msg", schema_name))
        self._channel_count += 1
        schema = self._schemas[schema_name]
        self._writer.add_channel(Channel(self._channel_count, topic, "cdr", dict(metadata), schema))
        return self._channel_count

    def write(
        self,
        group: Group,
        sequences: NDArray[np.uint64],
        utc_ns: NDArray[np.int64],
        fill: Callable[[Records, slice], None],
    ) -> None:
        """Write one message of each channel of the group per time.

        `fill(records, part)` puts the messages into the records of that part of the sequences; every part is filled
        once, in order.
        """
        count, done = len(utc_ns), 0
        try:
            while self._open and done < count:
                part = slice(done, min(count, done + self._writer.room(group.dtype.itemsize)))
                done = part.stop
                for channel in group.channels:
                    self._unsafe[channel] += part.stop - part.start
                fill(self._writer.append(group, sequences[part], utc_ns[part]), part)
                if self._writer.full:
                    self._flush()
        except OSError as error:
            self._fail(error)
        for channel in group.channels:
            self.lost[channel] += count - done

    @property
    def size(self) -> int:
        """Bytes on the disk."""
        return self._sink.position

    def tick(self, now_s: float) -> None:
        """Flush when it is time, and look how much room is left."""
        if now_s - self._flushed_s >= FLUSH_S:
            self.flush(now_s)

    def flush(self, now_s: float) -> None:
        """Write what came, so that it is in the file or the file has failed, and look how much room is left."""
        if not self._open:
            return
        self._flushed_s = now_s
        try:
            self.before_flush()
            if self.failure is not None:  # what waited did not go to the disk
                return
            if self._unsafe:
                self._flush()
            if self._syncer.error is not None:
                raise self._syncer.error
            require_a_name(self._fd, self.path)
            self.nearly_full = free_bytes(self._fd) < self._min_free
        except OSError as error:
            self._fail(error)

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> bool:
        """Write the last metadata and the index, and close; False when the file has failed."""
        self.before_flush()
        if self._open:
            try:
                self._finish(metadata)
            except OSError as error:
                self._fail(error)
            self._open = False
            self.before_flush = _nothing  # it knows this file, which would keep both until a collection
        return self.failure is None

    def _finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._flush()
        for name, values in metadata.items():
            self._writer.add_metadata(name, values)
        self._writer.finish()
        self._syncer.stop()
        os.fsync(self._fd)
        os.close(self._fd)

    def _flush(self) -> None:
        self._writer.end_chunk()
        self._sink.good = self._sink.position
        self._unsafe.clear()

    def _fail(self, error: OSError) -> None:
        """Cut the file back to its last complete record, where the disk lets it, and give it up."""
        self.failure = error.strerror or str(error)
        self._open = False
        self.lost += self._unsafe
        with suppress(OSError):
            self._syncer.stop()
        with suppress(OSError):  # of a disk that is gone nothing can be asked, and what it has stays as it is
            self.removed = not has_a_name(self._fd, self.path)
        with suppress(OSError):
            os.ftruncate(self._fd, self._sink.good)
        with suppress(OSError):  # closed even where it says that it could not write
            os.close(self._fd)


def require_no_log(path: Path) -> None:
    """See that nothing has the name of a log that is to be made, before work is done for it.  Raises LogInTheWay."""
    if os.path.lexists(path):
        raise _in_the_way(path)


def remove_log(path: Path) -> None:
    """Remove a log that may be there.  Raises LogFileError, LogInTheWay where a recorder writes it or one mends it."""
    if not os.path.lexists(path):
        return
    try:
        with alone_with(path) as alone:
            if alone is None or not _is_free(path):
                raise LogInTheWay(
                    f"{path} is being written", found="its recorder, or who mends it",
                    expected="a log whose recorder has ended", remedy="stop that one, or name another folder",
                )  # fmt: skip
            path.unlink()
    except FileNotFoundError:
        return
    except OSError as error:
        raise _cannot_write(path, error) from error


def _create(path: Path, min_free_bytes: int) -> int:
    try:
        free = free_bytes(path.parent)
        if free < min_free_bytes:
            raise LogFileError(
                f"no room for a log in {path.parent}",
                found=f"{free >> 20} MB free",
                expected=f"at least {min_free_bytes >> 20} MB",
                remedy="remove old runs, or record elsewhere",
            )
        return create_written(path)
    except FileExistsError as error:
        raise _in_the_way(path) from error
    except OSError as error:
        raise _cannot_write(path, error) from error


def _in_the_way(path: Path) -> LogInTheWay:
    return LogInTheWay(
        f"{path} exists already",
        found="a file" if _is_free(path) else "a log that another recorder is writing",
        expected="no file",
        remedy="give another name; a log is never overwritten",
    )


def _is_free(path: Path) -> bool:
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe is not waited for
    except FileNotFoundError:
        return True  # a link to nothing, or gone by now
    try:
        return not is_written(fd)
    finally:
        os.close(fd)


def _cannot_write(path: Path, error: OSError) -> LogFileError:
    return LogFileError(
        f"cannot write {path}",
        found=error.strerror,
        expected="an existing directory that can be written",
        remedy=f"create it with `mkdir -p {path.parent}`, or record elsewhere",
    )
