"""Which arms of a cell are this host's, where their agents listen, and whether its clock is good enough for a start."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from agent.config.cell import Arm, Cell
from agent.host.clock import ClockState
from agent.host.paths import control_paths
from agent.operator.error import ControlError

Places = Mapping[str, Iterable[Path]]  # of each arm: where its agent may listen
CLOCK_WARN_S = 1e-3  # of a start on several hosts: 0.1 mm at 0.1 m/s
CLOCK_MAX_S = 5e-3


def host_name() -> str:
    """Name of this host, without its domain."""
    return socket.gethostname().partition(".")[0]


def local_arms(cell: Cell, host: str | None = None) -> list[Arm]:
    """The arms that the cell file assigns to this host, or to nobody.  Raises ControlError when there is none."""
    own = (host or host_name()).partition(".")[0]
    found = [arm for arm in cell.arms if arm.entry.host is None or arm.entry.host.partition(".")[0] == own]
    if not found:
        named = ", ".join(f"{arm.name} on {arm.entry.host}" for arm in cell.arms)
        raise ControlError(
            f"arms of host {own}", found=named, expected="at least one of this host",
            remedy="give --host, or correct host of the arms in the cell file",
        )  # fmt: skip
    return found


def has_other_hosts(cell: Cell, given: Sequence[Path], host: str | None = None) -> bool:
    """Whether the cell has arms elsewhere, with which this host shares nothing but the time.

    given: sockets of agents, whose arms nobody knows here; then any two hosts in the cell file are enough.
    """
    if given:
        return len({arm.entry.host for arm in cell.arms}) > 1
    return len(local_arms(cell, host)) < len(cell.arms)


def places(cell: Cell, arms: Sequence[str], given: Sequence[Path], host: str | None = None) -> dict[str, list[Path]]:
    """Where each agent may listen, by arm: those named, or all of this host; of sockets that are given, by path.

    Arms that float while others move listen to nobody.
    """
    if given:
        return {str(path): [path] for path in given}
    spec = cell.file.floating
    deaf = spec.arms if spec is not None and spec.others_move else ()
    wanted = [cell.arm(name).name for name in arms]
    wanted = wanted or [arm.name for arm in local_arms(cell, host) if arm.name not in deaf]
    return {name: list(control_paths(cell.file.name, name)) for name in wanted}


def judge_clock(clock: ClockState, *, several_hosts: bool) -> str:
    """What to say of the clock before a start.  Raises ControlError when it must not start."""
    if not several_hosts:
        return f"clock of this host: {clock.text}; without effect where one host has all arms"
    remedy = "see that chrony runs (`chronyc tracking`), and start again"
    if not clock.synchronised or not clock.max_error_s <= CLOCK_MAX_S:
        raise ControlError(
            "clock of this host",
            found=clock.text,
            expected=f"synchronised, error ≤ {CLOCK_MAX_S * 1e3:g} ms",
            remedy=remedy,
        )
    if clock.max_error_s > CLOCK_WARN_S:
        return f"clock of this host: {clock.text}; WARNING: above {CLOCK_WARN_S * 1e3:g} ms arms press on each other"
    return f"clock of this host: {clock.text}"


def named(parts: Mapping[str, str]) -> str:
    """Arms and what is said of each, for one line."""
    return "; ".join(f"{arm}: {text}" for arm, text in parts.items())
