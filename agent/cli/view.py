"""The command `coop view`: a run in 3D, as a page, a file or a film."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli import complete
from agent.cli.options import DEFAULT_ENDPOINT, Force, NetworkConfig, Overrides, instant, note, require_use
from agent.cli.progress import Steps
from agent.host.ready_line import pairs
from agent.host.starting import ready

if TYPE_CHECKING:
    from agent.log.read import AnyLog

PORT, PACE = 8080, 2.5


def view(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="LOG", help="MCAP log; with --live a cell.", show_default=False, autocompletion=complete.cells
        ),
    ],
    live: Annotated[bool, typer.Option("--live", help="A run as it goes on, from its telemetry.")] = False,
    html: Annotated[Path | None, typer.Option(help="Write the run as one HTML file instead.")] = None,
    film: Annotated[Path | None, typer.Option(help="Write a film instead: .gif, .webp or .png.")] = None,
    start: Annotated[float | None, typer.Option("--from", min=0.0, help="First second of the film (0).")] = None,
    end: Annotated[float | None, typer.Option("--to", callback=instant, help="Last second of the film.")] = None,
    speed: Annotated[
        float | None, typer.Option(min=0.01, help=f"Pace of the film; 1 is the pace of the run ({PACE:g}).")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help=f"Port of the page, on this host alone ({PORT}).")
    ] = None,
    browser: Annotated[
        bool | None, typer.Option("--browser/--no-browser", help="Open the page in a browser, as is done unasked.")
    ] = None,
    connect: Annotated[str | None, typer.Option(help=f"Endpoint of the recorder (--live; {DEFAULT_ENDPOINT}).")] = None,
    network_config: NetworkConfig = None,
    overrides: Overrides = [],
    force: Force = False,
) -> None:
    """Show a run in 3D: arms, object, desired pose, forces, events; in a browser, or as a file."""
    from agent.atomic import require_place
    from agent.view.error import ViewError
    from agent.view.need import need_viser

    if sum((live, html is not None, film is not None)) > 1:
        raise ViewError("coop view", found="several of --live, --html, --film", expected="one", remedy="call it twice")
    _require_use(
        live=live, html=html is not None, film=film is not None,
        of_live={
            "--connect": connect is not None, "--network-config": network_config is not None, "--set": bool(overrides),
        },
        of_film={"--from": start is not None, "--to": end is not None, "--speed": speed is not None},
        of_page={"--port": port is not None, "--browser": browser is True},
    )  # fmt: skip
    require_place(*filter(None, (html, film)), force=force)
    if film is not None:
        _film(what, film, start or 0.0, end, PACE if speed is None else speed)
    elif html is not None:
        need_viser()
        _html(what, html)
    else:
        need_viser()
        opens = browser is not False
        _serve(what, live, port or PORT, opens, connect or DEFAULT_ENDPOINT, network_config, overrides)


def _require_use(
    *, live: bool, html: bool, film: bool, of_live: Mapping[str, bool], of_film: Mapping[str, bool],
    of_page: Mapping[str, bool],
) -> None:  # fmt: skip
    """Raise ViewError for an option that would change nothing; by option, whether it was given."""
    from agent.view.error import ViewError

    if not live:
        require_use(
            of_live, ViewError, found="a view without --live", expected="a run as it goes on", remedy="add --live"
        )
    if not film:
        require_use(of_film, ViewError, found="a view without --film", expected="a film", remedy="add --film")
    if html or film:
        found = f"a view with {'--html' if html else '--film'}"
        require_use(of_page, ViewError, found=found, expected="a page that is served")


def _film(log: Path, film: Path, start: float, end: float | None, speed: float) -> None:
    from agent.log.read import open_log
    from agent.report.prepared import prepare
    from agent.view.film import FilmOptions, write_film
    from agent.view.staged import NEEDS

    with Steps() as step:
        step("reading the log")
        with open_log(log, needs=NEEDS) as opened:
            run = prepare(opened)
            step("drawing")
            count = write_film(run, FilmOptions(film, start, end, speed))
    _tell(opened)
    typer.echo(f"film     {film}, {count} pictures")


def _html(log: Path, html: Path) -> None:
    from agent.log.read import open_log
    from agent.report.prepared import prepare
    from agent.view.html import write_html
    from agent.view.staged import NEEDS

    with Steps() as step:
        step("reading the log")
        with open_log(log, needs=NEEDS) as opened:
            run = prepare(opened)
            step("drawing")
            count = write_html(run, html)
    _tell(opened)
    typer.echo(f"page     {html}, {count} pictures")


def _tell(log: AnyLog) -> None:
    for problem in log.remarks:
        note(f"{log.path}: {problem}")


def _serve(
    what: Path, live: bool, port: int, browser: bool, connect: str, network_config: Path | None, overrides: list[str]
) -> None:
    from agent.host.signals import StopFlag

    requested = StopFlag(suspends=True)
    if live:
        _serve_live(what, port, browser, requested, connect, network_config, overrides)
    else:
        _serve_log(what, port, browser, requested)


def _serve_log(log: Path, port: int, browser: bool, requested: Callable[[], bool]) -> None:
    from agent.log.collect import require_log
    from agent.view.server import Server

    require_log(log)
    server = Server(port, f"Run {log.name}")
    try:
        if browser:
            _browse(server.address)  # it loads the page while the log is read
        from agent.view.open import serve

        pictures = serve(log, server, requested, lambda: ready(pairs(page=server.address)), note)
    finally:
        server.stop()
    note(f"{log}: {pictures} pictures shown")


def _browse(address: str) -> None:
    import threading
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some return when they are closed


def _serve_live(
    what: Path, port: int, browser: bool, requested: Callable[[], bool], connect: str, network_config: Path | None,
    overrides: list[str],
) -> None:  # fmt: skip
    from agent.config.files import load_files
    from agent.telemetry.link.session import Network, Role
    from agent.view.live import serve as serve_live

    def opened(address: str) -> None:
        ready(pairs(page=address))
        if browser:
            _browse(address)

    network = Network(config_file=network_config) if network_config else Network(connect=(connect,), role=Role.VIEWER)
    done = serve_live(load_files(what, overrides), network, port, requested, opened)
    note(f"{what}: {done.pictures} pictures shown{done.behind}, {done.refused} messages refused")
