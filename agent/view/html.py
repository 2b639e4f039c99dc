"""A run in 3D as one HTML file: it opens from the disk, without a server and without a request."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from agent.atomic import write_atomically
from agent.report.moments import around, moments_of
from agent.report.prepared import Prepared
from agent.view.browser import Nodes
from agent.view.error import ViewError
from agent.view.motion import PICTURES_HZ
from agent.view.server import Server
from agent.view.staged import stage, status_text

VIEW_PX: Final = (1280, 680)  # above the controls
_ANY_PORT: Final = 18080  # viser takes the next free one


def write_html(run: Prepared, path: Path) -> int:
    """Write the whole run; returns how many pictures it has.  Raises Refusal, and leaves an earlier file as it was."""
    found = stage(run, PICTURES_HZ)
    server = Server(_ANY_PORT, f"Run of {run.info.cell}")
    moments = moments_of(run)
    try:
        nodes = Nodes(server, found.scene, found.camera(VIEW_PX))
        record = server.get_scene_serializer()
        for row, t in enumerate(found.motion.t.tolist()):
            nodes.show(found.placed, row, status_text(found.motion, row, around(moments, t)))
            record.insert_sleep(1.0 / PICTURES_HZ)
        page = record.as_html()
    finally:
        server.stop()
    write_atomically(path, page.encode(), ViewError)
    return len(found.motion.t)
