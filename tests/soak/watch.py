"""Samples of processes over a long run, and which of them rose."""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import psutil

from tests.soak.flat import growth

SHORTEST_S = 20.0  # a process that lived for less says nothing
RISE_MAX = {"memory_MB": 2.0, "descriptors": 1.0, "threads": 1.0}


@dataclass
class Series:
    """Samples of one process."""

    t: list[float] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))

    def look(self, process: psutil.Process) -> None:
        """Take one sample.  Raises psutil.Error when the process has ended."""
        with process.oneshot():
            memory = process.memory_info()
            taken = {
                "memory_MB": (memory.rss - memory.shared) / 1e6,  # rings are shared and fill at first
                "descriptors": float(process.num_fds()),
                "threads": float(process.num_threads()),
            }
        self.t.append(time.monotonic())
        for what, value in taken.items():
            self.values[what].append(value)


def grown(processes: Mapping[str, Series]) -> list[str]:
    """What rose after the processes had settled, in words."""
    complaints = []
    for name, series in processes.items():
        if not series.t or series.t[-1] - series.t[0] < SHORTEST_S:
            continue
        for what, most in RISE_MAX.items():
            found = growth(series.t, series.values[what])
            say(f"  {name}: {what} {found.settled:.1f} → {found.last:.1f}")
            if found.rise > most:
                complaints.append(f"{name}: {what} rose by {found.rise:.1f}, at most {most:g} is allowed")
    return complaints


def say(text: str) -> None:
    """A line, at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
