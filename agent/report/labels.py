"""What stands in the panels of a figure: the names of curves at their ends, and what happened on the axis of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

LABEL_HEIGHT, LABEL_TOP = 0.11, 0.9  # of a panel: of a name at the end of a curve, and where the highest stands


def end_labels(ax: Axes) -> None:
    """The name of each curve at its right end, one above the other where they meet."""
    low, high = ax.get_ylim()
    at: list[tuple[float, Line2D]] = []
    for curve in ax.get_lines():
        y = np.asarray(curve.get_ydata(), float)
        good = y[np.isfinite(y)]
        if len(good) and not str(curve.get_label()).startswith("_"):
            last = float(np.median(good[-max(1, len(good) // 50) :]))
            at.append((_of_height(ax, min(max(last, low), high)), curve))
    at.sort(key=lambda pair: pair[0])
    for height, (_, curve) in zip(_apart([own for own, _ in at]), at, strict=True):
        ax.annotate(
            str(curve.get_label()), (1.0, height), xycoords="axes fraction", xytext=(-3, 2), textcoords="offset points",
            ha="right", va="bottom", color=curve.get_color(), fontsize=8.5, fontweight="bold",
            bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6}, annotation_clip=False,
        )  # fmt: skip


def _apart(heights: Sequence[float]) -> list[float]:
    """The same ascending heights, none nearer to its neighbour than a line of text and none above the panel."""
    out: list[float] = []
    for own in heights:
        out.append(max(own, out[-1] + LABEL_HEIGHT) if out else own)
    top = LABEL_TOP
    for number in reversed(range(len(out))):
        out[number] = min(out[number], top)
        top = out[number] - LABEL_HEIGHT
    return out


def _of_height(ax: Axes, y: float) -> float:
    """Where a value lies between the lower and the upper edge of a panel, 0 … 1, on whatever scale it has."""
    _, pixel = ax.transData.transform((0.0, y))
    return float(ax.transAxes.inverted().transform((0.0, pixel))[1])


def mark_moments(figure: Figure, until_s: float, marks: Sequence[tuple[float, str]]) -> None:
    """Thin lines on every panel whose axis is the run's time; what they mean stands in the uppermost of them."""
    timed = [ax for ax in figure.axes if ax.get_xlim() == (0.0, until_s)]
    for number, ax in enumerate(timed):
        for t, label in marks:
            ax.axvline(t, color="#444a50", linewidth=0.7, linestyle=(0, (1, 2)), zorder=1.5)
            if number == 0:
                ax.annotate(
                    label, (t, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2), textcoords="offset points",
                    ha="left", va="top", fontsize=7.5, rotation=90, color="#444a50",
                )  # fmt: skip
