"""Usual gains, about those of the cells that ship: where a search begins for a new cell, or where own are unstable."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from agent.config.cell import Cell
from agent.control.errors import Gains
from agent.control.estimator import Observer
from agent.verify.criterion.cases import Loop


@dataclass(frozen=True, slots=True)
class UsualGains:
    """One number for all axes and arms, as a cell file states it."""

    k_p: float
    k_eps: float
    k_p_rate: float
    k_eps_rate: float
    k_v: float
    k_v_turn: float
    velocity_gain: float
    position_gain: float = 0.2
    velocity_from_position_per_s: float = 1.0

    @property
    def law(self) -> Gains:
        """Of an arm."""
        k_p, k_eps, k_p_rate, k_eps_rate, k_v, k_v_turn = (
            (k, k, k) for k in (self.k_p, self.k_eps, self.k_p_rate, self.k_eps_rate, self.k_v, self.k_v_turn)
        )
        return Gains(k_p=k_p, k_eps=k_eps, k_p_rate=k_p_rate, k_eps_rate=k_eps_rate, k_v=(*k_v, *k_v_turn))

    def of_observer(self, observer: Observer | None) -> Observer | None:
        """An observer with these gains, where there is one."""
        if observer is None:
            return None
        return replace(
            observer,
            position_gain=self.position_gain,
            velocity_gain=self.velocity_gain,
            velocity_from_position_per_s=self.velocity_from_position_per_s,
        )


PLANAR: Final = UsualGains(70.0, 140.0, 62.0, 190.0, 3.6, 0.47, 0.22)
SPATIAL: Final = UsualGains(60.0, 130.0, 50.0, 150.0, 4.2, 0.23, 0.24)


def usual_loop(cell: Cell, own: Loop) -> Loop:
    """The loop with gains of the cells that ship."""
    usual = PLANAR if cell.planar else SPATIAL
    return replace(own, gains=tuple(usual.law for _ in own.gains), observer=usual.of_observer(own.observer))
