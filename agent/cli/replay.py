"""The command `coop replay`: a log through the control law again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli.options import AsJson, Force, LogPath, console, instant, note, print_json
from agent.cli.progress import Steps

if TYPE_CHECKING:
    from agent.config.cell import Cell
    from agent.log.read import ColumnLog
    from agent.replay.rows import Window

DIFFERENT = 1  # exit code where some row is not what the log says


def replay(
    log: LogPath,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare every row with the one `step` gives now (what it does anyway).")
    ] = False,
    same_as: Annotated[
        Path | None,
        typer.Option("--same-as", metavar="LOG", help="Compare with the rows of another log instead."),
    ] = None,
    changes: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Show the torque with this value of the cell file instead."),
    ] = [],
    from_s: Annotated[
        float | None, typer.Option("--from", callback=instant, help="Begin at this time of the trajectory, s.")
    ] = None,
    row: Annotated[int | None, typer.Option("--row", min=0, help="Begin at this row number.")] = None,
    arm: Annotated[str | None, typer.Option("--arm", help="Only this arm.")] = None,
    picture: Annotated[Path | None, typer.Option(help="With --set: both torques over time, as PNG.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Run every recorded input through the same step: equal bit for bit, or where it begins to differ (exit code 1)."""
    from agent.atomic import require_place
    from agent.log.read import open_log
    from agent.replay.rows import Window
    from agent.replay.source import recorded_cell

    if changes and verify:
        raise typer.BadParameter("either --verify or --set: a changed cell gives other torques")
    if from_s is not None and row is not None:
        raise typer.BadParameter("either --from or --row")
    if picture is not None and not changes:
        raise typer.BadParameter("--picture goes with --set")
    if picture is not None:
        require_place(picture, force=force)
    if same_as is not None:
        if changes or verify or arm is not None or from_s is not None or row is not None:
            raise typer.BadParameter("--same-as compares all rows of two logs and goes with --json alone")
        _show_same(log, same_as, as_json=as_json)
        return
    window = Window(from_s, row)
    with Steps() as step:
        step("reading the log")
        with open_log(log, any_layout=True) as opened:
            cell = recorded_cell(opened)
            if changes:
                _show_changed(opened, cell, changes, window, arm, picture, step, as_json=as_json)
            else:
                _show_comparison(opened, cell, window, arm, step, as_json=as_json)


def _show_same(log: Path, other: Path, *, as_json: bool) -> None:
    from agent.log.read import open_log
    from agent.replay.same import same
    from agent.replay.show import comparison_document, same_lines

    with Steps() as step:
        step("reading the logs")
        with open_log(log, any_layout=True) as a, open_log(other, any_layout=True) as b:
            compared = same(a, b)
    notes = [f"{read.path}: {problem}" for read in (a, b) for problem in read.remarks]
    if as_json:
        print_json(comparison_document(a, compared, notes) | {"other": str(other)})
    else:
        for line in (*notes, *compared.notes):
            note(line)
        typer.echo("\n".join(same_lines(compared)))
    if not compared.equal:
        raise typer.Exit(DIFFERENT)


def _show_comparison(
    log: ColumnLog, cell: Cell, window: Window, arm: str | None, step: Steps, *, as_json: bool
) -> None:
    from agent.replay.show import comparison_document, comparison_lines, version_notes
    from agent.replay.verify import verify

    compared = verify(log, cell, window, arm, step)
    step.clear()
    notes = [*log.remarks, *version_notes(log)]
    if as_json:
        print_json(comparison_document(log, compared, notes))
    else:
        for line in (*notes, *compared.notes):
            note(f"{log.path}: {line}")
        typer.echo("\n".join(comparison_lines(compared)))
    if not compared.equal:
        raise typer.Exit(DIFFERENT)


def _show_changed(
    log: ColumnLog,
    cell: Cell,
    changes: list[str],
    window: Window,
    arm: str | None,
    picture: Path | None,
    step: Steps,
    *,
    as_json: bool,
) -> None:
    from agent.replay.show import torque_document, torque_lines, torque_table
    from agent.replay.source import changed_cell
    from agent.replay.whatif import what_if

    torques = what_if(log, cell, changed_cell(log, changes), window, arm, step)
    if picture is not None:
        from agent.replay.picture import save_picture

        step("drawing")
        save_picture(torques, changes, picture)
    step.clear()
    for line in log.remarks:
        note(f"{log.path}: {line}")
    if as_json:
        print_json(torque_document(log, changes, torques))
        return
    console().print(torque_table(torques))
    typer.echo("\n".join(torque_lines(torques)))
    if picture is not None:
        note(f"picture  {picture}")
