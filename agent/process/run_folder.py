"""What the processes of one run share lies in memory, in a folder of its own that goes with the run.

A run that is killed takes nothing away; the next one of that user does, once none of its arms goes on: one that holds
is released by what lies there.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from agent.log.file import lock
from agent.telemetry.ring.file import is_locked

MEMORY: Final = Path("/dev/shm")
PREFIX: Final = "coop-run-"
LOCK: Final = ".running"  # locked as long as the run lives, whatever ends it


@contextmanager
def run_folder() -> Iterator[Path]:
    """A new folder for the time of the block; those of runs that are dead are removed first.  Raises OSError."""
    root = MEMORY if MEMORY.is_dir() else Path(tempfile.gettempdir())
    for left in root.glob(f"{PREFIX}*"):
        with suppress(OSError):  # another run took it away, or it is none of ours
            _remove_dead(left)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=root))
    held = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        lock(held)
        (folder / "lock").rename(folder / LOCK)  # only now does another run ask for it
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(held)


def _remove_dead(folder: Path) -> None:
    """Remove the folder of a run of this user whose processes are gone.  Raises OSError."""
    if folder.lstat().st_uid != os.geteuid():
        return
    held = os.open(folder / LOCK, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        if lock(held) and not any(map(_is_written, folder.glob("*.ring"))):
            shutil.rmtree(folder)  # which follows no link
    finally:
        os.close(held)


def _is_written(ring: Path) -> bool:
    fd = os.open(ring, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)
