"""Where a hold begins behind an agent that is gone: the memory it would have held with, from its last rows.  Pure.

A row holds the memory that its tick began with and what the tick was given, so the ticks are computed again, and with
them what the next one would have begun with in HOLD.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.around import Beginning
from agent.control.memory import Memory
from agent.loop import Agent, initial_memory
from agent.modes import TABLE, Event, Mode, mode_of
from agent.phases import arrived
from agent.replay.chain import Chain
from agent.replay.tick import Rows, is_fresh, state_at
from agent.safety import Flag
from agent.session_modes import next_in_session
from drivers.interface import JointState, Vector

ROWS = 64  # how far back a fresh state is looked for
SAME_NM = 1e-3  # between what a row says was sent and what a servo says it holds


def beginning(agent: Agent, rows: Rows, reason: str, marks: Flag = Flag.NONE, *, session: bool = False) -> Beginning:
    """The hold that follows these rows (k,), the last ones of the agent and without a gap.

    marks: GAP where so much time has passed that the pose is to be found anew, RESUMED where the arm had no torque.
    session: the agent had one; an arm of it that held nothing stands as it is, without any share of the object.  An
    arm that floated stands, and carries what it did.
    """
    rows = _commanded(rows)
    stands = Mode.HOLD if agent.floating is None else Mode.STAND
    if not len(rows):
        return Beginning(Mode.REST if session else stands, initial_memory(agent), 0, 0, reason, marks)
    chain = Chain(agent)
    first = _last_fresh(rows) or 0
    chain.restore(rows[first])
    for i in range(first, len(rows)):
        row = rows[i]
        chain.pass_row(state_at(rows, i, agent.model.n), float(row["t"]), Mode(int(row["mode"])), int(row["flags"]))
    last = rows[-1]
    zero_ns = int(last["stamp_ns"]) - round(float(last["t"]) * 1e9)
    before = Mode(int(last["mode"]))
    mode = stood_in(agent, before, chain.memory) if session else stands
    held = f"{reason}; it held already" if before is Mode.HOLD else reason
    return Beginning(mode, chain.standing(mode, marks), zero_ns, int(last["sequence"]) + 1, held, marks)


def stood_in(agent: Agent, mode: Mode, memory: Memory | None) -> Mode:
    """How an arm of a session that was in this mode stands: REST, HALT of one that holds nothing, else HOLD."""
    events = Event.TROUBLE
    gives_back = mode is Mode.RELEASE and agent.session is not None and memory is not None
    if gives_back and not arrived(agent.session.life, mode, memory):  # type: ignore[union-attr, arg-type]
        events |= Event.GRIPPED
    return next_in_session(mode, events)


def _commanded(rows: Rows) -> Rows:
    """The rows up to the last one whose mode commands."""
    modes = [mode_of(mode) for mode in rows["mode"].tolist()]
    return rows[: sum(mode is not None and TABLE[mode].commands for mode in modes)]


def _last_fresh(rows: Rows) -> int | None:
    flags = rows["flags"].tolist()
    return next((i for i in range(len(rows) - 1, -1, -1) if is_fresh(flags[i])), None)


def last_seen(rows: Rows, n: int) -> JointState | None:
    """Measured state of the n joints in the last fresh row; None without one."""
    place = _last_fresh(rows)
    return None if place is None else state_at(rows, place, n)


def from_torque(begun: Beginning, rows: Rows, tau_held: Vector) -> Beginning:
    """The same, with its first step counted from the torque (n,) that the servos hold; NaN where that is not known.

    It is another one where the agent died between its last write and the row of it.
    """
    memory = begun.memory
    sent = rows["tau_sent"][-1, : len(tau_held)] if len(rows) else np.full(len(tau_held), np.nan)
    known = np.isfinite(tau_held) & ~(np.abs(tau_held - sent) <= SAME_NM)
    if not known.any():
        return begun
    return replace(begun, memory=memory._replace(tau=np.where(known, tau_held, memory.tau)))
