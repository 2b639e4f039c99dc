"""What an agent carries from one row to the next, by the rules of `agent.runner`."""

from __future__ import annotations

import numpy as np

from agent.control.adaptation import from_row
from agent.control.memory import Memory, restore
from agent.loop import Agent, Outcome, blind, initial_memory, step
from agent.modes import Mode
from agent.safety import Flag
from agent.standing import afresh, wait_here
from agent.transition import entered
from drivers.interface import JointState, Vector

Row = np.void
MARKS = Flag.RESUMED | Flag.GAP


class Chain:
    """The memory of one agent while its rows pass in their order."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._nothing = np.full(agent.model.n, np.nan)
        self._memory: Memory | None = None
        self._mode: Mode | None = None  # of the row before
        self._outcome: Outcome | None = None  # of the row before, if it had a fresh state

    def start(self) -> None:
        """The next row is the first one of the run."""
        self._memory, self._mode, self._outcome = initial_memory(self._agent), None, None

    def restore(self, row: Row, *, keep_estimate: bool = False) -> None:
        """The next row is this one, whatever came before; keep_estimate: not the row's, which is of another law."""
        n, estimate = self._agent.model.n, None
        if self._agent.offline.adaptation is not None:
            kept = None if self._memory is None else self._memory.estimate
            estimate = from_row(row["theta_arm"], row["theta_object"], n)
            if keep_estimate:
                estimate = kept or self._agent.offline.adaptation.start
        self._memory, self._mode, self._outcome = restore(row["memory"], n, estimate), None, None

    def pass_row(self, state: JointState, t: float, mode: Mode, flags: int) -> tuple[Memory, Outcome]:
        """What the row of this tick holds: the memory it began with, and what came of it.

        flags: recorded; what the loop knew and the joints do not tell (STALE, BLIND, RESUMED, GAP) is taken from them.
        """
        stale, marks = bool(flags & Flag.STALE), Flag(flags) & MARKS
        memory = self._entered(mode, None if stale else state.q, marks)
        if not stale:
            outcome = step(self._agent, state, t, mode, memory)
        elif flags & Flag.BLIND:
            outcome = blind(self._agent, mode, memory)
        else:
            outcome = Outcome(self._nothing, self._nothing, None, memory.tau, Flag.STALE, memory)
        if marks:
            outcome = outcome._replace(flags=outcome.flags | marks)
        self._memory, self._mode, self._outcome = outcome.memory, mode, None if stale else outcome
        return memory, outcome

    @property
    def memory(self) -> Memory | None:
        """Behind the last row."""
        return self._memory

    def standing(self, mode: Mode, marks: Flag) -> Memory:
        """The memory with which an arm stands in this mode behind the last row; marks: of its first row there."""
        return self._entered(mode, None, marks)

    def _entered(self, mode: Mode, q: Vector | None, marks: Flag) -> Memory:
        """The memory with which a row of this mode begins; q: measured, None without a fresh state."""
        if self._memory is None:
            raise AssertionError("neither started nor restored")
        memory = self._memory
        if self._mode is not None and mode is not self._mode:
            memory = entered(self._agent, mode, memory, self._outcome)
        memory = afresh(memory, marks)
        if mode is not Mode.TRACK and memory.hold is None and q is not None:
            memory = wait_here(self._agent, q, memory, mode)
        return memory
