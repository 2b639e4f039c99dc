"""Where the processes of one host meet when nobody says otherwise; names only, creates nothing."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

SERVICES_DIR = Path("/run/coop")  # RuntimeDirectory of the shipped units


def runtime_dir(cell: str) -> Path:
    """$RUNTIME_DIRECTORY of the service, else /run/user/UID or /tmp, one folder per cell."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    if service:
        return Path(service.split(":")[0])
    base = os.environ.get("XDG_RUNTIME_DIR") or f"/tmp/coop-{os.getuid()}"
    return Path(base) / "coop" / cell


def ring_path(cell: str, name: str) -> Path:
    """Ring of an arm or of the plant."""
    return runtime_dir(cell) / f"{name}.ring"


def control_path(cell: str, arm: str) -> Path:
    """Control socket of an arm."""
    return runtime_dir(cell) / f"{arm}.control"


def control_paths(cell: str, arm: str) -> tuple[Path, ...]:
    """Where the control socket of an arm may be: of an agent started by hand, or by its unit."""
    return control_path(cell, arm), SERVICES_DIR / arm / f"{arm}.control"


def plant_socket_path(cell: str) -> Path:
    """Socket of the simulated cell."""
    return runtime_dir(cell) / "plant.sock"


def log_path(folder: Path, cell: str) -> Path:
    """Name of a new log."""
    return folder / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{cell}.mcap"
