"""How the processes of a lockstep run share the processor: who has which core, and all code in one memory layout.

Neither changes a result, and both only ask: where the host refuses, a run is slower.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Collection, Iterator
from typing import NamedTuple

_ADDR_NO_RANDOMIZE = 0x0040000
_ASK = 0xFFFFFFFF


class Cores(NamedTuple):
    """On which cores the processes of a lockstep run may run."""

    arms: tuple[frozenset[int], ...]
    plant: frozenset[int]
    listeners: frozenset[int]  # telemetry and recorder


def share_out(arms: int, allowed: Collection[int]) -> Cores:
    """Share out the allowed cores: one for each arm, in turn; without one to spare, also for plant and listeners.

    The plant goes to the core with the fewest arms, and the listeners to the others: it takes turns with the arm beside
    it, so that this core has no time left, while an arm on another core waits for both.
    """
    cores = sorted(allowed)
    every = frozenset(cores)
    if len(cores) < 2:
        return Cores((every,) * arms, every, every)
    kept = tuple(cores[i % len(cores)] for i in range(arms))
    if len(cores) > arms:
        return Cores(tuple(frozenset({core}) for core in kept), every, every)
    plant = frozenset({min(cores, key=kept.count)})
    return Cores(tuple(frozenset({core}) for core in kept), plant, every - plant)


def keep_to(pid: int, cores: frozenset[int]) -> None:
    """Let a process that has just been started run on these cores only; nothing happens when it has ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.sched_setaffinity(pid, cores)


@contextlib.contextmanager
def one_memory_layout() -> Iterator[None]:
    """Processes started within have their code at the same addresses, instead of each at random ones.

    Then the processor's branch predictor, which goes by addresses, serves all of them: 8 % of the wall time of a run
    of two arms on two cores.  Only for processes that nobody outside can reach.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    before = libc.personality(_ASK)
    if before < 0:
        yield
        return
    libc.personality(before | _ADDR_NO_RANDOMIZE)  # of this thread and what it starts; refused in some containers
    try:
        yield
    finally:
        libc.personality(before)
