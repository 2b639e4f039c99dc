"""Figures as text: with their unit, and in digits that a person can read."""

from __future__ import annotations

import math
from typing import Final

from agent.log.when import STARTED_S

ABSENT: Final = "–"  # not measured
SMALLEST: Final = 1e-6  # what is smaller is shown as that
LARGEST: Final = 1e9  # what is larger is shown as that: a law gone astray
SPACE: Final = "\N{NO-BREAK SPACE}"  # a figure and its unit stay on one line


def number(value: float, unit: str = "", scale: float = 1.0, digits: int = 3) -> str:
    """A figure with its unit, to so many significant digits and never in powers of ten; `–` where not measured."""
    if not math.isfinite(value):
        return ABSENT
    scaled = value * scale
    if 0.0 < abs(scaled) < SMALLEST:
        return f"< {SMALLEST:f}{SPACE}{unit}".rstrip()
    if abs(scaled) > LARGEST:
        return f"{'>' if scaled > 0.0 else '< −'} {LARGEST:.0f}{SPACE}{unit}".rstrip()
    decimals = max(0, min(6, digits - 1 - math.floor(math.log10(abs(scaled))))) if scaled else 0
    return f"{scaled:.{decimals}f}{SPACE}{unit}".rstrip()


def millimetres(value: float) -> str:
    """A length in mm."""
    return number(value, "mm", 1e3)


def milliradians(value: float) -> str:
    """An angle in mrad."""
    return number(value, "mrad", 1e3)


def instant(t: float) -> str:
    """A time of the trajectory, to the millisecond: which of two arms was first is a matter of one cycle."""
    return f"{t:.3f}{SPACE}s" if t > STARTED_S else "before a start"


def milliseconds(value: float) -> str:
    """A duration in ms."""
    return number(value, "ms", 1e3)
