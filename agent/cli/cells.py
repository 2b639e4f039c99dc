"""The commands that examine a cell before anything moves: check and tune."""

from __future__ import annotations

from collections.abc import Collection
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli.options import (
    AsJson,
    CellPath,
    Force,
    Overrides,
    coloured,
    console,
    note,
    print_json,
    require_use,
    uncollected,
)

if TYPE_CHECKING:
    from agent.config.cell import Cell
    from agent.verify.check import CheckReport


class FormName(StrEnum):
    """Which gains `coop tune` may change."""

    REALITY = "reality"
    RATIO = "ratio"
    RATE = "rate"


def check(cell: CellPath, overrides: Overrides = [], as_json: AsJson = False) -> None:
    """Examine a cell before anything moves; exit code 2 when it must not run."""
    with uncollected():
        _check(cell, overrides, as_json)


def _check(cell: Path, overrides: list[str], as_json: bool) -> None:
    from agent.config.cell import load_cell
    from agent.config.schema.driver import DriverKind
    from agent.verify.check import examine

    loaded = load_cell(cell, overrides)
    report = examine(loaded, wired=True, thorough=True)
    if as_json:
        from agent.cli.documents import check_document

        print_json(check_document(loaded, report))
    else:
        _show(loaded, report)
        for f in report.findings:
            if f.remedy:
                typer.echo(f"{f.verdict}: {f.what} ({f.where}): {f.remedy}")
        if loaded.file.driver is DriverKind.DYNAMIXEL:
            typer.echo(f"this host: {_latency(loaded.file.rate_hz)}")
    report.require()


def _latency(rate_hz: float) -> str:
    """What the last latency test of this host says for a real arm."""
    import os

    from agent.host.latency import files, newest

    found = newest(files(os.environ))
    if found is None:
        return "wake-up latency not measured; run `coop latency-test` where the agents are to run"
    return f"wake-up latency {found.fitness(rate_hz)} at {rate_hz:g} Hz: {found.text}"


def tune(
    cell: CellPath,
    form: Annotated[
        FormName,
        typer.Option(help="By all that reality may do; or, of the rigid cell, k and its _rate_ form, or the latter."),
    ] = FormName.REALITY,
    worst: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Largest spectral radius, form reality (0.985).")
    ] = None,
    damping: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Least damping ratio of what swings, other forms (0.05).")
    ] = None,
    radius: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Largest spectral radius, other forms (0.999).")
    ] = None,
    write: Annotated[Path | None, typer.Option(help="Write the cell file with these gains; a new file.")] = None,
    force: Force = False,
    overrides: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Propose the stiffest gains that survive what reality may make of the cell, as `coop check` sees it."""
    from agent.atomic import require_place, write_atomically
    from agent.cli.progress import Steps
    from agent.config.cell import load_cell
    from agent.verify.tune import RIGID, Form, Margin, Tuner
    from agent.verify.tune_table import toml_lines, tune_table

    asked = {key: x for key, x in {"worst": worst, "damping": damping, "radius": radius}.items() if x is not None}
    _require_use(form, asked)
    if write is not None:
        require_place(write, force=force)
    with Steps() as step:
        step("looking for gains")
        tuner, margin = Tuner(load_cell(cell, overrides)), Margin(**asked)
        forms = RIGID if Form(form.value) in RIGID else (Form.REALITY,)
        proposals, configured = tuner.proposals(margin, forms), tuner.configured()
        chosen = next((p for p in proposals if p.form.value == form.value), None)
        chosen = chosen or tuner.propose(Form(form.value), margin)
    if write is not None:
        write_atomically(write, chosen.toml().encode())
    if as_json:
        from agent.cli.documents import tune_document

        print_json(tune_document(configured, proposals, chosen, margin, write))
    else:
        console().print(tune_table(configured, proposals))
        if chosen.from_usual:
            note(
                "the configured gains are unstable, or held by friction alone: the search began with usual ones, and "
                "takes their torque noise"
            )
        typer.echo(toml_lines(chosen) or "the configured gains are the largest that keep the margin")
    if write is not None:
        note(f"written  {write}")


def _require_use(form: FormName, asked: Collection[str]) -> None:
    """Raise ConfigError for a margin that this form does not look at."""
    from agent.config.cell import ConfigError

    found = f"--form {form.value}"
    if form is FormName.REALITY:
        given = {f"--{key}": key in asked for key in ("damping", "radius")}
        require_use(given, ConfigError, found=found, expected="--form ratio or rate", remedy="ask for one of these")
    else:
        given = {"--worst": "worst" in asked}
        require_use(given, ConfigError, found=found, expected="--form reality", remedy="ask for that form")


def schema(
    page: Annotated[bool, typer.Option("--page", help="As a page of keys instead (docs/cell.md).")] = False,
) -> None:
    """Print the JSON Schema of cell files, by which an editor checks and completes them."""
    from agent.config.keys import json_schema
    from agent.config.keys import page as as_page

    if page:
        typer.echo(as_page(), nl=False)
    else:
        print_json(json_schema())


def _show(cell: Cell, report: CheckReport) -> None:
    """The findings as a table; where a person looks, by rich, which folds it and takes a third as long as the check."""
    from agent.cli.boxed import boxed

    title, header = f"{cell.file.name}  {cell.fingerprint[:12]}", ("what", "where", "found", "wanted", "")
    rows = [(f.what, f.where, f.found, f.wanted, f.verdict.value) for f in report.findings]
    drawn = None if coloured() else boxed(title, header, rows)
    if drawn is not None:
        typer.echo(drawn)
        return
    from rich.markup import escape
    from rich.table import Table

    from agent.verify.finding import Verdict

    table = Table(title=title, title_justify="left")
    for column in header:
        table.add_column(column, overflow="fold")
    colour = {Verdict.OK: "green", Verdict.WARNING: "yellow", Verdict.REFUSED: "red"}
    for *words, verdict in rows:
        table.add_row(*map(escape, words), f"[{colour[Verdict(verdict)]}]{verdict}[/]")
    console().print(table)
