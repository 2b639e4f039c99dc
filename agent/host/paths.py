"""Where the processes of one host meet: the folder when nobody says otherwise, and the names in any such folder."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path

from drivers.interface import Refusal

SERVICES_DIR = Path("/run/coop")  # RuntimeDirectory of the shipped units
SHARED_DIR = Path("/tmp")  # where there is no session folder: anybody can be first here


class PlaceError(Refusal):
    """The folder in which the processes of a cell meet cannot be used."""


def runtime_dir(cell: str) -> Path:
    """Folder of the cell: $RUNTIME_DIRECTORY of a service, else in $XDG_RUNTIME_DIR or, where that is none, in /tmp."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    return Path(service.split(":")[0]) if service else _own_dirs(cell)[-1]


def make_runtime_dir(cell: str) -> Path:
    """`runtime_dir`, made for this user alone where it is missing; a service manager has made its own.

    Raises PlaceError when it cannot be made, or is another user's.
    """
    if os.environ.get("RUNTIME_DIRECTORY"):
        return runtime_dir(cell)
    for folder in _own_dirs(cell):
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            _refuse_foreign(folder, folder.lstat())
        except OSError as error:
            raise PlaceError(
                f"folder {folder}", found=error.strerror, expected="a folder of your own",
                remedy="set XDG_RUNTIME_DIR to a folder that you can write, or give every path (--ring and others)",
            ) from error  # fmt: skip
    return runtime_dir(cell)


def _refuse_foreign(folder: Path, status: os.stat_result) -> None:
    """Raise PlaceError unless it is a folder of this user: in /tmp anybody can be there first."""
    found = _foreign(status, {os.geteuid()})
    if found:
        own = stat.S_ISDIR(status.st_mode)
        raise PlaceError(
            f"folder {folder}", found=found, expected=f"one of uid {os.geteuid()}" if own else "a folder of your own",
            remedy="have it removed, set XDG_RUNTIME_DIR, or give every path (--ring and others)",
        )  # fmt: skip


def _foreign(status: os.stat_result, uids: Collection[int]) -> str:
    """What it is when it is no folder of one of these users; empty when it is."""
    if not stat.S_ISDIR(status.st_mode):
        return "a link or file"
    return "" if status.st_uid in uids else f"one of uid {status.st_uid}"


def foreign_folder(cell: str) -> str:
    """Of this user's folders down to that of the cell, the one that is somebody else's, in words; empty without one."""
    with contextlib.suppress(OSError):  # missing: nobody's
        return _foreign_of(cell)
    return ""


def barred(path: Path) -> str:
    """Why nobody is asked and nothing is read at a place in this user's folder of a cell; empty of every other place.

    No agent of this user's is in a folder of somebody else's.  One that is missing is not looked into again, so that
    nobody can lay one there meanwhile; one of this user's stays that, for /tmp lets nobody take it away.
    """
    try:
        return held_by_others(path)
    except OSError as error:
        return error.strerror or str(error)


def held_by_others(path: Path) -> str:
    """The same of a place whose folders are there.  Raises OSError where one of them is missing."""
    cell = path.parent.name
    return _foreign_of(cell) if path.parent == _own_dirs(cell)[-1] else ""


def _foreign_of(cell: str) -> str:
    """Raises OSError where a folder is missing.  A session's may be its owner's: root keeps that of who became root."""
    own, uids = _own_dirs(cell), {os.geteuid()}
    if own[0].parent != SHARED_DIR:
        uids.add(own[0].parent.stat().st_uid)
    for folder in own:
        found = _foreign(folder.lstat(), uids)
        if found:
            return f"folder {folder} is {found}, not of uid {os.geteuid()}"
    return ""


def _own_dirs(cell: str) -> tuple[Path, ...]:
    """Folders of this user down to that of the cell, outermost first."""
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session and Path(session).is_dir():
        return Path(session, "coop"), Path(session, "coop", cell)
    alone = SHARED_DIR / f"coop-{os.getuid()}"
    return alone, alone / "coop", alone / "coop" / cell


def ring_in(folder: Path, name: str) -> Path:
    """Ring of an arm or of the plant."""
    return folder / f"{name}.ring"


def control_in(folder: Path, arm: str) -> Path:
    """Control socket of an arm."""
    return folder / f"{arm}.control"


def guard_in(folder: Path, arm: str) -> Path:
    """Socket of an arm's guard."""
    return folder / f"{arm}.guard"


def plant_socket_in(folder: Path) -> Path:
    """Socket of the simulated cell."""
    return folder / "plant.sock"


def emulated_port_in(folder: Path, arm: str) -> Path:
    """Port of an arm whose servos are emulated."""
    return folder / arm


def ring_path(cell: str, name: str) -> Path:
    """`ring_in` the cell's folder."""
    return ring_in(runtime_dir(cell), name)


def ring_paths(cell: str, name: str) -> tuple[Path, ...]:
    """Where the ring of an arm may be: of an agent started by hand, or by its unit."""
    return ring_path(cell, name), ring_in(SERVICES_DIR / name, name)


def control_path(cell: str, arm: str) -> Path:
    """`control_in` the cell's folder."""
    return control_in(runtime_dir(cell), arm)


def control_paths(cell: str, arm: str) -> tuple[Path, ...]:
    """Where the control socket of an arm may be: of an agent started by hand, or by its unit."""
    return control_path(cell, arm), control_in(SERVICES_DIR / arm, arm)


def guard_path(cell: str, arm: str) -> Path:
    """`guard_in` the cell's folder."""
    return guard_in(runtime_dir(cell), arm)


def plant_socket_path(cell: str) -> Path:
    """`plant_socket_in` the cell's folder."""
    return plant_socket_in(runtime_dir(cell))


def log_path(folder: Path, cell: str) -> Path:
    """Name of a new log."""
    return folder / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{cell}.mcap"
