"""Whether a quantity of a long run stays where it was once the run had settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SETTLED = 0.3  # part of the run after which nothing has a reason to grow any more
WINDOW = 0.2  # part of the run that is averaged at the beginning and at the end


@dataclass(frozen=True)
class Growth:
    """Mean over the window after settling and over the last one."""

    settled: float
    last: float

    @property
    def rise(self) -> float:
        """What was added between the two."""
        return self.last - self.settled


def growth(t: Sequence[float], value: Sequence[float]) -> Growth:
    """Of samples (any number ≥ 2) at ascending times."""
    times, values = np.asarray(t), np.asarray(value)
    begin, span = times[0], times[-1] - times[0]
    settled = (times >= begin + SETTLED * span) & (times <= begin + (SETTLED + WINDOW) * span)
    last = times >= begin + (1.0 - WINDOW) * span
    return Growth(float(values[settled].mean()), float(values[last].mean()))
