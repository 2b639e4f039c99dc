"""What the machine did to a run in real time: a control loop at 200 Hz says nothing on one that stops for 50 ms."""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.cycles import WINDOW, Patience
from agent.log.read import LogError, RunLog, read_log
from agent.safety import Flag

ATTEMPTS = 3  # a run that the machine stalled is repeated
# Beyond these shares a process that others must hear in time is not to blame: of the time in which it could have run it
# waited for a core; of all time somebody waited for one; of all time the host of a virtual machine took it away.
WAITED, SOMEBODY_WAITED, STOLEN = 0.25, 0.5, 0.02
PERIOD_NS = 5_000_000
MISSED = round((1.0 - Patience.success_min) * WINDOW)  # above it a real arm holds; one of the emulator goes on
PAUSE = Patience.gap  # periods; what took as long is no slowness: a process that ended, or one that a test stopped
CROWD = 4.0  # processes for each core; `make test` by itself has about two


class Stalled(Exception):
    """This machine did not let the processes run."""


class Kernel:
    """By the kernel's account: whether there were cores for who asked for them since this was made."""

    def __init__(self) -> None:
        self._waited_s, self._stolen_s, self._since_s = _somebody_waited_s(), _stolen_s(), time.monotonic()

    def accuses(self, pid: int | None = None) -> str:
        """Why the process, or any, could not keep the pace of a clock; empty where it could."""
        passed_s = time.monotonic() - self._since_s
        ran, waited = (0, 0) if pid is None else _ran_and_waited_ns(pid)
        if waited > WAITED * (ran + waited):
            return f"a process waited {waited * 1e-9:.1f} s for a core and had one for {ran * 1e-9:.1f} s"
        waited_s = _somebody_waited_s() - self._waited_s
        if pid is None and waited_s > SOMEBODY_WAITED * passed_s:
            return f"in {waited_s:.1f} s of {passed_s:.1f} s somebody waited for a core"
        stolen_s = _stolen_s() - self._stolen_s
        if stolen_s > STOLEN * passed_s:
            return f"the host of this machine took {stolen_s:.1f} s of {passed_s:.1f} s"
        return ""

    @contextlib.contextmanager
    def heard(self, pid: int) -> Iterator[None]:
        """What fails in the block raises Stalled where the process had no core."""
        try:
            yield
        except (AssertionError, subprocess.TimeoutExpired) as error:
            if why := self.accuses(pid):
                raise Stalled(why) from error
            raise


def _ran_and_waited_ns(pid: int) -> tuple[int, int]:
    """How long the threads of a process had a core, and how long they could have used one."""
    ran, waited = 0, 0
    for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        words = thread.read_text().split()
        ran, waited = ran + int(words[0]), waited + int(words[1])
    return ran, waited


def _somebody_waited_s() -> float:
    """Since the machine began; nothing where its kernel does not say."""
    try:
        return int(Path("/proc/pressure/cpu").read_text().splitlines()[0].rpartition("=")[2]) * 1e-6
    except OSError:
        return 0.0


def _stolen_s() -> float:
    """Of all cores, since the machine began."""
    return int(Path("/proc/stat").read_text().split()[8]) / 100.0


def crowded() -> str:
    """Whether so many processes want each core that none beside them keeps the pace of a clock; empty where not."""
    each = os.getloadavg()[0] / (os.cpu_count() or 1)
    return f"{each:.1f} processes want each core" if each > CROWD else ""


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
    return stalled_rows(log.agents, before_s)


def stalled_rows(agents: Mapping[str, NDArray[np.void]], before_s: float = float("inf")) -> str:
    """The same of the rows of each arm."""
    for arm, rows in agents.items():
        early = rows[rows["t"] < before_s]
        lost = early["flags"] & Flag.STALE.value != 0
        if (lost[:-2] & lost[1:-1] & lost[2:]).any():
            return f"{arm}: three cycles in a row without a reply"
        if early["late_s"].max(initial=0.0) > 0.01:
            return f"{arm}: a cycle {early['late_s'].max() * 1e3:.0f} ms late"
    return ""


def slow_rows(agents: Mapping[str, NDArray[np.void]]) -> str:
    """So many cycles left out that arms may fall off their ways: what excuses a run that ended, and no other."""
    for arm, rows in agents.items():
        since = np.rint(np.diff(rows["stamp_ns"].astype(np.int64)) / PERIOD_NS).astype(int)
        missed = (rows["flags"] & Flag.STALE.value != 0)[1:] + np.where((since > 1) & (since < PAUSE), since - 1, 0)
        most = max((missed[k : k + WINDOW].sum() for k in range(len(missed))), default=0)
        if most > MISSED:
            return f"{arm}: {most} cycles beside {WINDOW} without a state"
    return ""


def stalled_in(path: Path) -> str:
    """What the machine did to a run that ended; its file may hold nothing: it did not begin."""
    try:
        log = read_log(path)
    except LogError:
        return ""
    return stalled(log) or slow_rows(log.agents)
