"""How far this host's clock may have drifted from the other hosts' since it was last known, while the arm moves.

Arms of one cell on several hosts share nothing but the time.  An arm whose bound exceeds what a start allows holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from agent.config.cell import Arm, Cell
from agent.host.clock import STATE_FILE, ClockState, bound_text, read_file, read_kernel
from agent.operator.local import CLOCK_MAX_S

DRIFT = 1e-4  # of a clock that nobody corrects: 100 ppm


def shares_time(cell: Cell, arm: Arm) -> bool:
    """Whether an arm of the cell is on another host than this one."""
    return any(other.entry.host != arm.entry.host for other in cell.arms)


def read_here() -> ClockState:
    """What is known of the clock where the agent may look: the file of the host's clock service, else the kernel."""
    told = read_file(STATE_FILE)
    return told if told.synchronised else read_kernel()


class ClockWatch:
    """The bound of the clock's error: as last known, and DRIFT more for every second since."""

    def __init__(
        self, now_ns: Callable[[], int], hold: Callable[[str], None], cycles: int,
        read: Callable[[], ClockState] = read_here,
    ) -> None:  # fmt: skip
        """hold: is given a reason, once the bound is too large for an arm that has a start; cycles: between looks."""
        self._now_ns = now_ns
        self._hold = hold
        self._cycles = cycles
        self._read = read
        self._count = 0
        self._known_s = math.inf
        self._known_ns = 0
        self._started = False

    @property
    def bound_s(self) -> float:
        """Now."""
        return self._known_s + DRIFT * (self._now_ns() - self._known_ns) * 1e-9

    def given(self, bound_s: float | None) -> None:
        """A start has been given; from here on the bound counts, if whoever gave it has looked at the clock."""
        self._started = bound_s is not None
        if bound_s is not None and bound_s < self.bound_s:
            self._known_s, self._known_ns = bound_s, self._now_ns()

    def beat(self) -> None:
        """One cycle has passed."""
        self._count += 1
        if self._count % self._cycles:
            return
        state = self._read()
        if state.synchronised and state.max_error_s < self.bound_s:
            self._known_s, self._known_ns = state.max_error_s, self._now_ns()
        if self._started and not self.bound_s <= CLOCK_MAX_S:
            self._hold(f"the clock may be off by {bound_text(self.bound_s)}, {CLOCK_MAX_S * 1e3:g} ms are allowed")
