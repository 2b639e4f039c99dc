"""The command `coop`: its groups put together, and every error as one line with an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated

import typer

from agent.cli import (
    answers,
    cells,
    doctor,
    faults,
    floats,
    latency,
    logs,
    make,
    motors,
    pki,
    processes,
    replay,
    run,
    study,
    view,
    words,
)
from agent.cli.help import Commands
from agent.cli.where import where

PROGRAM = "coop"
USAGE = 2  # exit code of a command line that says nothing `coop` understands

GROUPS: dict[str, tuple[Callable[..., None], ...]] = {
    "Simulate and examine": (make.new, run.run, cells.check, cells.tune, cells.schema, study.study),
    "Arms of this host": (
        words.approach, words.grasp, words.start, words.stop, words.lower, words.release, words.park, words.guide,
        words.status, doctor.doctor, floats.float_arms, latency.latency_test,
    ),
    "Logs": (
        logs.report, view.view, logs.compare, answers.events, answers.grasps, replay.replay, logs.identify,
        logs.calibrate, logs.export, logs.play, logs.recover, logs.layout,
    ),
    "This installation": (where, pki.pki),
    "Processes of a cell": (
        processes.agent, processes.guard, processes.plant, processes.emulate, processes.telemetry, processes.record,
        processes.ros2,
    ),
}  # fmt: skip

NAMES: dict[Callable[..., None], str] = {floats.float_arms: "float"}  # where a function cannot have the command's

app = typer.Typer(
    cls=Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Cooperative manipulation with several arms.",
)
for _heading, _commands in GROUPS.items():
    for _command in _commands:
        app.command(NAMES.get(_command), rich_help_panel=_heading)(_command)
app.add_typer(motors.app, name="motors", rich_help_panel="Arms of this host")
app.add_typer(faults.app, name="faults", rich_help_panel="Simulate and examine")


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"{PROGRAM} {version('widowx-coop')}")
        except PackageNotFoundError:
            typer.echo(f"{PROGRAM}, not installed: run from its sources")
        raise typer.Exit


@app.callback()
def _coop(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: ends the process; a Refusal is one line for a person and an exit code for a script."""
    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # read when they are loaded: our matrices are small
        os.environ.setdefault(library, "1")
    sys.exit(dispatch(arguments))


def dispatch(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; its exit code.  What is not meant for a person is raised."""
    command = typer.main.get_command(app)
    try:
        code = command(arguments, prog_name=PROGRAM, standalone_mode=False)
    except typer.Abort:
        return _refuse("stopped at a question", 1)
    except typer.TyperException as error:
        return _usage(error)
    except OSError as error:
        found = f"found {error.strerror or error}"
        if error.filename is None:
            return _refuse(f"this host: {found}, expected it to do what was asked; see what it is short of", USAGE)
        return _refuse(f"{error.filename}: {found}, expected a path that can be used; name another", USAGE)
    except Exception as error:
        from drivers.interface import Refusal  # numpy with it, which `coop --help` has no need of

        if not isinstance(error, Refusal):
            raise
        return [_refuse(line, error.exit_code) for line in error.lines][-1]
    return code if isinstance(code, int) else 0


def _usage(error: typer.TyperException) -> int:
    """A command line that was not understood."""
    text = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
    context = getattr(error, "ctx", None)
    return _refuse(f"{text} (see `{context.command_path if context else PROGRAM} -h`)", error.exit_code)


def _refuse(text: str, exit_code: int) -> int:
    typer.echo(f"{PROGRAM}: {text}", err=True)
    return exit_code


if __name__ == "__main__":
    main()
