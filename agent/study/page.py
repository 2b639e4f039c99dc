"""The report of a study as one HTML page: shares, quantiles, what matters most; no script, no network."""

from __future__ import annotations

import base64
import math
import tempfile
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from agent.config.cell import Cell
from agent.config.schema.fault import Fault
from agent.report.page import STYLE
from agent.report.plotting import BLUE, RED, panels, save_png, styled
from agent.study.measure import RunResult
from agent.study.summary import (
    ENDED_EARLY,
    FIGURES,
    LEAST_RUNS,
    PROMISED,
    QUANTILES,
    Influence,
    counted,
    counting,
    quantile,
    verdict,
)

SHOWN: Final = 12  # influences in the table
SHOWN_EARLY: Final = 4  # of them at most of ending early
DRAWN: Final = (  # figure, its axis, factor
    ("position_beyond_anchor_m", "position error [mm]", 1e3),
    ("attitude_beyond_anchor_rad", "attitude error [mrad]", 1e3),
    ("internal_force_mean_N", "mean internal force [N]", 1.0),
    ("peak_torque_fraction", "peak torque [% of stall]", 100.0),
)


def render(
    title: str,
    parts: Sequence[tuple[Cell, Sequence[RunResult], dict[str, Any], Sequence[Influence]]],
    faults: Sequence[Fault],
) -> str:
    """The whole page; one part for each cell: its runs, their summary, and what matters.  faults: the study's."""
    body = [f"<h1>{escape(title)}</h1>"]
    for cell, results, found, influences in parts:
        body += [
            f"<h2>{escape(cell.file.name)}</h2>",
            f'<p class="dim">{escape(_about(cell, found, faults))}</p>',
            f"<p>{escape(verdict(found))}</p>",
            _counts(found),
            _quantiles(found),
            _picture(cell.file.name, _distribution(results)),
            _influences(influences, len(results)),
        ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _about(cell: Cell, found: dict[str, Any], faults: Sequence[Fault]) -> str:
    duration_s = cell.file.duration_s
    return (
        f"{found['runs']} runs of {duration_s:g} s, each in a reality of its own within the cell's tolerance. "
        f"{counting(cell, found, faults)} The pictures show errors beyond those of what the anchor sees."
    )


def _counts(found: dict[str, Any]) -> str:
    runs = found["runs"] or 1
    rows = [(name, found[key]) for name, key in (
        ("within bounds", "within_bounds"), ("lost the object", "lost"), ("an arm gave up following", "tripped"),
    )]  # fmt: skip
    body = "".join(f"<tr><td>{n}</td><td>{c}</td><td>{c / runs:.1%}</td></tr>" for n, c in rows)
    return f'<table class="results"><thead><tr><th></th><th>runs</th><th>share</th></tr></thead>{body}</table>'


def _quantiles(found: dict[str, Any]) -> str:
    head = "".join(f"<th>{q} %</th>" for q in QUANTILES) + f"<th>bound of {PROMISED} %</th>"
    body = ""
    for figure in FIGURES:
        values = "".join(f"<td>{quantile(found, figure, str(q))}</td>" for q in QUANTILES)
        body += f"<tr><td>{figure}</td>{values}<td>{_number(found['bounds'].get(figure))}</td></tr>"
    return f"<table><thead><tr><th>not above, in so many of the runs</th>{head}</tr></thead>{body}</table>"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _influences(found: Sequence[Influence], runs: int) -> str:
    if not found:
        why = "Too few runs" if runs < LEAST_RUNS else "All runs are alike, or all were lost or tripped: nothing"
        return f"<p>{why} to tell which error of reality matters most.</p>"
    early = [i for i in found if i.figure == ENDED_EARLY][:SHOWN_EARLY]
    shown = [*early, *(i for i in found if i.figure != ENDED_EARLY)][:SHOWN]
    body = "".join(f"<tr><td>{i.error}</td><td>{i.figure}</td><td>{i.correlation:+.2f}</td></tr>" for i in shown)
    head = "<tr><th>error of reality</th><th>goes with</th><th>rank correlation</th></tr>"
    chance = f"By chance alone one in twenty is beyond ±{2.0 / math.sqrt(runs - 1):.2f} in {runs} runs."
    if early:
        chance += f" {ENDED_EARLY} is that a run was lost, or tripped before any fault."
    return f'<table class="words"><thead>{head}</thead>{body}</table>\n<p class="dim">{chance}</p>'


@styled
def _distribution(results: Sequence[RunResult]) -> Figure:
    """Of each figure, the share of runs that do not exceed it; lost and tripped runs are marked."""
    figure, axes = panels(2, 2, sharex=False, sharey=True, gap_in=0.7)
    for ax, (key, label, factor) in zip(axes, DRAWN, strict=True):
        every = np.array(counted(results, key), dtype=np.float64)
        order = np.argsort(every, kind="stable")
        values = factor * every[order]
        share = np.arange(1, len(order) + 1) / len(order)
        bad = np.array([r.lost or r.tripped for r in results], dtype=bool)[order]
        ax.step(values, share, where="post", color=BLUE)
        ax.plot(values[bad], share[bad], "x", color=RED, markersize=4, label="lost or tripped")
        ax.set_xlabel(label)
        ax.set_ylim(0.0, 1.02)
        low, high = min(0.0, float(values[0])), max(float(values[-1]), 1e-6)
        ax.set_xlim(low, high + 0.04 * (high - low))
    axes[0].set_ylabel("share of runs")
    axes[2].set_ylabel("share of runs")
    return figure


def _picture(name: str, figure: Figure) -> str:
    with tempfile.TemporaryDirectory() as folder:
        png = save_png(figure, Path(folder) / "figure.png")
    data = base64.b64encode(png).decode("ascii")
    caption = "Share of the runs that do not exceed a figure; crosses are runs that were lost or tripped."
    caption += " Those that ended early lie at the largest figure: how they would have gone on is not known."
    image = f'<img src="data:image/png;base64,{data}" alt="{escape(name)}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
