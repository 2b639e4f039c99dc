"""The command `coop study`: many realities of a cell, and how it fares in them."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli import complete
from agent.cli.options import AsJson, Force, Overrides, console, note, print_json
from agent.cli.progress import StudyProgress

if TYPE_CHECKING:
    from rich.table import Table

    from agent.study.study import StudyOutcome, Work

STUDY_PATH = typer.Argument(
    metavar="CELL|STUDY",
    help="Cell file or name of a shipped cell, or a study file (TOML with `cells`).",
    show_default=False,
    autocompletion=complete.cells,
)


def study(
    cell: Annotated[Path, STUDY_PATH],
    runs: Annotated[int | None, typer.Option(help="Runs of each cell (200, or what the study says).")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all realities (0, or what the study says).")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds of a run, instead of the cell's.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; a study there goes on.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes, instead of one per core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers do the runs instead.")
    ] = None,
    force: Force = False,
    overrides: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Run a cell in many realities within its tolerance: what share holds its bounds, and which error matters."""
    from agent.host.signals import StopFlag
    from agent.study.plan import load_plan
    from agent.study.study import run_study
    from agent.study.work import until

    requested = StopFlag(suspends=True)
    plan = load_plan(cell, runs=runs, seed=seed, duration_s=duration, overrides=overrides)
    name = plan.cells[0].file.name if len(plan.cells) == 1 else cell.stem
    out = out or Path("studies") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{name}"
    work = partial(until, requested, _work(workers, scheduler))
    with StudyProgress() as progress:
        outcome = run_study(plan, out, work, requested, progress, anew=force)
    if as_json:
        print_json(dict(outcome.document))
    else:
        from agent.study.summary import counting, verdict

        console().print(_table(outcome))
        cells = {one.file.name: one for one in plan.cells}
        for name, found in outcome.document["cells"].items():
            typer.echo(f"{name} {verdict(found)}")
            if found["ended_early"] or found["counted_from_start"]:
                typer.echo(counting(cells[name], found, plan.faults))
        typer.echo(f"results  {out / 'study.json'}")
        if outcome.document["runs"]:
            typer.echo(f"report   {out / 'report.html'}\nworst    {out / 'worst.toml'}")
    if outcome.interrupted:
        typer.echo(f"stopped by request; the same command with --out {out} goes on", err=as_json)
        raise typer.Exit(130)


def _work(workers: int | None, scheduler: str | None) -> Work:
    """Who does the runs."""
    if scheduler is not None:
        from agent.study.cluster import on_cluster

        return lambda tasks: on_cluster(tasks, scheduler, note)
    from agent.study.work import cores, here, in_processes

    count = workers or cores()
    return here if count == 1 else lambda tasks: in_processes(tasks, min(count, len(tasks)))


def _table(outcome: StudyOutcome) -> Table:
    from rich import box
    from rich.table import Table

    from agent.study.summary import FIGURES, PROMISED, QUANTILES, quantile

    document = outcome.document
    counts = ", ".join(f"{document[key]} {key.replace('_', ' ')}" for key in ("lost", "tripped", "within_bounds"))
    table = Table(title=f"{document['runs']} runs: {counts}", title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("cell", "figure", "50 %", "95 %", "100 %", f"bound of {PROMISED} %"):
        table.add_column(heading, justify="left" if heading in ("cell", "figure") else "right")
    for name, found in document["cells"].items():
        for figure in FIGURES:
            bound = found["bounds"].get(figure)
            if found[figure]["50"] is not None:
                cells = [quantile(found, figure, str(q)) for q in QUANTILES]
                table.add_row(name, figure, *cells, "" if bound is None else f"{bound:g}")
    return table
