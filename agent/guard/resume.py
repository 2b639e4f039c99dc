"""Where a hold begins behind an agent that is gone: the memory it would have held with, from its last rows.  Pure.

A row holds the memory that its tick began with and what the tick was given, so the tick is computed again, and with it
what the next one would have begun with in HOLD.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.loop import Agent, initial_memory
from agent.modes import Mode
from agent.replay.chain import Chain
from agent.replay.tick import Rows, is_fresh, mode_of, state_at
from agent.runner import Beginning
from agent.safety import Flag
from drivers.interface import Vector

ROWS = 64  # how far back a fresh state is looked for
COMMANDING = (Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER)
SAME_NM = 1e-3  # between what a row says was sent and what a servo says it holds
GAP_PERIODS = 2  # a longer one is more than the observer bridges: it begins anew


def beginning(agent: Agent, rows: Rows, reason: str) -> Beginning:
    """The hold that follows these rows (k,), the last ones of the agent.

    It follows the last row with a fresh state; rows behind it without one have sent no other torque than a hold's.
    """
    held = reason if not len(rows) or mode_of(int(rows[-1]["mode"])) is not Mode.HOLD else f"{reason}; it held already"
    place = _last_fresh(rows)
    if place is None:
        return Beginning(Mode.HOLD, initial_memory(agent), 0, int(rows[-1]["sequence"]) + 1 if len(rows) else 0, held)
    row = rows[place]
    chain = Chain(agent)
    chain.restore(row)
    t, mode = float(row["t"]), Mode(int(row["mode"]))
    chain.pass_row(state_at(rows, place, agent.model.n), t, mode, fresh=True)
    zero_ns = int(row["stamp_ns"]) - round(t * 1e9)
    return Beginning(Mode.HOLD, chain.holding(), zero_ns, int(rows[-1]["sequence"]) + 1, held)


def _last_fresh(rows: Rows) -> int | None:
    for place in range(len(rows) - 1, -1, -1):
        row = rows[place]
        flags = int(row["flags"])
        if is_fresh(flags) and not flags & Flag.NOT_FINITE and mode_of(int(row["mode"])) in COMMANDING:
            return place
    return None


def last_speed(rows: Rows, n: int) -> Vector:
    """Measured joint speeds of the last fresh row, (n,) rad/s; zero without one."""
    place = _last_fresh(rows)
    return np.zeros(n) if place is None else rows["dq_measured"][place, :n].copy()


def from_torque(begun: Beginning, rows: Rows, tau_held: Vector) -> Beginning:
    """The same, with its first step counted from the torque (n,) that the servos hold; NaN where that is not known.

    It is another one where the agent died between its last write and the row of it, and where it wrote without a row.
    """
    memory, place = begun.memory, _last_fresh(rows)
    sent = np.full(len(tau_held), np.nan) if place is None else rows["tau_sent"][place, : len(tau_held)]
    known = np.isfinite(tau_held) & ~(np.abs(tau_held - sent) <= SAME_NM)
    return replace(begun, memory=memory._replace(tau=np.where(known, tau_held, memory.tau)))


def after_gap(begun: Beginning, rows: Rows, now_ns: int, period_ns: int) -> Beginning:
    """The same at now_ns: an observer predicts one period, and is wrong after many."""
    primed = begun.memory.primed and len(rows) > 0 and now_ns - int(rows[-1]["stamp_ns"]) <= GAP_PERIODS * period_ns
    return replace(begun, memory=begun.memory._replace(primed=primed))
