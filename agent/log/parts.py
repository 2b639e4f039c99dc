"""The log files of one recording: which comes next, when, and what makes room for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

from agent.host.flock import lock
from agent.log.chunk import LIBRARY
from agent.log.file import LogFileError, LogInTheWay
from agent.log.locks import is_written, lock_path, note_path, open_closed
from agent.log.read import LogError
from agent.log.recover import is_unfinished
from agent.log.scan import library_of, open_file

_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Limits:
    """When a log is followed by the next one, and how much all logs of its folder may take; None: no limit."""

    part_bytes: int | None = None
    part_s: float | None = None
    folder_bytes: int | None = None

    def reached(self, size_bytes: int, age_s: float) -> bool:
        """Whether a log of that size and age is followed by the next one."""
        return (self.part_bytes is not None and size_bytes >= self.part_bytes) or (
            self.part_s is not None and age_s >= self.part_s
        )


def next_path(first: Path) -> Path:
    """A free name for the log behind those that began with `first`: run.mcap, run_2.mcap, run_3.mcap …"""
    number = 2
    while os.path.lexists(path := first.with_name(f"{first.stem}_{number}{first.suffix}")):
        number += 1
    return path


def make_room(folder: Path, limit_bytes: int) -> tuple[Path, ...]:
    """Remove the oldest finished logs of a folder until the rest take at most `limit_bytes`; those removed.

    Files of other programs count for nothing and stay.  Logs that are being written, or that nobody has mended yet,
    stay and count; one that somebody else removes meanwhile counts for nothing any more.
    """
    logs = sorted(_logs(folder))
    total = sum(size for _, _, size in logs)
    removed = []
    for _, path, size in logs:
        if total <= limit_bytes:
            break
        if _remove_finished(path):
            removed.append(path)
        if not path.exists():
            total -= size
    return tuple(removed)


def _logs(folder: Path) -> Iterator[tuple[int, Path, int]]:
    """When each of our logs was written last (ns), and its bytes."""
    for path in folder.glob("*.mcap"):
        with suppress(OSError):  # removed meanwhile
            if _is_ours(path):
                status = path.stat()
                yield status.st_mtime_ns, path, status.st_size


@contextmanager
def only_recorder(folder: Path, cell: str) -> Iterator[Callable[[bytes], None]]:
    """Keep other recorders of this cell out of the folder for the time of the block.  Raises LogFileError, LogInTheWay.

    Gives a function that leaves a note for whoever reads the logs, in the place of the one before.
    """
    with ExitStack() as stack:
        try:
            fd = open_closed(lock_path(folder, cell))
            stack.callback(os.close, fd)
            note = os.open(note_path(folder, cell), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            stack.callback(os.close, note)
        except OSError as error:
            raise LogFileError(
                f"cannot record into {folder}", found=error.strerror,
                expected="an existing directory that can be written",
                remedy=f"create it with `mkdir -p {folder}`, or record elsewhere",
            ) from error  # fmt: skip
        if not lock(fd):
            raise LogInTheWay(
                f"cell {cell} is being recorded into {folder}", found="another recorder of it",
                expected="one recorder per cell", remedy="stop that one first; a cell tells one recorder what it has",
            )  # fmt: skip
        os.ftruncate(note, 0)
        yield partial(_note, note)


def _note(fd: int, note: bytes) -> None:
    """A note that cannot be written is none: a full disk ends the log, not the recorder."""
    with suppress(OSError):
        os.pwrite(fd, note, 0)
        os.ftruncate(fd, len(note))


def _is_ours(path: Path) -> bool:
    """Raises OSError."""
    with open_file(path) as file:
        return library_of(BytesIO(file.read(_HEAD_BYTES))) == LIBRARY


def _remove_finished(path: Path) -> bool:
    try:
        with open_file(path) as file:
            if is_written(file.fileno()) or is_unfinished(path):
                return False
            path.unlink()
    except (OSError, LogError):
        return False
    return True
