"""results.json and its table, which need no figures; a file is put in place when it is whole."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich import box
from rich.table import Table

from agent.atomic import place_of
from agent.report.metrics import summarise_prepared
from agent.report.prepared import prepare
from agent.report.results import Judgement, Results
from agent.report.tables import WORDS, lines
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.log.read import AnyLog

RESULTS: Final = "results.json"
COLOURS: Final = {Judgement.MET: "green", Judgement.NOT_MET: "red", Judgement.NOT_SHOWN: "yellow"}


class ReportError(Refusal):
    """The report cannot be written where it was asked for."""


def write_results(log: AnyLog, out_dir: Path) -> Results:
    """Write results.json alone into `out_dir`, as `write_report` does, and return what it says.  Raises ReportError."""
    results = summarise_prepared(prepare(log))
    with folder_of(out_dir) as draft:
        put_results(results, draft)
    return results


def put_results(results: Results, folder: Path) -> None:
    """results.json in this folder."""
    content = json.dumps(results.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / RESULTS).write_text(content + "\n", encoding="utf-8")


@contextmanager
def folder_of(out_dir: Path) -> Iterator[Path]:
    """A folder whose files move to `out_dir`, one after the other, once all of them are whole.  Raises ReportError.

    None moves where what is no file has the name of one; a disk that fails between two leaves some of each report.
    """
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".report-", dir=out_dir) as name:
            yield Path(name)
            files = {file: out_dir / file.name for file in sorted(Path(name).iterdir())}
            for place in files.values():
                place_of(place, ReportError)
            for file, place in files.items():
                file.replace(place)
    except OSError as error:
        raise ReportError(
            "report not written",
            found=f"{error.strerror or error} at {error.filename or out_dir}",
            expected="a directory that can be written, with room for some megabytes",
            remedy="name another directory or make room",
        ) from error


def terminal_table(results: Results) -> Table:
    """The table of results for the terminal: figure, bound and verdict."""
    table = Table(
        title=f"{results.info.cell}: errors of the {results.error_source}", title_justify="left", box=box.SIMPLE_HEAD
    )
    for heading in ("result", "figure", "bound", "verdict"):
        table.add_column(heading, justify="left" if heading == "result" else "right", no_wrap=True)
    for row in lines(results):
        verdict = "" if row.verdict is None else f"[{COLOURS[row.verdict]}]{WORDS[row.verdict]}[/]"
        table.add_row(row.what, row.figure, row.bound, verdict)
    return table
