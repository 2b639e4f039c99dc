"""How the processes of a lockstep run share the processor: who has which core.

It changes no result, and only asks: where the host refuses, a run is slower.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection
from typing import NamedTuple


class Cores(NamedTuple):
    """On which cores the processes of a lockstep run may run."""

    arms: tuple[frozenset[int], ...]
    plant: frozenset[int]
    listeners: frozenset[int]  # telemetry and recorder


def share_out(arms: int, allowed: Collection[int]) -> Cores:
    """Share out the allowed cores: one for each arm; without one to spare, arms take turns and the plant has its own.

    A tick of the plant costs as much as those of half of its arms.  Each arm goes where the least is to do, and not to
    the plant while another core has no more: the plant computes on while they answer, and none of them wakes it.
    Telemetry and recorder are free, and take what is left on any core.
    """
    cores = sorted(allowed)
    every = frozenset(cores)
    if len(cores) < 2:
        return Cores((every,) * arms, every, every)
    if len(cores) > arms:
        return Cores(tuple(frozenset({core}) for core in cores[:arms]), every, every)
    plant, *others = cores
    to_do = dict.fromkeys(others, 0.0) | {plant: 0.5 * arms}
    kept = []
    for _ in range(arms):
        kept.append(min(to_do, key=to_do.__getitem__))  # of equals the first, which is not the plant's
        to_do[kept[-1]] += 1.0
    return Cores(tuple(frozenset({core}) for core in kept), frozenset({plant}), every)


def keep_to(pid: int, cores: frozenset[int]) -> None:
    """Let a process that has just been started run on these cores only; nothing happens when it has ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.sched_setaffinity(pid, cores)
