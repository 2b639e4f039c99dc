"""Where the processes of one host meet when nobody says otherwise, and the folder they meet in."""

from __future__ import annotations

import os
import stat
from datetime import UTC, datetime
from pathlib import Path

from drivers.interface import Refusal

SERVICES_DIR = Path("/run/coop")  # RuntimeDirectory of the shipped units


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
    found = None
    if not stat.S_ISDIR(status.st_mode):
        found, expected = "a link or file", "a folder of your own"
    elif status.st_uid != os.geteuid():
        found, expected = f"one of uid {status.st_uid}", f"one of uid {os.geteuid()}"
    if found is not None:
        raise PlaceError(
            f"folder {folder}", found=found, expected=expected,
            remedy="have it removed, set XDG_RUNTIME_DIR, or give every path (--ring and others)",
        )  # fmt: skip


def _own_dirs(cell: str) -> tuple[Path, ...]:
    """Folders of this user down to that of the cell, outermost first."""
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session and Path(session).is_dir():
        return Path(session, "coop"), Path(session, "coop", cell)
    alone = Path(f"/tmp/coop-{os.getuid()}")
    return alone, alone / "coop", alone / "coop" / cell


def ring_path(cell: str, name: str) -> Path:
    """Ring of an arm or of the plant."""
    return runtime_dir(cell) / f"{name}.ring"


def ring_paths(cell: str, name: str) -> tuple[Path, ...]:
    """Where the ring of an arm may be: of an agent started by hand, or by its unit."""
    return ring_path(cell, name), SERVICES_DIR / name / f"{name}.ring"


def control_path(cell: str, arm: str) -> Path:
    """Control socket of an arm."""
    return runtime_dir(cell) / f"{arm}.control"


def control_paths(cell: str, arm: str) -> tuple[Path, ...]:
    """Where the control socket of an arm may be: of an agent started by hand, or by its unit."""
    return control_path(cell, arm), SERVICES_DIR / arm / f"{arm}.control"


def guard_path(cell: str, arm: str) -> Path:
    """Socket of an arm's guard."""
    return runtime_dir(cell) / f"{arm}.guard"


def plant_socket_path(cell: str) -> Path:
    """Socket of the simulated cell."""
    return runtime_dir(cell) / "plant.sock"


def log_path(folder: Path, cell: str) -> Path:
    """Name of a new log."""
    return folder / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{cell}.mcap"
