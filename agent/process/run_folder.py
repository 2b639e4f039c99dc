"""What the processes of one run share lies in memory, in a folder of its own that goes with the run.

A run that is killed takes nothing away; the next one of that user does, once none of its arms goes on: one that holds
is released by what lies there.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from agent.host.flock import lock
from agent.host.paths import ring_in
from agent.telemetry.ring.file import is_locked
from agent.telemetry.ring.texts import TEXT_FORMAT, TEXT_SLOTS
from agent.telemetry.ring.writer import file_bytes
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

MEMORY: Final = Path("/dev/shm")
PREFIX: Final = "coop-run-"
LOCK: Final = ".running"  # locked as long as the run lives, whatever ends it


def rings_bytes(arms: int) -> int:
    """What the rings of a run of so many arms take, their texts and the plant's rows."""
    each = file_bytes(AGENT_STATE) + file_bytes(TEXT_FORMAT, TEXT_SLOTS)
    return arms * each + file_bytes(PLANT_STATE)


@contextmanager
def run_folder(elsewhere_above: int | None = None, tell: Callable[[str], None] = lambda _: None) -> Iterator[Path]:
    """A new folder for the time of the block; those of runs that are dead are removed first.  Raises OSError.

    elsewhere_above: bytes that are to go in; where memory has less free, as in a container, the folder is among the
    temporary files, and `tell` is told.  None: for arms whose pace must not wait for a disk.
    """
    temporary = Path(tempfile.gettempdir())
    for root in (MEMORY, temporary):
        _remove_all_dead(root, PREFIX)
    root = MEMORY if MEMORY.is_dir() else temporary
    if elsewhere_above is not None and root is MEMORY and (free := shutil.disk_usage(root).free) < elsewhere_above:
        wanted_MB, root = (elsewhere_above >> 20) + 1, temporary
        tell(f"{MEMORY} has {free >> 20} MB free, this run wants {wanted_MB}: it uses {temporary} instead")
    with _held(root, PREFIX) as folder:
        yield folder


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A new one among the temporary files for the time of the block, or for good once it is `kept`.  Raises OSError.

    Those of the prefix whose processes are dead are removed first.
    """
    temporary = Path(tempfile.gettempdir())
    _remove_all_dead(temporary, prefix)
    with _held(temporary, prefix) as folder:
        yield folder


def keep(folder: Path) -> None:
    """Leave a folder that a block has, for a person to look into."""
    (folder / LOCK).unlink()


@contextmanager
def _held(root: Path, prefix: str) -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=root))
    held = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        lock(held)
        (folder / "lock").rename(folder / LOCK)  # only now does another run ask for it
        yield folder
    finally:
        if (folder / LOCK).exists():
            shutil.rmtree(folder, ignore_errors=True)
        os.close(held)


def _remove_all_dead(root: Path, prefix: str) -> None:
    for left in root.glob(f"{prefix}*"):
        with suppress(OSError):  # another process took it away, or it is none of ours
            _remove_dead(left)


def _remove_dead(folder: Path) -> None:
    """Remove the folder of a run of this user whose processes are gone.  Raises OSError."""
    if folder.lstat().st_uid != os.geteuid():
        return
    held = os.open(folder / LOCK, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        if lock(held) and not any(map(_is_written, folder.glob(ring_in(folder, "*").name))):
            shutil.rmtree(folder)  # which follows no link
    finally:
        os.close(held)


def _is_written(ring: Path) -> bool:
    fd = os.open(ring, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)
