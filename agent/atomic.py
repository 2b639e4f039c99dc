"""Writes a file whole or not at all, also when power fails; its folder must exist."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from drivers.interface import Refusal


class WriteError(Refusal):
    """A file cannot be written."""


def write_atomically(path: Path, content: bytes) -> None:
    """Replace `path` by a file with this content, on disk before it has the name.  Raises WriteError."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise _refusal(path, error) from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise _refusal(path, error) from error


def _refusal(path: Path, error: OSError) -> WriteError:
    return WriteError(
        f"file {path}", found=error.strerror, expected="a folder to write it into", remedy="name another path"
    )
