"""An operator's words to the agents of this host: start, stop, release."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from agent.config.cell import Cell, load_cell
from agent.host.paths import SERVICES_DIR, control_paths
from agent.operator.socket import ControlError, Verb, ask

SOONEST_S = 0.05


def start_arms(cell: Path, at: str | None, in_s: float | None, sockets: Sequence[Path]) -> str:
    """Give all agents of this host one start instant; one line about it.  Raises ControlError."""
    loaded = load_cell(cell)
    instant = _instant(at, in_s)
    start_utc_ns = int(instant.timestamp() * 1e9)
    if start_utc_ns - time.time_ns() < SOONEST_S * 1e9:
        raise ControlError(
            "start", found=f"{instant:%H:%M:%S.%f} UTC", expected=f"at least {SOONEST_S:g} s from now",
            remedy="choose a later instant",
        )  # fmt: skip
    paths = _sockets(loaded, [], sockets)
    for path in paths:
        ask(path, Verb.START, start_utc_ns=start_utc_ns, fingerprint=loaded.fingerprint)
    return f"{len(paths)} arms start at {instant:%H:%M:%S.%f} UTC"


def stop_arms(cell: Path, arms: Sequence[str], sockets: Sequence[Path]) -> str:
    """Let the agents hold the object.  Raises ControlError."""
    return f"{_ask_all(cell, arms, sockets, Verb.STOP)} arms hold the object"


def release_arms(cell: Path, arms: Sequence[str], sockets: Sequence[Path]) -> str:
    """Let the agents that hold the object switch torque off.  Raises ControlError."""
    return f"{_ask_all(cell, arms, sockets, Verb.RELEASE)} arms released"


def _ask_all(cell: Path, arms: Sequence[str], sockets: Sequence[Path], verb: Verb) -> int:
    paths = _sockets(load_cell(cell), arms, sockets)
    for path in paths:
        ask(path, verb)
    return len(paths)


def _sockets(cell: Cell, arms: Sequence[str], given: Sequence[Path]) -> list[Path]:
    """The sockets asked for, or those of the cell's arms that run on this host."""
    if given:
        return list(given)
    wanted = [cell.arm(name).name for name in arms] or [a.name for a in cell.arms]
    paths = [path for name in wanted for path in control_paths(cell.file.name, name)]
    here = [path for path in paths if path.exists()]
    if not here:
        raise ControlError(
            f"agents of cell {cell.file.name}", found=f"no socket in {paths[0].parent} or {SERVICES_DIR}",
            expected="at least one running agent", remedy="start the agents first, or give --control",
        )  # fmt: skip
    return here


def _instant(at: str | None, in_s: float | None) -> datetime:
    now = datetime.now(UTC)
    if (at is None) == (in_s is None):
        raise ControlError("start", found="no instant, or two", expected="--at or --in", remedy="e.g. --in 5")
    if in_s is not None:
        return now + timedelta(seconds=in_s)
    try:
        clock = datetime.strptime(at or "", "%H:%M:%S").time()  # noqa: DTZ007 - the date is today's, in UTC
    except ValueError as error:
        raise ControlError("start", found=repr(at), expected="HH:MM:SS (UTC)", remedy="e.g. --at 14:30:00") from error
    return datetime.combine(now.date(), clock, UTC)
