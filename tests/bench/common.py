"""What every benchmark returns and how it measures: medians of repeats, so that a busy machine does not decide."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class Figure:
    """One measured figure; `baseline` is what it is compared with, in the same unit, `ratio` = value / baseline."""

    value: float
    unit: str
    baseline: float | None = None
    ratio: float | None = None

    def __post_init__(self) -> None:
        if self.ratio is None and self.baseline:
            self.ratio = self.value / self.baseline


def median_us(fn: Callable[[], object], n: int, repeats: int) -> float:
    """Median over `repeats` of the mean time of `n` calls, µs per call; one untimed round warms up."""
    rounds = []
    for _ in range(repeats + 1):
        start = time.perf_counter_ns()
        for _ in range(n):
            fn()
        rounds.append((time.perf_counter_ns() - start) / n / 1e3)
    return statistics.median(rounds[1:])
