"""What a proposal of gains writes into a cell file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from agent.config import observer
from agent.config.cell import Arm, Cell
from agent.config.edit import Change
from agent.control.errors import Gains
from agent.verify.scale import Scale

OBSERVER_KEYS: Final = ("position_gain", "velocity_gain", "velocity_from_position_per_s")


def changed(cell: Cell, scale: Scale) -> Iterator[Change]:
    """Every gain of the cell file that another scale makes another."""
    c, gains = cell.file.controller, scale.of(cell.offline(cell.arms[0]).gains)
    written = {
        "k_p_per_s": (c.k_p_per_s, gains.k_p),
        "k_eps_rad_per_s": (c.k_eps_rad_per_s, gains.k_eps),
        "k_p_rate_per_s": (c.k_p_rate_per_s or gains.k_p, gains.k_p_rate),
        "k_eps_rate_rad_per_s": (c.k_eps_rate_rad_per_s or gains.k_eps, gains.k_eps_rate),
    }
    for key, (was, now) in written.items():
        if was != now:
            yield Change("controller", key, _toml(now))
    was_seen, seen = observer.build(cell.file), scale.of_observer(observer.build(cell.file))
    if was_seen is not None and seen is not None:
        for key in OBSERVER_KEYS:
            if getattr(was_seen, key) != getattr(seen, key):
                yield Change("controller.observer", key, repr(getattr(seen, key)))
    for arm in cell.arms:
        yield from _k_v_changes(arm, scale.of(cell.offline(arm).gains))


def _k_v_changes(arm: Arm, gains: Gains) -> Iterator[Change]:
    entry, linear, angular = arm.entry, gains.k_v[:3], gains.k_v[3:]
    if entry.k_v_N_s_per_m != linear:
        yield Change("arms", "k_v_N_s_per_m", _toml(linear), arm.name)
    if entry.k_v_Nm_s_per_rad != angular:
        yield Change("arms", "k_v_Nm_s_per_rad", _toml(angular), arm.name)


def _toml(values: Sequence[float]) -> str:
    """One number when all are equal."""
    first = values[0]
    return repr(first) if all(x == first for x in values) else "[" + ", ".join(map(repr, values)) + "]"
