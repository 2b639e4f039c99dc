"""What `coop tune` says when it finds nothing: which tolerances bind, and how much of each may stay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from agent.config.cell import Cell, ConfigError, cell_from_toml
from agent.config.rewrite import rewritten
from agent.verify.binding import Binding, Stated
from agent.verify.criterion.cases import Ranges
from agent.verify.criterion.examine import DELAY_MAX_PERIODS
from agent.verify.scale import rounded_down
from agent.verify.stiffest import Stiffest


class NoGains(ConfigError):
    """No gains keep the wanted margin."""


def looked_at(ranges: Ranges) -> Ranges:
    """These without delays that are so long that a search with them would not end."""
    first, believed, longest = ranges.delay_periods
    return replace(ranges, delay_periods=(first, believed, min(longest, max(believed, DELAY_MAX_PERIODS))))


def too_late(cell: Cell, stated: Ranges, enough: Ranges, remedy: str) -> NoGains:
    """What to say where gains are found with no longer delays than are looked at, and longer ones are stated."""
    return NoGains(
        f"gains for {cell.file.name} at {cell.file.rate_hz:g} Hz",
        found=f"a delay of up to {stated.delay_periods[-1]:.3g} cycles, for which none are looked for",
        expected=f"at most {enough.delay_periods[-1]:.3g} cycles",
        remedy=remedy,
    )


def none_found(cell: Cell, nearest: Stiffest, most: float, remedy: str) -> NoGains:
    """What to say where no gains are found.  most: the largest radius that is wanted."""
    worst = nearest.worst
    return NoGains(
        f"gains for {cell.file.name} at {cell.file.rate_hz:g} Hz",
        found=f"none; the nearest have a radius of {worst.radius:.4f} ({worst.case.demand.value}) "
        f"and {nearest.noise:.2f} times the torque noise",
        expected=f"at most {most:g} whatever of the stated tolerance is true, and no more noise",
        remedy=remedy,
    )


def less(cell: Cell, found: Binding) -> str:
    """Which tolerances bind, and with how much of them gains are found."""
    if found.enough:
        told = " or ".join(_listed(cell, stated) for stated in found.enough)
        return f"state less of what binds, if that is true: {told} is enough; or raise rate_hz"
    if found.nearest is None:
        return "state less in [tolerance], if that is true, or raise rate_hz"
    stated, radius = found.nearest
    near = f"the nearest: {_listed(cell, stated)} with a radius of {radius:.4f}"
    nor = f", nor are {_listed(cell, found.pair)}" if found.pair else ""
    return (
        f"less of one tolerance by itself is not found to be enough ({near}){nor}: "
        "raise rate_hz, or state less of several, if that is true"
    )


def stating(cell: Cell, stated: Stated) -> Cell:
    """The cell that says so.  Raises ConfigError where it may not."""
    text = rewritten(cell.toml.decode(), [f"{key}={value}" for key, value in _values(cell, stated)])
    return cell_from_toml(text.encode(), f"{cell.file.name} with less of its tolerance")


def _listed(cell: Cell, stated: Stated) -> str:
    return " with ".join(f"{key} = {value}" for key, value in _values(cell, stated))


def _values(cell: Cell, stated: Stated) -> Iterator[tuple[str, str]]:
    return ((key, _value(cell, key, ranges)) for key, ranges in stated.items())


def _value(cell: Cell, key: str, ranges: Ranges) -> str:
    """What the cell file would say of it."""
    believed = cell.file.delay_periods
    shortest, _, longest = ranges.delay_periods
    said = {
        "delay": (shortest / believed, rounded_down(longest / believed)) if believed else (1.0, 1.0),
        "object": ranges.object_error,
        "friction": (ranges.friction, cell.tolerance.friction[1]),
        "pads_N_per_m": ranges.pads_N_per_m,
        "pads_Nm_per_rad": ranges.pads_Nm_per_rad,
        "pads_damping_ratio": ranges.pads_damping_ratio,
    }.get(key.partition(".")[2], ranges.inertia_error)
    return f"[{', '.join(f'{x:.3g}' for x in said)}]" if isinstance(said, tuple) else f"{said:.3g}"
