"""The server of a page, on this host alone; it needs nothing of a run, so a browser can load the page meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
from collections.abc import Mapping
from typing import Final

import viser

from agent.view.error import ViewError

LOOPBACK: Final = "127.0.0.1"


class Server(viser.ViserServer):
    """viser on this host alone: it opens no tunnel, whoever asks."""

    def __init__(self, port: int, label: str) -> None:
        """Raises ViewError when nobody can listen at `port`."""
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # a client that goes away is no error
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # it prints a panel that is ours to write
                super().__init__(LOOPBACK, port, label, verbose=False)
        except (OSError, RuntimeError) as error:
            raise ViewError(
                f"cannot listen at {LOOPBACK}:{port}", found=str(error), expected="a free port",
                remedy="name another one with --port",
            ) from error  # fmt: skip
        self.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.gui.main_panel.dock_right()

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{self.get_host()}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002 (as viser has it)
        """Nobody gets an address on the internet."""
        return None

    def stop(self) -> None:
        """End it at once, without the line that it prints; left to itself it waits 6 s for a browser's connections."""
        loop = self._websock_server._background_event_loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(_drop_connections, loop)
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def _drop_connections(loop: asyncio.AbstractEventLoop) -> None:
    """Cut every connection; runs in the loop's thread."""
    transports: Mapping[int, asyncio.Transport] = getattr(loop, "_transports", {})  # by descriptor
    for transport in list(transports.values()):
        transport.abort()
