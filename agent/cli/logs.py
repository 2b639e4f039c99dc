"""The commands on logs: report, compare, play, recover."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import DEFAULT_ENDPOINT, NetworkConfig, begin, ready


def report(
    log: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder of the report (default: beside the log).")] = None,
) -> None:
    """Make the figures, the page and results.json from a log alone."""
    from rich.console import Console

    from agent.log.read import open_log
    from agent.report.report import terminal_table, write_report

    with open_log(log) as opened:
        files = write_report(opened, out or log.parent)
    Console().print(terminal_table(files.results))
    typer.echo(f"report   {files.html}")


def compare(
    first: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
    second: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
) -> None:
    """Say which figures of two logs differ, and which log has the better ones."""
    from rich.console import Console

    from agent.log.read import open_log
    from agent.report.compare import compare as differences
    from agent.report.compare import comparison_table
    from agent.report.metrics import summarise

    results = []
    for log in (first, second):
        with open_log(log) as opened:
            results.append(summarise(opened))
    a, b = results
    Console().print(comparison_table(a, b, differences(a, b)))


def play(
    log: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
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
    typer.echo(f"{log}: {done.rows} rows and {done.events} events played, {done.loops} times to the end", err=True)


def recover(
    log: Annotated[Path, typer.Argument(help="MCAP log that was not finished.", show_default=False)],
) -> None:
    """Mend a log that a crash or a power cut left unfinished, and verify the result."""
    from agent.log.recover import recover as mend

    done = mend(log)
    for problem in done.problems:
        typer.echo(f"{log}: {problem}", err=True)
    typer.echo(f"{log}: {'repaired' if done.repaired else 'nothing to repair'}, {done.messages} messages, read back")
