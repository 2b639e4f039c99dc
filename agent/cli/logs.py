"""The commands on logs: report, compare, identify, play, recover."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import (
    DEFAULT_ENDPOINT,
    AsJson,
    Force,
    LogPath,
    NetworkConfig,
    begin,
    console,
    note,
    print_json,
    ready,
)
from agent.cli.progress import Steps


def report(
    log: LogPath,
    out: Annotated[Path | None, typer.Option(help="Folder of the report (default: beside the log).")] = None,
    force: Force = False,
) -> None:
    """Make the figures, the page and results.json from a log alone; its own earlier report is replaced."""
    from agent.log.read import open_log
    from agent.report.report import keep_other_reports, terminal_table, write_report

    folder = out or log.parent
    if not force:
        keep_other_reports(log, folder)
    with Steps() as step:
        step("reading the log")
        with open_log(log) as opened:
            step("drawing")
            files = write_report(opened, folder)
    console().print(terminal_table(files.results))
    typer.echo(f"report   {files.html}")


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="MCAP log.", show_default=False)],
    second: Annotated[Path, typer.Argument(metavar="B", help="MCAP log.", show_default=False)],
    as_json: AsJson = False,
) -> None:
    """Say which figures of two logs differ, and which log has the better ones."""
    from agent.log.read import open_log
    from agent.report.compare import compare as differences
    from agent.report.compare import comparison_table
    from agent.report.metrics import summarise

    results = []
    with Steps() as step:
        for log in (first, second):
            step(f"reading {log}")
            with open_log(log) as opened:
                results.append(summarise(opened))
    a, b = results
    if as_json:
        from agent.cli.documents import compare_document

        print_json(compare_document(a, b, differences(a, b), (first, second)))
    else:
        console().print(comparison_table(a, b, differences(a, b)))


def identify(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="MCAP log of one arm with a light object.", show_default=False)
    ],
    arm: Annotated[str | None, typer.Option(help="Name of the arm.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the new arm file (default: beside the log).")] = None,
    arms: Annotated[Path | None, typer.Option(help="Folder of the arm files the run used.")] = None,
    cutoff_hz: Annotated[float, typer.Option(min=0.1, help="Low-pass of torque and motion.")] = 5.0,
    slow_rad_per_s: Annotated[float, typer.Option(min=0.01, help="Slower motion says nothing of friction.")] = 0.2,
    force: Force = False,
) -> None:
    """Identify friction, rotor inertia and gravity parameters of an arm, and write its new arm file."""
    import configs
    from agent.identify.fit import Options
    from agent.identify.run import identify as identify_log
    from agent.identify.run import write
    from agent.identify.show import delay_line, estimates_table, friction_lines, residual_lines

    arms_dir = arms or configs.ARMS_DIR
    with Steps() as step:
        result = identify_log(log, arm, Options(cutoff_hz, slow_rad_per_s), arms_dir, tell=step)
        step("writing")
        files = write(result, out or log.parent, arms_dir, replace=force)
    console().print(estimates_table(result))
    typer.echo("\n".join([*friction_lines(result), *residual_lines(result), delay_line(result)]))
    typer.echo(f"arm file {files.arm}\nfigure   {files.figure}\nall      {files.summary}")


def play(
    log: LogPath,
    speed: Annotated[float, typer.Option(min=0.001, help="Pace; 1 is the pace of the run.")] = 1.0,
    start: Annotated[float, typer.Option(min=0.0, help="First second to play.")] = 0.0,
    end: Annotated[float | None, typer.Option(help="Last second to play.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    listen: Annotated[str, typer.Option(help="Endpoint to listen on.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
) -> None:
    """Publish a log again, byte for byte, under the prefix replay/."""
    from agent.telemetry.link.play import PlayOptions
    from agent.telemetry.link.play import run as play_log
    from agent.telemetry.link.session import Network

    requested = begin(False)
    network = Network(config_file=network_config) if network_config else Network(listen=listen)
    options = PlayOptions(log, network, speed, start, end, loop)
    done = play_log(options, requested, lambda endpoint: ready(f"endpoint={endpoint}"))
    note(f"{log}: {done.rows} rows and {done.events} events played, {done.loops} times to the end")


def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="MCAP log that was not finished.", show_default=False)],
) -> None:
    """Mend a log that a crash or a power cut left unfinished, and verify the result."""
    from agent.log.recover import recover as mend

    done = mend(log)
    for problem in done.problems:
        note(f"{log}: {problem}")
    typer.echo(f"{log}: {'repaired' if done.repaired else 'nothing to repair'}, {done.messages} messages, read back")
