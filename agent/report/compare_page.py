"""Several runs beside each other as one HTML page that needs no other file, no script and no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Final

from agent.atomic import write_atomically
from agent.report.compare import Difference, compare, label
from agent.report.numbers import number
from agent.report.overlay import overlay
from agent.report.page import document, figure_html, table_html
from agent.report.picture import Picture
from agent.report.plotting import save_png
from agent.report.results import HEADLINE
from agent.report.results_file import ReportError
from agent.report.settings import different
from agent.report.shown import LETTERS, ComparedRun
from agent.report.tables import Table

CAPTION: Final = (
    "Size of the errors of each run: left while the start error decays, right after the transient, at scales of their "
    "own. Line styles are runs."
)


def write_comparison(runs: Sequence[ComparedRun], path: Path) -> None:
    """Write the page.  Raises ReportError where it cannot be written; an earlier file is then as it was."""
    page = render(runs)
    write_atomically(path, page.encode(errors="backslashreplace"), ReportError)


def render(runs: Sequence[ComparedRun]) -> str:
    """The page of at least two runs; every run is held against the first."""
    others = [compare(runs[0].results, run.results) for run in runs[1:]]
    title = f"{len(runs)} runs of {', '.join(dict.fromkeys(run.results.info.cell for run in runs))}"
    png = save_png(overlay([run.errors for run in runs]))
    picture = Picture("errors", "Errors", CAPTION, lambda: overlay([run.errors for run in runs]))
    body = [
        f"<h1>{escape(title)}</h1>",
        table_html(_runs(runs)),
        table_html(_figures("Headline", others, lambda d: d.name in HEADLINE)),
        figure_html(picture, png),
        table_html(_settings(runs)),
        table_html(_figures("Every figure that differs", others, _differs)),
    ]
    return document(title, body)


def _differs(d: Difference) -> bool:
    return d.differs and d.name not in HEADLINE


def _runs(runs: Sequence[ComparedRun]) -> Table:
    rows = tuple(
        (letter, str(run.log), label(run.results), "; ".join(run.results.missing) or "nothing")
        for letter, run in zip(LETTERS, runs, strict=False)
    )
    return Table("Runs", ("", "log", "what it is", "what it cannot tell"), rows, words=True)


def _figures(title: str, others: Sequence[Sequence[Difference]], wanted: Callable[[Difference], bool]) -> Table:
    letters = LETTERS[1 : 1 + len(others)]
    header = ("figure", "A", *(text for letter in letters for text in (letter, f"{letter} against A")))
    by_name = [{d.name: d for d in differences} for differences in others]
    names = dict.fromkeys(d.name for differences in others for d in differences if wanted(d))
    rows = tuple(_row(name, by_name) for name in names)
    return Table(title, header, rows or (("none", *[""] * (len(header) - 1)),))


def _row(name: str, by_name: Sequence[dict[str, Difference]]) -> tuple[str, ...]:
    known = [found.get(name) for found in by_name]
    first = next(d for d in known if d is not None)
    cells = [name, number(first.a, first.unit)]
    for d in known:
        cells += ["–", ""] if d is None else [number(d.b, d.unit), d.words]
    return tuple(cells)


def _settings(runs: Sequence[ComparedRun]) -> Table:
    found = different([run.settings for run in runs])
    header = ("setting", *LETTERS[: len(runs)])
    rows = tuple((setting.key, *setting.values) for setting in found)
    return Table("Different settings", header, rows or (("none", *[""] * len(runs)),), words=True)
