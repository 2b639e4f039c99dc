"""The processes of a run, by the names that `top` and `pgrep` show: plant, arm-left, recorder, telemetry-left."""

from __future__ import annotations

import contextlib
import subprocess
import time

import psutil

from tests.support.loaded import Loaded


def member(name: str, run: subprocess.Popen[str] | Loaded, timeout_s: float = 30.0) -> psutil.Process:
    """The process of `run` that is called so, once it is there."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and run.poll() is None:
        for process in psutil.Process(run.pid).children():
            with contextlib.suppress(psutil.NoSuchProcess):  # one that ended meanwhile
                if process.name() == name:
                    return process
        time.sleep(0.02)
    raise AssertionError(f"no member {name!r}: {run.communicate()}")
