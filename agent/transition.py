"""What a change of mode does to the memory: the rule of the loop, and of its replay."""

from __future__ import annotations

from agent import floats, session
from agent.control.memory import Memory
from agent.loop import Agent, Outcome
from agent.modes import FLOATING, Mode
from agent.standing import hold_after, hold_here


def entered(agent: Agent, mode: Mode, memory: Memory, last: Outcome | None) -> Memory:
    """Memory with which an arm enters a mode; last: outcome of the tick before, None without a fresh state."""
    if agent.floating is not None and mode in FLOATING:
        if last is not None and memory.hold is None:  # it followed the motion
            memory = hold_here(agent, last.q, memory)
        return floats.entered(agent.floating, mode, memory, None if last is None else (last.q, last.dq))
    if agent.session is not None:
        return session.entered(agent, mode, memory, last)
    if mode is Mode.HOLD and last is not None:
        return hold_after(agent, last)
    if mode is Mode.TRACK:
        return memory._replace(hold=None, q_hold=None)
    return memory
