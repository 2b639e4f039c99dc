"""A lockstep run that waits at instants of its trajectory until its parent has done something: the world stands still.

The plant tells its parent that it waits, and goes on at SIGUSR1.  Its parent's end, or a stop, lets it go on, too.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from drivers.interface import Refusal

WAITS: Final = "waits"  # what the parent is told
_LOOK_EVERY_S: Final = 0.001


class PauseError(Refusal):
    """Instants at which no run can wait."""


class Asked(Protocol):
    """What signals ask for; `agent.host.signals.StopFlag` is one."""

    released: bool

    def __call__(self) -> bool:
        """Whether a stop was asked for."""
        ...


class Pauses:
    """The instants that are still to come."""

    def __init__(self, at_s: Sequence[float], told: Callable[[str], None], asked: Asked) -> None:
        """at_s: on the trajectory's clock, rising; told: `WAITS` at each of them, before it is waited for."""
        self._due_ns = deque(round(at * 1e9) for at in at_s)
        self._told, self._asked = told, asked

    def reached(self, t_ns: int) -> None:
        """So much of the trajectory has passed: for each instant that is due, tell and wait for SIGUSR1 or a stop."""
        while self._due_ns and t_ns >= self._due_ns[0]:
            self._due_ns.popleft()
            self._asked.released = False
            self._told(WAITS)
            while not (self._asked.released or self._asked()):
                time.sleep(_LOOK_EVERY_S)


def instants_of(text: str, *, lockstep: bool) -> tuple[float, ...]:
    """The instants of `--pauses`.  Raises PauseError for what are none, and where time does not wait."""
    try:
        at_s = tuple(float(word) for word in text.split(","))
    except ValueError:
        at_s = (math.nan,)
    if not lockstep or not all(map(math.isfinite, at_s)) or list(at_s) != sorted(at_s):
        raise PauseError(
            "--pauses", found=f"{text!r}{'' if lockstep else ' at the pace of the wall clock'}",
            expected="seconds of a trajectory in lockstep, rising", remedy="write 1.0,2.5, or leave it out",
        )  # fmt: skip
    return at_s
