"""A disk that is full when a file of this name comes to it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest


def full_for(patch: pytest.MonkeyPatch, name: str) -> None:
    """From now on a file of this name, or the draft of one, does not get onto the disk: ENOSPC at fsync."""
    synced = os.fsync

    def fsync(handle: int) -> None:
        if name in Path(f"/proc/self/fd/{handle}").readlink().name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synced(handle)

    patch.setattr("os.fsync", fsync)
