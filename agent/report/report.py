"""The report of a run: PNG figures, one HTML page, results.json; none is put in place before all are whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from matplotlib.figure import Figure

from agent.atomic import keep_existing
from agent.report import names
from agent.report.gallery import pictures
from agent.report.loss import told
from agent.report.metrics import summarise_prepared
from agent.report.page import render
from agent.report.picture import Picture
from agent.report.plotting import save_png
from agent.report.prepared import Prepared, prepare
from agent.report.results import Results
from agent.report.results_file import RESULTS, ReportError, folder_of, put_results
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.log.read import AnyLog

PAGE: Final = "report.html"
START: Final = Picture(
    names.START,
    "The cell at the start",
    "Arms and object as the log's URDFs and cell file draw them. Black edges: the desired pose. Arrows in an arm's "
    "colour: its commanded force; purple: internal force.",
    Figure,
)


@dataclass(frozen=True, slots=True)
class ReportFiles:
    """What a report consists of, and the figures it shows."""

    html: Path
    results_file: Path
    figures: Mapping[str, Path]
    results: Results


Still = Callable[[Prepared], bytes]  # a PNG of the first moment; raises Refusal where the log cannot show it


def write_report(
    log: AnyLog, out_dir: Path, still: Still | None = None, *, keeps: bool = False, beside: Sequence[str] = ()
) -> ReportFiles:
    """Write every figure as PNG, report.html and results.json into `out_dir`, made if it is absent.

    All files are written beside their place first and moved there when the last one is whole, so a report
    that fails leaves what was there before.  A poor log gives a poor report: the page says what is missing.
    `still` draws the picture that the page opens with.  keeps: pictures, and files that are made `beside` the report,
    which lie in a folder without a page are no report's, and refused before the work.
    Raises ReportError when `out_dir` cannot be written, WriteError for what is kept.
    """
    run = prepare(log)
    shown = pictures(run)
    if keeps and not (out_dir / PAGE).exists():
        stems = [START.stem, *(p.stem for p in shown)]
        own = (*(f"{stem}.png" for stem in stems), *beside)
        keep_existing(*(out_dir / name for name in own), remedy="name another folder with --out, or give --force")
    results = summarise_prepared(run)
    with folder_of(out_dir) as draft:
        images = _opening(run, still, draft)
        images += [(p, save_png(p.draw(), draft / f"{p.stem}.png")) for p in shown]
        events = sorted([*log.events, *told(run)], key=lambda event: event.utc_ns)
        page = render(results, images, events)
        (draft / PAGE).write_text(page, encoding="utf-8")
        put_results(results, draft)
    figures = {p.stem: out_dir / f"{p.stem}.png" for p, _ in images}
    return ReportFiles(out_dir / PAGE, out_dir / RESULTS, figures, results)


def _opening(run: Prepared, still: Still | None, folder: Path) -> list[tuple[Picture, bytes]]:
    """The cell at the start; nothing for a log that does not say how its cell looks."""
    if still is None or not run.rows:
        return []
    try:
        png = still(run)
    except Refusal:
        return []
    (folder / f"{START.stem}.png").write_bytes(png)
    return [(START, png)]


def keep_other_reports(log: Path, folder: Path) -> None:
    """Raise ReportError where a report lies in `folder` that may be of another log than this one.

    A report beside the only log of its folder is that log's own.
    """
    there = [name for name in (PAGE, RESULTS) if (folder / name).exists()]
    if there and [path.resolve() for path in folder.glob("*.mcap")] != [log.resolve()]:
        raise ReportError(
            f"report in {folder}",
            found=f"{there[0]}, perhaps of another log",
            expected="none, or that of the only log in its folder",
            remedy="name another folder with --out, or give --force",
        )
