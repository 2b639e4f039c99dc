"""How the processes of a lockstep run share the processor: who keeps to which core, all code in one memory layout.

Neither changes a result, and both only ask: where the host refuses, a run is slower.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

_ADDR_NO_RANDOMIZE = 0x0040000
_ASK = 0xFFFFFFFF
_TOGETHER_MAX = 3  # arms whose ticks one core does in less time than it takes to wake others


class Cores(NamedTuple):
    """What each part of a lockstep run keeps to."""

    plant: frozenset[int]
    arms: tuple[frozenset[int], ...]
    rest: frozenset[int]  # telemetry and the recorder


def cores_of_run(arms: int, allowed: Collection[int], turn: int) -> Cores:
    """Cores for the parts of a run of so many arms out of those allowed; on a single core there is no choice.

    Plant and agents wait for each other at every tick.  Waking a core that idles costs more than a few agents' ticks,
    so they share one and leave the others to what only follows; more arms share the work instead, a core each, in
    turn.  `turn` is any number that differs between runs, so that runs side by side do not meet on one core.
    """
    every = frozenset(allowed)
    cores = sorted(every)
    if len(cores) < 2:
        return Cores(every, (every,) * arms, every)
    if arms > _TOGETHER_MAX:
        return Cores(every, tuple(frozenset({cores[i % len(cores)]}) for i in range(arms)), every)
    one = frozenset({cores[turn % len(cores)]})
    return Cores(one, (one,) * arms, every - one)


def keep_to(pid: int, cores: frozenset[int]) -> None:
    """Let all threads of a process run on these cores only; nothing happens when it has ended."""
    with contextlib.suppress(OSError):  # no such process
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):  # it has just ended, or the host refuses
                os.sched_setaffinity(int(thread.name), cores)


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
