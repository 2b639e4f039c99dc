"""A headless Chromium, driven over its DevTools protocol: opens a page, tells what it fetched, takes pictures of it."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import ClientConnection, connect

NAMES: Final = ("chromium", "chromium-browser", "google-chrome")
START_S: Final = 60.0
Pixels = NDArray[np.uint8]
_OPTIONS: Final = (
    "--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions", "--disable-background-networking",
    "--disable-component-update", "--disable-dev-shm-usage", "--hide-scrollbars", "--disable-sync",
)  # fmt: skip


class Page:
    """One tab; `requests` are the addresses it asked for."""

    def __init__(self, socket: ClientConnection, size: tuple[int, int]) -> None:
        self.requests: list[str] = []
        self._socket, self._number, self._size = socket, 0, size
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def call(self, method: str, **params: Any) -> Any:
        answer = self._ask(method, **params)
        assert "error" not in answer, answer
        return answer["result"]

    def _ask(self, method: str, **params: Any) -> Any:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=START_S))
            if answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])
            if answer.get("id") == self._number:
                return answer

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def picture(self) -> Pixels:
        """Height × width × 3; black while the browser goes from one page to the next."""
        answer = self._ask("Page.captureScreenshot", format="png")
        if "error" in answer:
            return np.zeros((*self._size[::-1], 3), np.uint8)
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(answer["result"]["data"]))).convert("RGB"))

    def wait(self, good: Callable[[Pixels], bool], timeout_s: float = 90.0) -> Pixels:
        """The first picture that is good; the last one when there was none in time."""
        end_s = time.monotonic() + timeout_s
        while True:
            seen = self.picture()
            if good(seen) or time.monotonic() > end_s:
                return seen
            time.sleep(0.2)


@contextmanager
def chromium(folder: Path, size: tuple[int, int] = (1280, 720)) -> Iterator[Page]:
    """A page of a new browser; skips the test where there is no browser."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip(f"no browser to look through: none of {', '.join(NAMES)}")
    command = [program, *_OPTIONS, f"--user-data-dir={folder}", "about:blank"]
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with connect(_page_address(folder, browser), max_size=None, open_timeout=START_S) as socket:
            yield Page(socket, size)
    finally:
        browser.terminate()
        browser.wait()


def _page_address(folder: Path, browser: subprocess.Popen[bytes]) -> str:
    """Where the first tab listens.  Raises AssertionError when the browser does not start."""
    told, end_s = folder / "DevToolsActivePort", time.monotonic() + START_S
    while not (told.exists() and len(told.read_text().split()) == 2):
        assert browser.poll() is None, "the browser ended"
        assert time.monotonic() < end_s, "the browser does not start"
        time.sleep(0.05)
    port, path = told.read_text().split()
    with connect(f"ws://127.0.0.1:{port}{path}", open_timeout=START_S) as socket:
        socket.send(json.dumps({"id": 1, "method": "Target.getTargets"}))
        while (answer := json.loads(socket.recv(timeout=START_S))).get("id") != 1:
            pass
    page = next(t for t in answer["result"]["targetInfos"] if t["type"] == "page")
    return f"ws://127.0.0.1:{port}/devtools/page/{page['targetId']}"
