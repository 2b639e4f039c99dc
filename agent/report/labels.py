"""What stands in the panels of a figure: the names of curves at their ends, and what happened on the axis of time."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agent.report.plotting import TIMED

LINE_IN = 0.15  # height of a name beside a panel
LEADER_IN, SAMPLE_IN, GAP_IN = 0.1, 0.24, 0.04  # from the end of a curve to its sample, the sample, from it to the name
LETTER_IN = 0.078
NAME_SIZE = 8.0
MARK_SIZE = 7.5
MARK_LETTER_IN = 0.63 * MARK_SIZE / 72.0


def room_in(names: Iterable[str]) -> float:
    """What the longest of these names and its sample need beside a panel, in."""
    longest = max((len(re.sub(r"[$_{}]", "", re.sub(r"\\[a-z]+", "x", name))) for name in names), default=0)
    return LEADER_IN + SAMPLE_IN + GAP_IN + LETTER_IN * max(longest, 2)


def end_labels(ax: Axes, without: str = "") -> None:
    """The name of each curve beside the panel at the height of its end, with a sample of its dashes.

    To be called when nothing changes the panel's scale any more; `without` is left out of the names.
    """
    low, high = ax.get_ylim()
    at: list[tuple[float, Line2D]] = []
    for curve in ax.get_lines():
        y = np.asarray(curve.get_ydata(), float)
        good = y[np.isfinite(y)]
        if len(good) and not str(curve.get_label()).startswith("_"):
            last = float(np.median(good[-max(1, len(good) // 50) :]))
            at.append((_of_height(ax, min(max(last, low), high)), curve))
    at.sort(key=lambda pair: pair[0])
    height_in = _size_in(ax)[1]
    for height, (own, curve) in zip(_apart([own for own, _ in at], LINE_IN / height_in), at, strict=True):
        _label(ax, own, height, curve, str(curve.get_label()).removeprefix(without))


def _label(ax: Axes, end: float, height: float, curve: Line2D, name: str) -> None:
    """From the end of a curve, in parts of the panel's height, to its name at another height."""
    width_in = _size_in(ax)[0]
    begin, until = (1.0 + way / width_in for way in (LEADER_IN, LEADER_IN + SAMPLE_IN))
    leader = Line2D([1.0, begin], [end, height], linewidth=0.6, color=curve.get_color())
    sample = Line2D([begin, until], [height, height], linewidth=1.5, color=curve.get_color())
    sample.set_linestyle(_dashes(curve))
    figure = ax.get_figure(root=True)
    assert figure is not None
    for mark in (leader, sample):
        mark.set(transform=ax.transAxes, clip_on=False)
        figure.add_artist(mark)
    ax.annotate(
        name, (until, height), xycoords="axes fraction", xytext=(72.0 * GAP_IN, 0), textcoords="offset points",
        ha="left", va="center", fontsize=NAME_SIZE, annotation_clip=False,
    )  # fmt: skip


def name_curve(ax: Axes, curve: Line2D, name: str, y: float) -> None:
    """The name of a curve in the panel itself, at the right of where it is at about `y`."""
    height = np.asarray(curve.get_ydata(), float)
    x = np.asarray(curve.get_xdata(), float)[np.argmin(np.abs(height - y))]
    ax.annotate(
        name, (float(x), y), xytext=(4, -2), textcoords="offset points", ha="left", va="top", fontsize=NAME_SIZE,
        color=curve.get_color(), fontweight="bold",
        bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6},
    )  # fmt: skip


def _dashes(curve: Line2D) -> Any:
    """The dashes of a curve in units of its own width, as it was given them."""
    return getattr(curve, "_unscaled_dash_pattern", None) or curve.get_linestyle()


def _size_in(ax: Axes) -> tuple[float, float]:
    figure = ax.get_figure(root=True)
    assert figure is not None
    width, height = figure.get_size_inches()
    box = ax.get_position()
    return float(box.width * width), float(box.height * height)


def _apart(heights: Sequence[float], each: float) -> list[float]:
    """The same ascending heights, none nearer to its neighbour than `each` and none above the panel."""
    out: list[float] = []
    for own in heights:
        out.append(max(own, out[-1] + each) if out else own)
    top = 1.0
    for number in reversed(range(len(out))):
        out[number] = min(out[number], top)
        top = out[number] - each
    return out


def _of_height(ax: Axes, y: float) -> float:
    """Where a value lies between the lower and the upper edge of a panel, 0 … 1, on whatever scale it has."""
    _, pixel = ax.transData.transform((0.0, y))
    return float(ax.transAxes.inverted().transform((0.0, pixel))[1])


def shortened(label: str, letters: int) -> str:
    """What of a label has room, whole words with "…" behind them where it is not all; its list has the whole text."""
    if len(label) <= letters:
        return label
    kept = label[:letters].rpartition(" ")[0].rstrip(" ,;:") or label[: letters - 1]
    return f"{kept[: letters - 1]}…"


def mark_moments(figure: Figure, marks: Sequence[tuple[float, str]]) -> None:
    """Thin lines on every panel whose axis is the run's time; what they mean stands in the uppermost of them."""
    timed = [ax for ax in figure.axes if ax.get_gid() == TIMED]
    for number, ax in enumerate(timed):
        first, last = ax.get_xlim()
        for t, label in marks:
            if not first <= t <= last:
                continue
            ax.axvline(t, color="#444a50", linewidth=0.7, linestyle=(0, (1, 2)), zorder=1.5)
            if number == 0:
                ax.annotate(
                    shortened(label, int(_size_in(ax)[1] / MARK_LETTER_IN)), (t, 1.0),
                    xycoords=("data", "axes fraction"), xytext=(2, -2), textcoords="offset points",
                    ha="left", va="top", fontsize=MARK_SIZE, rotation=90, color="#444a50",
                )  # fmt: skip
