"""`coop view RUN.mcap`: the page of a recorded run, served to this host alone until a stop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from agent.log.read import open_log
from agent.report.moments import moments_of
from agent.report.prepared import prepare
from agent.view.browser import Nodes, Server
from agent.view.motion import PICTURES_HZ
from agent.view.player import Player
from agent.view.staged import stage

VIEW_PX: Final = (880, 720)  # beside the controls


def serve(log: Path, port: int, stop: Callable[[], bool], ready: Callable[[str], None]) -> int:
    """Serve the page of a log; `ready` is told its address.  Returns how many pictures were shown.  Raises Refusal."""
    with open_log(log) as opened:
        run = prepare(opened)
        staged = stage(run, PICTURES_HZ)
        moments = moments_of(run)
    server = Server(port, f"Run of {run.info.cell}")
    try:
        player = Player(server, Nodes(server, staged.scene, staged.camera(VIEW_PX)), staged, moments)
        player.step()
        ready(f"http://{server.get_host()}:{server.get_port()}")
        while not stop():
            player.step()
    finally:
        server.stop()
    return player.pictures
