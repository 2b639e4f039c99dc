"""The results of a run on the terminal: the table, and beside it why a figure is a dash."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agent.cli.options import console, note

if TYPE_CHECKING:
    from agent.report.results import Results


def show_results(results: Results, log: Path) -> None:
    """The table on standard output, what the log cannot tell on standard error."""
    from agent.report.results_file import terminal_table

    console().print(terminal_table(results))
    for line in results.missing:
        note(f"{log}: {line}")
