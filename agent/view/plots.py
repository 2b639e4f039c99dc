"""A curve of the page in the browser, with a mark where the picture is."""

from __future__ import annotations

from typing import Final

import numpy as np
import viser
from viser import uplot

from agent.view.curves import Curve
from agent.view.pose import Array

STROKES: Final = ("#005c9e", "#d55e00", "#008a64", "#965a8c", "#555555")  # as the arms
DASHES: Final = ((), (6, 3), (2, 3), (8, 3, 2, 3), (4, 4))
HEIGHT_PX: Final = 130
NOW: Final = "#14171a"


class Plot:
    """One figure over time."""

    def __init__(self, server: viser.ViserServer, curve: Curve) -> None:
        self._curve = curve
        series = [uplot.Series(label="s")]
        for number, (name, _) in enumerate(curve.lines):
            series.append(
                uplot.Series(
                    label=name, stroke=STROKES[number % len(STROKES)], width=1.5, dash=DASHES[number % len(DASHES)]
                )
            )
        series.append(uplot.Series(label="now", stroke=NOW, width=2))
        self._handle = server.gui.add_uplot(
            self._data(curve.t[0]), tuple(series), title=f"{curve.title} [{curve.unit}]",
            scales={"x": uplot.Scale(time=False)}, height=HEIGHT_PX,
        )  # fmt: skip

    @property
    def lines(self) -> int:
        """How many curves there are in it."""
        return len(self._curve.lines)

    def remove(self) -> None:
        """Take it off the page."""
        self._handle.remove()

    def replace(self, curve: Curve) -> None:
        """Another stretch of the same figure."""
        self._curve = curve
        self._handle.data = self._data(curve.t[-1])

    def mark(self, t: float) -> None:
        """Stand at a time."""
        self._handle.data = self._data(t)

    def _data(self, t: float) -> tuple[Array, ...]:
        lines = [values for _, values in self._curve.lines]
        values = np.stack(lines)
        if not np.isfinite(values).any():
            return (self._curve.t, *lines, np.full(len(self._curve.t), np.nan))
        return (self._curve.t, *lines, needle(self._curve.t, t, float(np.nanmin(values)), float(np.nanmax(values))))


def needle(times: Array, t: float, low: float, high: float) -> Array:
    """A line (n,) that goes up and down where `t` is among the sorted times, and is absent elsewhere."""
    now = np.full(len(times), np.nan)
    at = max(0, int(np.searchsorted(times, t + 1e-9, side="right")) - 1)
    now[max(at - 1, 0) : at + 2] = low
    now[at] = high
    return now
