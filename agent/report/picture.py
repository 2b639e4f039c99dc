"""What a report knows of one of its figures before it draws it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure of a report: the stem of its file, what the page says about it, how to draw it."""

    stem: str
    title: str
    caption: str
    draw: Callable[[], Figure]
