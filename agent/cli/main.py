"""The command `coop`: its groups put together, and every error as one line with an exit code."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any

import typer
from typer.main import get_command_name

from agent.cli import (
    answers,
    arms,
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
from agent.host import stops
from agent.host.starting import USAGE, end, of_host, outlive_readers, settle

PROGRAM = "coop"

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
        arms.agent, arms.guard, processes.plant, processes.emulate, processes.telemetry, processes.record,
        processes.ros2,
    ),
}  # fmt: skip

_FAMILIES: dict[str, tuple[str, typer.Typer]] = {
    "motors": ("Arms of this host", motors.app),
    "faults": ("Simulate and examine", faults.app),
}


class _Unheard(Exception):
    """Another process left in the middle of a command; what reads the line would take it for a reader who left."""

    def __init__(self, error: OSError) -> None:
        super().__init__(error)
        self.error = error


class _Whole(Commands):
    """All commands."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command of the line.  Raises _Unheard."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise _Unheard(error) from error


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"{PROGRAM} {version('widowx-coop')}")
        except PackageNotFoundError:
            typer.echo(f"{PROGRAM}, not installed: run from its sources")
        raise typer.Exit


def _coop(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def _tree(only: str | None = None) -> typer.Typer:
    """All commands, or the one of this name; each that is there costs a millisecond when a line is read."""
    tree = typer.Typer(
        cls=_Whole,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
        help="Cooperative manipulation with several arms.",
    )
    tree.callback()(_coop)
    for heading, commands in GROUPS.items():
        for command in commands:
            if only in (None, get_command_name(command.__name__)):
                tree.command(rich_help_panel=heading)(command)
    for name, (heading, family) in _FAMILIES.items():
        if only in (None, name):
            tree.add_typer(family, name=name, rich_help_panel=heading)
    return tree


app = _tree()


@cache
def whole() -> Callable[..., object]:
    """All commands, as what reads a line."""
    return typer.main.get_command(app)


@cache
def _command(first: str) -> Callable[..., object]:
    """What reads a line that begins with this word."""
    tree = _tree(first)
    return typer.main.get_command(tree) if tree.registered_commands or tree.registered_groups else whole()


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: ends the process; a Refusal is one line for a person and an exit code for a script."""
    settle()
    outlive_readers()
    stops.hear()
    code = dispatch(arguments)
    if stops.heard() and not code:
        raise KeyboardInterrupt  # it was dropped, and the command went on to its end
    end(code)


def dispatch(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; its exit code.  What is not meant for a person is raised."""
    arguments = sys.argv[1:] if arguments is None else arguments
    command = _command(arguments[0] if arguments else "")
    try:
        code = command(list(arguments), prog_name=PROGRAM, standalone_mode=False)
    except typer.Abort:
        return _refuse("stopped at a question", 1)
    except typer.TyperException as error:
        return _usage(error)
    except _Unheard as unheard:
        return _refuse(of_host(unheard.error), USAGE)
    except OSError as error:
        return _refuse(of_host(error), USAGE)
    except Exception as error:
        from drivers.interface import Refusal  # numpy with it, which `coop --help` has no need of

        if not isinstance(error, Refusal):
            if stops.heard():
                raise KeyboardInterrupt from error  # what a library made of it
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
