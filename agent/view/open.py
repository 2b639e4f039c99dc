"""`coop view RUN.mcap`: the page of a recorded run, served until a stop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agent.log.read import open_log
from agent.report.moments import moments_of
from agent.report.prepared import prepare
from agent.view.browser import PAGE_PX, Nodes
from agent.view.motion import PICTURES_HZ
from agent.view.player import Player
from agent.view.server import Server
from agent.view.staged import NEEDS, stage


def serve(
    log: Path, server: Server, stop: Callable[[], bool], ready: Callable[[], None], say: Callable[[str], None]
) -> int:
    """Show a log on a server's page; `ready` is called with the first picture.  Returns how many were shown.

    The server runs before the log is read: a browser needs longer for the page than the log takes.
    `say` is told what is wrong with the log.  Raises Refusal.
    """
    with open_log(log, needs=NEEDS) as opened:
        run = prepare(opened)
        staged = stage(run, PICTURES_HZ)
        moments = moments_of(run)
    for problem in run.log.remarks:
        say(f"{log}: {problem}")
    player = Player(server, Nodes(server, staged.scene, staged.camera(PAGE_PX), titled=False), staged, moments)
    player.step()
    ready()
    while not stop():
        player.step()
    return player.pictures
