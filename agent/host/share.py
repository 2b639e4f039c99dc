"""How the processes of a lockstep run share the processor: arms on distinct cores, all code in one memory layout.

Neither changes a result, and both only ask: where the host refuses, a run is slower.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Collection, Iterator

_ADDR_NO_RANDOMIZE = 0x0040000
_ASK = 0xFFFFFFFF


def cores_of_arms(arms: int, allowed: Collection[int]) -> list[frozenset[int]]:
    """Cores for each of so many agents out of those allowed: one each, in turn; on a single core there is no choice."""
    cores = sorted(allowed)
    if len(cores) < 2:
        return [frozenset(cores)] * arms
    return [frozenset({cores[i % len(cores)]}) for i in range(arms)]


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
