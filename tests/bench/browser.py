"""A run in the browser: until the first picture is there, and pictures while the slider is dragged.

Chromium draws without a graphics card here, so figures by the wall want a machine that does little else.  What a
picture of an empty page costs, of the same size and under the same hand, is the baseline of what one of a run costs.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.bench.common import Figure
from tests.support.coop import COOP
from tests.support.drawn import Drawn, browser_cpu_s, drawn, pictures

NAMES = ("view_first_picture", "scrub_pictures", "scrub_cpu_per_picture")
RUN_S = 100
FIRST_PICTURE_S, SCRUB_PER_S = 3.0, 20.0  # what must hold
DRAG_S, SWEEP_S, MOVES_HZ = 8.0, 4.0, 60.0  # how long the slider is dragged, once along it, what the hand does
SETTLED_S, PATIENCE_S = 3.0, 90.0
SLIDER = "[class*=Slider-root]"
DRAWS = 15  # at least, of a frame with both arms in it

EMPTY = """
import signal, sys
from agent.view.server import Server
server = Server(int(sys.argv[1]), "empty")
server.scene.configure_environment_map(None)
server.scene.configure_default_lights(True, cast_shadow=False)
node = server.scene.add_frame("/nothing", axes_length=1e-6, axes_radius=1e-6)
slider = server.gui.add_slider("time [s]", 0.0, 100.0, 0.05, 0.0)
@slider.on_update
def _(_):
    node.position = (1e-6 * slider.value, 0.0, 0.0)
signal.sigwait({signal.SIGTERM})
"""


def bench() -> dict[str, Figure]:
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        run = ("run", "paper", "--duration", str(RUN_S), "--no-report", "--out", str(folder / "out"))
        subprocess.run([*COOP, *run], check=True, capture_output=True)
        view = [*COOP, "view", str(folder / "out" / "run.mcap"), "--no-browser", "--port"]
        first_s, per_s, cpu_ms = seen(folder / "run", view, DRAWS)
        _, _, empty_ms = seen(folder / "empty", [sys.executable, "-c", EMPTY], 1)
    return {
        "view_first_picture": Figure(first_s, "s", FIRST_PICTURE_S),
        "scrub_pictures": Figure(per_s, "1/s", SCRUB_PER_S),
        "scrub_cpu_per_picture": Figure(cpu_ms, "ms", empty_ms),
    }


def seen(folder: Path, command: list[str], draws: int) -> tuple[float, float, float]:
    """Seconds from a command's start to its first whole picture, pictures a second under a drag, CPU ms of each."""
    with drawn(folder) as browser, served(command) as page:
        browser.page.open(page.address)
        first_s = first(browser, draws) - page.begin_s
        time.sleep(SETTLED_S)
        browser.frames()
        cpu_s, begin = browser_cpu_s(folder), time.monotonic()
        drag(browser)
        took_s, shown = time.monotonic() - begin, pictures(browser.frames())
        return first_s, shown / took_s, 1e3 * (browser_cpu_s(folder) - cpu_s) / max(1, shown)


@dataclass(frozen=True)
class Served:
    """A page that can be loaded."""

    address: str
    begin_s: float  # since 1970, of the command
    process: psutil.Process

    def cpu_s(self) -> float:
        """What the command has spent."""
        return float(sum(self.process.cpu_times()[:2]))


@contextmanager
def served(command: list[str]) -> Iterator[Served]:
    """The page of a command, as soon as it can be loaded."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    begin_s = time.time()
    process = subprocess.Popen([*command, str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        patiently(lambda: listens(port))
        yield Served(f"http://127.0.0.1:{port}", begin_s, psutil.Process(process.pid))
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def first(browser: Drawn, draws: int) -> float:
    """The time, s since 1970, of the first frame in which so much is drawn."""
    found: list[float] = []

    def look() -> bool:
        found.extend(frame.utc_ms / 1e3 for frame in browser.frames() if frame.draws >= draws)
        return bool(found)

    patiently(look)
    return found[0]


def drag(browser: Drawn) -> None:
    """Take the slider along and back again."""
    x, y, width, height = browser.place(SLIDER)
    y += height / 3
    browser.mouse("mousePressed", x + 1, y)
    begin = time.monotonic()
    while (since := time.monotonic() - begin) < DRAG_S:
        way = (since / SWEEP_S) % 2.0
        at = x + 1 + (width - 2) * min(way, 2.0 - way)
        browser.mouse("mouseMoved", at, y)
        time.sleep(1.0 / MOVES_HZ)
    browser.mouse("mouseReleased", at, y)


def patiently(good: Callable[[], bool]) -> None:
    """Look until it is so; raises TimeoutError."""
    end = time.monotonic() + PATIENCE_S
    while not good():
        if time.monotonic() > end:
            raise TimeoutError("a page that does not come measures nothing")
        time.sleep(0.02)
