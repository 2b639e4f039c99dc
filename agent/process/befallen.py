"""What of `[[simulation.fault]]` which processes do; what nobody would do is refused, so that none of it is ignored."""

from __future__ import annotations

from collections.abc import Collection

from agent.config.cell import Cell, ConfigError
from agent.config.schema.fault import Fault, FaultKind


def stop_in(cell: Cell, arm: str) -> int | None:
    """The cycle of the trajectory in which a run has this arm stopped; None: it has not."""
    held = [one for one in cell.file.simulation.fault if one.arm == arm and one.kind is FaultKind.HOLD]
    return min((one.cycle(cell.period_ns) for one in held), default=None)


def require_done(cell: Cell, *, stops: bool, alone: Collection[str] = (), whole: bool = False) -> None:
    """Refuse a simulated cell in which a fault would not happen.  Raises ConfigError.

    stops: whoever starts this has arms stopped; alone: arms whose joints the cell's plant does not move; whole: arms go
    from rest to rest.
    """
    for fault in cell.file.simulation.fault:
        if whole:
            raise _refused(fault, "a run from rest to rest", "a run of the motion alone", "leave out --whole")
        if fault.arm in alone:
            raise _refused(
                fault, "an arm on its own or in the loop, which the simulated cell does not move",
                "one that the cell's plant moves", "name another arm",
            )  # fmt: skip
        if fault.kind is FaultKind.HOLD and not stops:
            raise _refused(
                fault, "a plant by hand, which stops nobody", "`coop run CELL`, which has the arm stopped",
                "say `coop stop` yourself, and start it",
            )  # fmt: skip


def require_none(cell: Cell, command: str) -> None:
    """Refuse a cell with faults of its own to a command that makes them.  Raises ConfigError."""
    for fault in cell.file.simulation.fault:
        raise _refused(fault, f"a fault of the cell's own in {command}", "those of the command alone", "use `coop run`")


def _refused(fault: Fault, found: str, expected: str, remedy: str) -> ConfigError:
    return ConfigError(
        f"simulation.fault: {fault.told}", found=found, expected=expected,
        remedy=f"{remedy}, or leave the fault out (--set simulation.fault=[])",
    )  # fmt: skip
