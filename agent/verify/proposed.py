"""What a proposal of gains writes into a cell file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from agent.config import observer
from agent.config.cell import Arm, Cell
from agent.config.edit import Change
from agent.control.errors import Gains
from agent.control.estimator import Observer

OBSERVER_KEYS: Final = ("position_gain", "velocity_gain", "velocity_from_position_per_s")


def changed(cell: Cell, each: Sequence[Gains], seen: Observer | None) -> Iterator[Change]:
    """Every gain of the cell file that is another in these; each: of every arm, which differ in k_v alone."""
    c, gains = cell.file.controller, each[0]
    written = {
        "k_p_per_s": (c.k_p_per_s, gains.k_p),
        "k_eps_rad_per_s": (c.k_eps_rad_per_s, gains.k_eps),
        "k_p_rate_per_s": (c.k_p_rate_per_s or gains.k_p, gains.k_p_rate),
        "k_eps_rate_rad_per_s": (c.k_eps_rate_rad_per_s or gains.k_eps, gains.k_eps_rate),
    }
    for key, (was, now) in written.items():
        if was != now:
            yield Change("controller", key, _toml(now))
    was_seen = observer.build(cell.file)
    if was_seen is not None and seen is not None:
        for key in OBSERVER_KEYS:
            if getattr(was_seen, key) != getattr(seen, key):
                yield Change("controller.observer", key, repr(getattr(seen, key)))
    for arm, own in zip(cell.arms, each, strict=True):
        yield from _k_v_changes(arm, own)


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
