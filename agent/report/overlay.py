"""The errors of several runs in one figure: the start and the rest, each at a scale of its own."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from agent.report.labels import end_labels, room_in
from agent.report.plotting import CYCLE, STYLES, line, panels, styled
from agent.report.shown import LETTERS, ErrorSeries


@styled
def overlay(runs: Sequence[ErrorSeries]) -> Figure:
    """Position error above, attitude error below; left the start, right what follows the transient."""
    figure, axes = panels(2, 2, height_in=2.1, gap_in=0.6, sharex=False, names_in=room_in(LETTERS))
    start = max(run.start_s for run in runs)
    for number, run in enumerate(runs):
        look = {
            "color": CYCLE[number % len(CYCLE)],
            "linestyle": STYLES[number % len(STYLES)],
            "label": LETTERS[number],
        }
        for row, values in enumerate((1e3 * run.position, 1e3 * run.attitude)):
            for column, shown in enumerate((run.t <= start, run.t >= run.transient_s)):
                line(axes[2 * row + column], run.t[shown], values[shown], **look)
    for row, (what, unit) in enumerate((("position error", "mm"), ("attitude error", "mrad"))):
        for column, when in enumerate(("at the start", "after the transient")):
            ax = axes[2 * row + column]
            ax.set_title(f"{what} {when}"[0].upper() + f"{what} {when}"[1:])
            ax.set_ylabel(f"[{unit}]")
            ax.set_xlabel("time [s]" if row else "")
            ax.set_ylim(bottom=0.0)
            end_labels(ax)
    return figure
