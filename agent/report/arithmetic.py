"""Figures of series: values that are no number count in none, and without any other the figure is NaN."""

from __future__ import annotations

from typing import Final

import numpy as np

from agent.report.series import Array

NAN: Final = float("nan")


def most(values: Array) -> float:
    """The largest of any shape."""
    return float(np.fmax.reduce(values, axis=None)) if len(values) else NAN


def rms(values: Array) -> float:
    """Root of the mean square."""
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good * good))) if len(good) else NAN


def mean(values: Array) -> float:
    """The plain one."""
    good = values[np.isfinite(values)]
    return float(np.mean(good)) if len(good) else NAN


def instant_of_most(t: Array, values: Array) -> float:
    """When the largest is there first."""
    return float(t[int(np.nanargmax(values))]) if len(values) and np.isfinite(values).any() else NAN
