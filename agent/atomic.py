"""Writes a whole file or none, so that no reader and no power cut meets half of one; keeps what is there if asked.

At the end of a link the file there is replaced, and the link stays.  What is no file, as a device, is refused.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, Final

import configs
from drivers.interface import Refusal

_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class WriteError(Refusal):
    """A file cannot be written."""


def keep_existing(*paths: Path, remedy: str = "name another, or give --force") -> None:
    """Raise WriteError when there is something at one of these paths: nobody has asked to replace it."""
    for path in paths:
        if os.path.lexists(path):
            raise WriteError(f"file {path}", found="one of that name", expected="none", remedy=remedy)


def refuse_other(path: Path, content: bytes) -> None:
    """Raise WriteError where a file at `path`, which is not written as one that ships is meant, would be read instead.

    content: of the one that ships; another file with it does no harm.
    """
    if os.path.lexists(path) and not (path.is_file() and path.read_bytes() == content):
        raise WriteError(
            f"file {path}", found="another one than that of this name which ships",
            expected="none, for it would be read in its place", remedy="name another folder",
        )  # fmt: skip


def require_place(*paths: Path, force: bool, refusal: type[Refusal] = WriteError) -> None:
    """Raise `refusal` before the work for files that would replace others unasked (force) or have no folder.

    And, asked or not, for a place where lies what is no file.
    """
    if not force:
        keep_existing(*paths)
    for path in paths:
        place_of(path, refusal)
        if not os.path.isdir(path.parent):  # noqa: PTH112 - no error where the folder above may not be read
            raise refusal(
                f"file {path}", found=f"no folder {path.parent}", expected="a folder to write it into",
                remedy="make it, or name another path",
            )  # fmt: skip


def place_of(path: Path, refusal: type[Refusal] = WriteError) -> Path:
    """Where a file that is written at `path` goes: there, or where a link leads.

    Raises `refusal` where something lies there that is no file.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # none is there, or writing it tells why not
        return Path(os.path.realpath(path))
    except OSError as error:  # as a link to itself
        raise _refused(refusal, path, error) from error
    if not stat.S_ISREG(mode):
        raise refusal(
            f"file {path}", found=_KINDS.get(stat.S_IFMT(mode), "no file"), expected="a file, or nothing",
            remedy="name another path",
        )  # fmt: skip
    return Path(os.path.realpath(path))


def require_writable(path: Path) -> None:
    """Raise WriteError, before the work, where no file can be made at `path`: one is made beside it and removed."""
    place = place_of(path)
    try:
        handle, name = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name}.")
    except OSError as error:
        raise _refused(WriteError, path, error) from error
    os.close(handle)
    Path(name).unlink()


def make_folder(path: Path) -> None:
    """Make the folder, and those above it, where it is not there.  Raises WriteError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(
            f"folder {path}", found=error.strerror, expected="a folder, or a place for one", remedy="name another path"
        ) from error


def write_atomically(path: Path, content: bytes, refusal: type[Refusal] = WriteError, mode: int | None = None) -> None:
    """Replace `path` by a file with this content, on disk before it has the name; of a link, what it leads to.

    mode: of the file; None: that of the one which is replaced, else what the umask leaves of 0o666.
    Raises `refusal`, for what is no file, and for a place in an installed package: what is there belongs to its next
    version.
    """
    _put(path, io.BytesIO(content), refusal, mode)


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write each of these files as `write_atomically` does, in this order; where one fails, none stays that is new.

    Raises WriteError.  One that was there before is there afterwards, as it was or replaced.
    """
    with contextlib.ExitStack() as undone:
        for path, content in contents.items():
            place = place_of(path)
            new = not os.path.lexists(place)
            write_atomically(path, content)
            if new:
                undone.callback(_remove, place)
        undone.pop_all()


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):  # why the write failed is what is told
        path.unlink()


def copy_atomically(source: Path, path: Path, refusal: type[Refusal] = WriteError) -> None:
    """Replace `path` by a copy of `source`, which may lie on another disk, as `write_atomically` does."""
    with source.open("rb") as file:
        _put(path, file, refusal, None)


def _put(path: Path, content: BinaryIO, refusal: type[Refusal], mode: int | None) -> None:
    place = place_of(path, refusal)
    if _installed(place):
        raise refusal(
            f"file {path}", found="a place in the installed package", expected="a folder of yours",
            remedy="name another path; a cell names an arm file of its own with arm_file",
        )  # fmt: skip
    try:
        handle, name = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name}.")
    except OSError as error:
        raise _refused(refusal, path, error) from error
    try:
        with os.fdopen(handle, "wb") as file:
            shutil.copyfileobj(content, file)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(_mode(place) if mode is None else mode)
        Path(name).replace(place)
    except BaseException as error:  # a stop while the disk is waited for, too
        _remove(Path(name))
        if isinstance(error, OSError):
            raise _refused(refusal, path, error) from error
        raise


def _mode(path: Path) -> int:
    try:
        return stat.S_IMODE(path.stat().st_mode)
    except FileNotFoundError:
        return 0o666 & ~umask()


def umask() -> int:
    """What new files of this process go without; while it is asked, a file of another thread is closed to others."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _installed(path: Path) -> bool:
    """Whether it lies among the files that ship, and this is no checkout of the sources."""
    shipped = Path(configs.__file__).resolve().parent
    return shipped in path.resolve().parents and not (shipped.parent / "pyproject.toml").is_file()


def is_full(error: OSError) -> bool:
    """Whether what failed wanted room: on the disk, or of this user there."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def _refused(refusal: type[Refusal], path: Path, error: OSError) -> Refusal:
    full = is_full(error)
    return refusal(
        f"file {path}", found=error.strerror, expected="room for it" if full else "a folder to write it into",
        remedy="make room there, or name another path" if full else "name another path",
    )  # fmt: skip
