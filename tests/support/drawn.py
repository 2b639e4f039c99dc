"""What a page really draws: every frame, what stood in it, and what the browser's processes spent on it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil
from numpy.typing import NDArray

from tests.support.chromium import Page, chromium

# runs before the page's own scripts: the places of all that is drawn, frame by frame
HOOK: Final = """
(() => {
  const frames = window.__frames = [];
  let places = [], drawn = 0;
  const gl = WebGL2RenderingContext.prototype, matrix = gl.uniformMatrix4fv;
  gl.uniformMatrix4fv = function (at, turned, value, ...rest) {
    if (value.length === 16 && value[15] === 1) places.push(value[12], value[13], value[14]);
    return matrix.call(this, at, turned, value, ...rest);
  };
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    const plain = gl[name];
    gl[name] = function (...all) { drawn++; return plain.apply(this, all); };
  }
  const look = () => {
    if (drawn) frames.push([performance.timeOrigin + performance.now(), drawn, places]);
    [places, drawn] = [[], 0];
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""


@dataclass(frozen=True)
class Frame:
    """One that was drawn."""

    utc_ms: float
    draws: int
    places: NDArray[np.float64]  # (k, 3) m before the camera


class Drawn:
    """A page whose frames are kept."""

    def __init__(self, page: Page) -> None:
        self.page = page
        page.call("Page.addScriptToEvaluateOnNewDocument", source=HOOK)

    def frames(self) -> list[Frame]:
        """Those since the last call."""
        told = json.loads(self.page.run("JSON.stringify((window.__frames ?? []).splice(0))") or "[]")
        return [Frame(utc_ms, draws, np.reshape(places, (-1, 3))) for utc_ms, draws, places in told]

    def place(self, selector: str) -> tuple[float, float, float, float]:
        """Where an element of the page is: x, y, width, height."""
        found = self.page.run(f"JSON.stringify(document.querySelector('{selector}')?.getBoundingClientRect() ?? null)")
        at: dict[str, Any] = json.loads(found)
        return at["x"], at["y"], at["width"], at["height"]

    def mouse(self, what: str, x: float, y: float) -> None:
        """The left button: mousePressed, mouseMoved, mouseReleased."""
        self.page.call("Input.dispatchMouseEvent", type=what, x=x, y=y, button="left", buttons=1, clickCount=1)


def pictures(frames: list[Frame]) -> int:
    """How many frames differ from the one before."""
    return sum(a.places.shape != b.places.shape or not np.array_equal(a.places, b.places) for a, b in pairwise(frames))


@contextmanager
def drawn(folder: Path) -> Iterator[Drawn]:
    """A new browser; skips the test where there is none."""
    with chromium(folder) as page:
        yield Drawn(page)


def browser_cpu_s(folder: Path) -> float:
    """User and system time of the browser whose data are in a folder, all its processes."""
    word, spent = f"--user-data-dir={folder}", 0.0
    for process in psutil.process_iter(["cmdline", "ppid", "pid"]):
        if word in (process.info["cmdline"] or ()) and "--type" not in " ".join(process.info["cmdline"]):
            for each in (process, *process.children(recursive=True)):
                spent += sum(each.cpu_times()[:2])
    return spent
