"""The command `coop` as a person types it: a process of its own, its output and its exit code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import configs

COOP = (sys.executable, "-m", "agent.cli")
PAPER = configs.CELLS_DIR / "paper.toml"
TIMEOUT_S = 240.0  # less than a test's own


def coop(*arguments: str | Path | float, cwd: Path | None = None, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    command = [*COOP, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, input=stdin, capture_output=True, text=True, timeout=TIMEOUT_S)


def start(*arguments: str | Path | float, cwd: Path) -> subprocess.Popen[str]:
    """Start a command, in a session of its own."""
    return subprocess.Popen(
        [*COOP, *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ready(process: subprocess.Popen[str]) -> str:
    """The line with which a process says that it is ready."""
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("READY"), process.communicate()
    return line
