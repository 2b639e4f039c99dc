"""What `coop tune` says when it finds nothing: which tolerances bind, and how much of each may stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agent.config.cell import Cell, ConfigError
from agent.verify.criterion.cases import Ranges
from agent.verify.criterion.examine import DELAY_MAX_PERIODS
from agent.verify.stiffest import Binding


class NoGains(ConfigError):
    """No gains keep the wanted margin."""


def looked_at(ranges: Ranges) -> Ranges:
    """These without delays that are so long that a search with them would not end."""
    first, believed, longest = ranges.delay_periods
    return replace(ranges, delay_periods=(first, believed, min(longest, max(believed, DELAY_MAX_PERIODS))))


def too_late(cell: Cell, stated: Ranges, enough: Ranges) -> NoGains:
    """What to say where gains are found with no longer delays than are looked at, and longer ones are stated."""
    return NoGains(
        f"gains for {cell.file.name} at {cell.file.rate_hz:g} Hz",
        found=f"a delay of up to {stated.delay_periods[-1]:.3g} cycles, for which none are looked for",
        expected=f"at most {enough.delay_periods[-1]:.3g} cycles",
        remedy=less(cell, [Binding("tolerance.delay", enough)], 0.0),
    )


def less(cell: Cell, binds: Sequence[Binding], least: float) -> str:
    """Which tolerances bind, and with how much of each by itself gains are found."""
    if binds[0].enough is None:
        keys = " or ".join(bind.key for bind in binds)
        return f"{keys} binds (it would be {least:.4f} without): state less of it if that is true, or raise rate_hz"
    told = " or ".join(f"{b.key} = {_stated(cell, b.key, b.enough)}" for b in binds if b.enough is not None)
    return f"state less of what binds, if that is true: {told} is enough; or raise rate_hz"


def _stated(cell: Cell, key: str, ranges: Ranges) -> str:
    """What the cell file would say of it."""
    believed = cell.file.delay_periods
    shortest, _, longest = ranges.delay_periods
    said = {
        "delay": (shortest / believed, longest / believed) if believed else (1.0, 1.0),
        "object": ranges.object_error,
        "friction": (ranges.friction, cell.tolerance.friction[1]),
        "pads_N_per_m": ranges.pads_N_per_m,
        "pads_Nm_per_rad": ranges.pads_Nm_per_rad,
        "pads_damping_ratio": ranges.pads_damping_ratio,
    }.get(key.partition(".")[2], ranges.inertia_error)
    return f"[{', '.join(f'{x:.3g}' for x in said)}]" if isinstance(said, tuple) else f"{said:.3g}"
