"""The command `coop run`: a simulated cell from start to report."""

from __future__ import annotations

import contextlib
import json
import re
import select
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import AsJson, CellPath, Force, Overrides, asked_yes, in_front, note, print_json, require_use
from agent.cli.results import show_results


class _Terminal:
    """A person at the terminal, beside real arms."""

    def __init__(self, tell: Callable[[str], None], *, empty: bool) -> None:
        self.tell = tell
        self._empty = empty  # they have said so for all arms

    def says_empty(self, arm: str) -> bool:
        return self._empty or asked_yes(f"Is the gripper of arm {arm} EMPTY?")

    @property
    def hears(self) -> bool:
        return in_front()

    def lets_go(self) -> bool:
        """Whether Enter was pressed; never where there is no terminal, or another command is in front of it."""
        pressed = False
        with contextlib.suppress(OSError):  # it is another's meanwhile, or has gone
            while in_front() and select.select([sys.stdin], [], [], 0.0)[0] and sys.stdin.readline():
                pressed = True
        return pressed


def _require_use(of_real_arms: Mapping[str, bool], ways: Mapping[str, bool], *, real_arms: bool) -> None:
    """Raise RunError for an option that would change nothing; by option, whether it was given.

    of_real_arms: those of real arms alone; ways: those that say what moves the arms, and how fast time passes.
    """
    from agent.process.folder import RunError

    if not real_arms:
        require_use(
            of_real_arms, RunError, found="a run without --real-arms", expected="real arms", remedy="add --real-arms"
        )
    given = [option for option, was_given in ways.items() if was_given]
    if len(given) > 1:
        raise RunError(
            " with ".join(given), found=f"{len(given)} ways to run the cell", expected="one of them",
            remedy=f"leave out {' or '.join(given)}",
        )  # fmt: skip


def _arms_of(hil: str) -> list[str]:
    """Names of the arms that rehearse.  Raises RunError."""
    from agent.config.schema.types import NAME_PATTERN
    from agent.process.folder import RunError

    names = [name.strip() for name in hil.split(",")]
    if not all(re.fullmatch(NAME_PATTERN, name) for name in names):
        raise RunError(
            "--hil", found=repr(hil), expected="names of arms with a comma between two, as left,right",
            remedy="name arms of the cell",
        )  # fmt: skip
    return names


def run(
    cell: CellPath,
    duration: Annotated[
        float | None, typer.Option(help="Seconds, a cycle at least, instead of the cell's duration.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results (default runs/<UTC>-<cell>).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of what is random in --faults; without them it changes nothing.")] = 0,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    wire: Annotated[bool, typer.Option("--wire", help="The real driver on emulated servos, in real time.")] = False,
    hil: Annotated[
        str | None,
        typer.Option(
            metavar="ARMS", help="Rehearse: these arms (left,right) on emulated servos, each on its own, in the loop."
        ),
    ] = None,
    real_arms: Annotated[
        bool, typer.Option("--real-arms", help="With --hil or [hil]: those arms are REAL, on the cell's ports.")
    ] = False,
    gripper_empty: Annotated[
        bool, typer.Option("--gripper-empty", help="With --real-arms: a person has looked, all grippers are empty.")
    ] = False,
    priority: Annotated[
        int | None, typer.Option(min=1, max=99, help="With --real-arms: SCHED_FIFO priority, or refuse.")
    ] = None,
    allow_no_realtime: Annotated[
        bool, typer.Option("--allow-no-realtime", help="With --real-arms: let them run at a normal priority.")
    ] = False,
    emulated: Annotated[
        bool, typer.Option("--emulated", help="With --real-arms: the servos on those ports are of `coop emulate`.")
    ] = False,
    whole: Annotated[bool, typer.Option("--whole", help="With --wire: from rest to the object and back.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Faults of the emulated servos, JSON lines.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 when a bound is missed or the object lost.")] = False,
    listen: Annotated[str | None, typer.Option(help="Endpoint for live viewers (default: a free port).")] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Draw the report, or results alone.")] = True,
    force: Force = False,
    overrides: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Run a simulated cell: plant, one agent per arm, recorder, report.

    With --real-arms the arms of --hil move: they hold nothing, and hold their place at the end until you release them.
    """
    from agent.cli.progress import RunProgress
    from agent.host.signals import StopFlag
    from agent.process.real_arms import RealArms
    from agent.process.run import RunOptions, run_cell
    from agent.process.run_kind import RunKind
    from agent.report.bounds import require_bounds
    from agent.telemetry.link.endpoint import FREE_PORT

    _require_use(
        {"--gripper-empty": gripper_empty, "--priority": priority is not None,
         "--allow-no-realtime": allow_no_realtime, "--emulated": emulated},
        {"--real-time": real_time, "--wire": wire, "--hil": hil is not None, "--real-arms": real_arms and hil is None},
        real_arms=real_arms,
    )  # fmt: skip
    requested, progress = StopFlag(), RunProgress()
    kind = RunKind.WIRE if wire else RunKind.REAL_TIME if real_time else RunKind.LOCKSTEP
    if hil is not None:
        kind, overrides = RunKind.HIL, [*overrides, 'driver="sim"', f"hil.arms={json.dumps(_arms_of(hil))}"]
    real = None
    if real_arms:
        kind = RunKind.HIL
        real = RealArms(_Terminal(progress.note, empty=gripper_empty), priority, allow_no_realtime, emulated)
    where = listen or FREE_PORT
    options = RunOptions(cell, tuple(overrides), duration, out, seed, kind, faults, force, where, report, whole, real)
    with progress:
        outcome = run_cell(options, requested, progress)
    if as_json:
        from agent.cli.documents import run_document

        print_json(run_document(outcome))
    else:
        show_results(outcome.results, outcome.log)
        typer.echo(f"log      {outcome.log}")
        if outcome.report is not None:
            typer.echo(f"report   {outcome.report}")
    if outcome.interrupted:
        typer.echo("stopped by request; the log ends there and is complete up to it", err=as_json)
        raise typer.Exit(130)
    if outcome.gave_up:
        note(f"coop: the session was given up: {outcome.gave_up}")
        raise typer.Exit(5)
    if strict:
        require_bounds(outcome.results)
