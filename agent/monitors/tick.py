"""What a monitor is shown of one tick, and how it says what it found."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:  # bounds and windows are read without the loop
    from agent.loop import Outcome
    from agent.modes import Mode
    from drivers.interface import JointState


class Tick(NamedTuple):
    """One tick with a fresh state; lists have one entry per joint."""

    mode: Mode
    state: JointState
    outcome: Outcome
    q: list[float]  # measured
    dq: list[float]  # as the law used them
    tau: list[float]  # after the limits


class Monitor(Protocol):
    """One thing that is watched on every tick."""

    def check(self, at: Tick) -> str:
        """What is wrong, with what was found, what is allowed and what to do; empty while nothing is."""
        ...


def digits(least: int, found: float, *bounds: float) -> int:
    """How many decimals tell what is found from its bounds: at least so many, and nine where nothing does."""
    return next((n for n in range(least, 9) if f"{found:.{n}f}" not in [f"{x:.{n}f}" for x in bounds]), 9)


def sentence(what: str, found: str, expected: str, remedy: str) -> str:
    """For log and operator, as every refusal of this stack is worded."""
    return f"{what}: found {found}, expected {expected}; {remedy}"
