"""How every figure of a report looks, and how a long series is drawn fast with every peak in it."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Final, Literal, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import ScalarFormatter

from agent.report.series import Array

P = ParamSpec("P")
Sharing = bool | Literal["row", "col"]

Dashes = tuple[float, tuple[float, ...]]

DPI: Final = 120
WIDTH_IN: Final = 8.4  # 1008 pixels: the width of a page that shows a README
PANEL_IN: Final = 1.75
HEADER_IN: Final = 0.62  # room above panels with titles for `header_line`
COLUMNS: Final = 900  # a long series is drawn as mean, lowest and highest value of this many stretches
RANGE_ALPHA: Final = 0.3
DRAWN_MAX: Final = 1e12  # of whatever unit; what is beyond belongs to a run that went astray, and dwarfs the rest
TIMED: Final = "time of the run"  # the mark of panels that have it as their axis
UNDRAWN: Final = "beyond 10¹²: not drawn"

# told apart by the colour-blind; in grey the dashes below tell them apart
BLUE: Final = "#005c9e"
LIGHT_BLUE: Final = "#7ab8ea"
RED: Final = "#d55e00"
GREEN: Final = "#009e73"
ORANGE: Final = "#c99000"
PURPLE: Final = "#b0588f"
TEAL: Final = "#3fa7d6"
BROWN: Final = "#5b3a1e"
GREY: Final = "#767d86"
AXIS_COLOURS: Final = (BLUE, RED, GREEN)  # x, y, z everywhere
CYCLE: Final = (BLUE, RED, GREEN, ORANGE, PURPLE, TEAL, BROWN, GREY)

_SOLID: Final[Dashes] = (0, ())
DASHES: Final[dict[str, Dashes]] = {  # of a curve of this colour, unless it has a style of its own
    RED: (0, (5, 1.4)), GREEN: (0, (4, 1.2, 1, 1.2)), ORANGE: (0, (1.2, 1)), PURPLE: (0, (8, 1.2, 1.2, 1.2, 1.2, 1.2)),
    TEAL: (0, (2.5, 1)), BROWN: (0, (9, 2)), GREY: (0, (1, 2)),
}  # fmt: skip
STYLES: Final = ("-", "--", ":", "-.")  # what colours do not tell
STYLE_WORDS: Final = ("solid", "dashed", "dotted", "dash and dot")

STYLE: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.edgecolor": "#9aa1a9",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-5, 5),
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.1,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.2,
    "legend.borderaxespad": 0.1,
    "xtick.color": "#555b63",
    "ytick.color": "#555b63",
    "xtick.labelcolor": "#23272b",
    "ytick.labelcolor": "#23272b",
    "axes.labelcolor": "#23272b",
    "text.color": "#23272b",
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
    "agg.path.chunksize": 20000,
}


_SUPERSCRIPTS: Final = str.maketrans("0123456789\N{MINUS SIGN}-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")


class _Numbers(ScalarFormatter):
    """Plain numbers at the ticks and a power of ten in Unicode: a formula for each takes a fifth of a report's time."""

    def get_offset(self) -> str:
        """The power of ten above the axis."""
        plain = super().get_offset()
        mantissa, e, exponent = plain.partition("e")
        return f"{'×10' if mantissa == '1' else mantissa + '×10'}{exponent.translate(_SUPERSCRIPTS)}" if e else plain


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Decorate a figure's function: it runs with the report's style and leaves matplotlib's settings as they were."""

    @wraps(draw)
    def with_style(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(STYLE), np.errstate(over="ignore", invalid="ignore"):  # of a run that went astray
            return draw(*args, **kwargs)

    return with_style


def save_png(figure: Figure, path: Path | None = None) -> bytes:
    """Render a figure, to `path` if one is given, and return the bytes of the PNG."""
    with mpl.rc_context(STYLE):
        canvas: Any = FigureCanvasAgg(figure)  # matplotlib ships no types for its printing
        png = io.BytesIO()
        canvas.print_png(png, pil_kwargs={"compress_level": 4})
    if path is not None:
        path.write_bytes(png.getvalue())
    return png.getvalue()


def panels(
    rows: int,
    columns: int = 1,
    *,
    height_in: float = PANEL_IN,
    gap_in: float = 0.42,
    top_in: float = 0.34,
    sharex: Sharing = True,
    sharey: Sharing = False,
    names_in: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """A figure of `rows` × `columns` panels, in reading order, with room for titles and labels.

    `top_in` of HEADER_IN leaves room for `header_line`, `names_in` for names of curves at the right of each panel.
    Margins are in inches and set by hand: a layout engine would draw every figure twice.
    """
    bottom, left, right = 0.5, 0.86, max(0.22, names_in)
    total = rows * height_in + (rows - 1) * gap_in + bottom + top_in
    between = max(0.98, 0.86 + names_in) if columns > 1 else 0.0
    width = (WIDTH_IN - left - right - (columns - 1) * between) / columns
    figure = Figure(figsize=(WIDTH_IN, total), dpi=DPI, facecolor="white")
    figure.subplots_adjust(
        left=left / WIDTH_IN,
        right=1 - right / WIDTH_IN,
        bottom=bottom / total,
        top=1 - top_in / total,
        hspace=gap_in / height_in,
        wspace=between / width,
    )
    grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
    axes = [ax for row in grid for ax in row]
    for ax in axes:
        ax.yaxis.set_label_coords(-0.64 / width, 0.5)  # the labels of all panels stand in one line
        ax.yaxis.set_major_formatter(_Numbers())
    return figure, axes


def time_axis(axes: Sequence[Axes], until_s: float, from_s: float = 0.0) -> None:
    """Time from `from_s` to `until_s` on every panel; named, and its numbers shown, under the lowest of each column."""
    lowest: dict[float, Axes] = {}
    for ax in axes:
        ax.set_xlim(from_s, until_s)
        ax.set_gid(TIMED)
        ax.tick_params(labelleft=True, labelbottom=False)
        box = ax.get_position()
        if box.x0 not in lowest or box.y0 < lowest[box.x0].get_position().y0:
            lowest[box.x0] = ax
    for ax in lowest.values():
        ax.tick_params(labelbottom=True)
        ax.set_xlabel("time [s]")


def legend(ax: Axes) -> None:
    """A legend in one line above the panel's right end, where it never hides a curve."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        box = ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(labels), borderpad=0.15)
        _thicken(box)


def headline(figure: Figure, title: str) -> None:
    """Title of a whole figure at its top."""
    width, height = figure.get_size_inches()
    figure.text(0.86 / width, 1 - 0.1 / height, title, va="top", fontweight="bold", fontsize=11)


def header_line(figure: Figure, title: str, ax: Axes) -> None:
    """Title and legend of a whole figure in one line at its top; the legend is that of `ax`."""
    headline(figure, title)
    width, height = figure.get_size_inches()
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        corner = (1 - 0.22 / width, 1 - 0.06 / height)
        _thicken(figure.legend(handles, labels, loc="upper right", bbox_to_anchor=corner, ncols=len(labels)))


def _thicken(box: Legend) -> None:
    for handle in box.get_lines():
        handle.set_linewidth(1.8)


def line(ax: Axes, t: Array, values: Array, **style: Any) -> None:
    """Draw a series: short ones as they are, long ones as mean and range of each column of pixels.

    The range is a shade of the same colour, so a single peak is seen and noise hides no other curve.  Where rows
    are missing, or values are beyond DRAWN_MAX, the line is broken; what stands alone between two gaps is a point.
    Without a style of its own a curve has the dashes of its colour.
    """
    style.setdefault("linestyle", DASHES.get(style.get("color", ""), _SOLID))
    spans = unbroken(t, drawable(ax, values))
    alone = [(x[0], y[0]) for x, y in spans if len(x) == 1]
    if alone:
        point = {"linestyle": "none", "marker": ".", "markersize": 3.5, "label": "_alone"}
        ax.plot(*zip(*alone, strict=True), **style | point)
    if sum(len(x) for x, _ in spans) <= 4 * COLUMNS:
        ax.plot(*_joined(spans), **style)
        return
    share = COLUMNS / max(sum(len(x) for x, _ in spans), 1)
    parts = [in_columns(x, y, max(2, round(share * len(x)))) for x, y in spans]
    mean_t, mean = _joined([(c.t, c.mean) for c in parts])
    ax.plot(mean_t, mean, **style)
    lowest = _joined([(c.t, c.lowest) for c in parts])[1]
    highest = _joined([(c.t, c.highest) for c in parts])[1]
    ax.fill_between(mean_t, lowest, highest, color=style.get("color"), alpha=RANGE_ALPHA, linewidth=0)


def drawable(ax: Axes, values: Array) -> Array:
    """The same values (k,) with NaN for what is beyond DRAWN_MAX; where there is such a one, the panel says so."""
    beyond = np.abs(values) > DRAWN_MAX  # false for what is no number
    if not beyond.any():
        return values
    if UNDRAWN not in [text.get_text() for text in ax.texts]:
        ax.text(
            0.99, 0.04, UNDRAWN, transform=ax.transAxes, ha="right", va="bottom", fontsize=8,
            bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip
    return np.where(beyond, np.nan, values)


@dataclass(frozen=True, slots=True)
class Columns:
    """A series in columns of pixels: where each is, and mean, lowest and highest value in it."""

    t: Array
    mean: Array
    lowest: Array
    highest: Array


def in_columns(t: Array, values: Array, columns: int) -> Columns:
    """The series in about so many stretches of equal length; no value of it lies outside their range.

    `t` and `values` (k,) without a gap, k > 0.  First and last column stand at the first and last time.
    """
    each = -(-len(t) // columns)
    starts = np.arange(0, len(t), each)
    counts = np.diff(np.append(starts, len(t)))
    centre = np.add.reduceat(t, starts) / counts
    centre[0], centre[-1] = t[0], t[-1]
    mean = np.add.reduceat(values, starts) / counts
    lowest, highest = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return Columns(centre, np.clip(mean, lowest, highest), lowest, highest)


def unbroken(t: Array, values: Array) -> list[tuple[Array, Array]]:
    """The stretches of a series in which no row is missing and every value is a number.

    A row is missing where time goes on by more than one and a half of its usual step.
    """
    if not len(t):
        return []
    steps = np.diff(t)
    jump = np.append(steps > 1.5 * np.median(steps), False) if len(t) > 2 else np.zeros(len(t), dtype=bool)
    good = np.isfinite(values)
    ends = np.flatnonzero(jump | (good != np.append(good[1:], good[-1]))) + 1
    spans = zip(np.split(t, ends), np.split(values, ends), strict=True)
    return [(x, y) for x, y in spans if len(x) and np.isfinite(y[0])]


def _joined(spans: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    if not spans:
        return np.empty(0), np.empty(0)
    gap = np.array([np.nan])
    t = np.concatenate([part for x, _ in spans for part in (gap, x)])
    values = np.concatenate([part for _, y in spans for part in (gap, y)])
    return t[1:], values[1:]
