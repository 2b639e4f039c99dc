"""What the machine did to a run in real time: a control loop at 200 Hz says nothing on one that stops for 50 ms."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.log.read import RunLog
from agent.safety import Flag

ATTEMPTS = 3  # a run that the machine stalled is repeated
WAITED, STOLEN = 0.25, 0.02  # beyond these shares a process that others must hear in time is not to blame


class Stalled(Exception):
    """This machine did not let the processes run."""


class Kernel:
    """By the kernel's account: whether a process got the cores that it asked for since this was made."""

    def __init__(self) -> None:
        self._stolen_s, self._since_s = _stolen_s(), time.monotonic()

    def accuses(self, pid: int) -> str:
        """Why the process could not keep the pace of a clock; empty where it could."""
        ran, waited = 0, 0
        for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            words = thread.read_text().split()
            ran, waited = ran + int(words[0]), waited + int(words[1])
        if waited > WAITED * (ran + waited):
            return f"it waited {waited * 1e-9:.1f} s for a core and had one for {ran * 1e-9:.1f} s"
        stolen_s = _stolen_s() - self._stolen_s
        if stolen_s > STOLEN * (time.monotonic() - self._since_s):
            return f"the host of this machine took {stolen_s:.1f} s"
        return ""


def _stolen_s() -> float:
    """Of all cores, since the machine began."""
    return int(Path("/proc/stat").read_text().split()[8]) / 100.0


def despite_stalls(test: Callable[[Path], None]) -> Callable[[Path], None]:
    """A test in a folder, which is repeated in a new one when it raises `Stalled`, and skipped when it always does."""

    @functools.wraps(test)
    def repeated(tmp_path: Path) -> None:
        whys = []
        for attempt in range(ATTEMPTS):
            folder = tmp_path / str(attempt)
            folder.mkdir()
            try:
                return test(folder)
            except Stalled as why:
                whys.append(str(why))
        pytest.skip(f"this machine stalled in each of {ATTEMPTS} runs: {'; '.join(whys)}")

    return repeated


def stalled(log: RunLog, before_s: float = float("inf")) -> str:
    """What the machine, not the software, did until then: two periods late, or the emulator silent for as long."""
    for arm, rows in log.agents.items():
        early = rows[rows["t"] < before_s]
        lost = early["flags"] & Flag.STALE.value != 0
        if (lost[:-2] & lost[1:-1] & lost[2:]).any():
            return f"{arm}: three cycles in a row without a reply"
        if early["late_s"].max(initial=0.0) > 0.01:
            return f"{arm}: a cycle {early['late_s'].max() * 1e3:.0f} ms late"
    return ""
