"""The command `coop doctor`: what is wrong with host, ports, servos and bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import AsJson, CellPath, Overrides, SomeArms, confirmed, print_json
from agent.cli.progress import Steps
from agent.host.stops import hear_ctrl_z


def doctor(
    cell: CellPath,
    arm: SomeArms = [],
    ports: Annotated[Path | None, typer.Option(help="Folder of ports named like the arms (`coop emulate`).")] = None,
    logs: Annotated[Path, typer.Option(help="Folder for logs, to see whether there is room.")] = Path("runs"),
    move: Annotated[bool, typer.Option("--move", help="Then move each joint of one arm a little, with a yes.")] = False,
    overrides: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Look at host, ports, servos, bus timing: exit code 0 ok, 1 warnings, 2 problems.  Without --move no torque."""
    from agent.config.cell import load_cell
    from agent.doctor.doctor import DoctorOptions, diagnose, move_arm
    from agent.verify.finding import Verdict

    described, options = load_cell(cell, overrides), DoctorOptions(arm, ports, logs)
    with Steps(lines=True) as step:
        diagnosis = diagnose(described, options, step)
    if move:
        hear_ctrl_z()
        move_arm(described, options, confirmed, diagnosis)
    if as_json:
        print_json(diagnosis.document())
    else:
        colours = {Verdict.OK: "green", Verdict.WARNING: "yellow", Verdict.REFUSED: "red"}
        for finding in diagnosis.findings:
            typer.echo(f"{typer.style(f'{finding.verdict:<8}', fg=colours[finding.verdict])} {finding.line}")
    raise typer.Exit(diagnosis.exit_code)
