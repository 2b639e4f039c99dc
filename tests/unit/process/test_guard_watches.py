"""How long the guard process waits for rows of the agent that it was told to watch; its own looks, time by hand."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.guard.agent_end import AgentEnd
from agent.guard.line import Word
from agent.guard.pulse import Pulse
from agent.host.signals import StopFlag
from agent.process import guard
from agent.process.commands import GuardOptions
from agent.process.schedule import guard_vigil
from agent.process.tellers import opened
from agent.telemetry.ring.writer import RingWriter
from tests.support.few import long

MS = 1_000_000
LOOK_MS = 2
WORKS, FLOATS = list[str](), ['floating.arms=["left"]']


class Clock:
    """What the guard's looks take for the time."""

    def __init__(self) -> None:
        self.now_ms = 1000
        self.sleep = lambda _: None

    def monotonic_ns(self) -> int:
        return self.now_ms * MS


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Of a guard whose arm and driver are stood for."""
    clock = Clock()
    monkeypatch.setattr(guard, "time", clock)
    monkeypatch.setattr(guard, "quiet_memory", lambda: None)
    monkeypatch.setattr(guard, "_q_start", lambda *_: np.zeros(3))
    monkeypatch.setattr(guard, "build_standby", lambda *_: SimpleNamespace(drop=lambda: None))
    return clock


@pytest.fixture
def port() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def agent() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(["sleep", "100"]) as process:
        yield process
        process.kill()


def watching(
    stack: ExitStack, folder: Path, port: str, more: list[str], emulated: bool, pid: int
) -> tuple[guard._Guard, RingWriter, AgentEnd]:
    """A guard that has just been told to watch that process, the ring that it reads, and the line to it."""
    cell = load_cell(Path("two_wx200"), more)
    texts, ring = opened(stack, folder / "left.ring", cell.arm("left"))
    options = GuardOptions(
        cell=Path(), arm="left", driver=DriverKind.DYNAMIXEL, port=port, emulated=emulated, socket=folder / "socket",
        control=None, post_mortem=folder, hold=True,
    )  # fmt: skip
    made = guard._Guard(cell, options, StopFlag(), stack)
    end = AgentEnd(folder / "socket", cell.fingerprint)
    stack.callback(end.close)
    pidfd = os.pidfd_open(pid)
    with closing(Pulse.made()) as pulse:
        end.say(Word.WATCH, (pidfd, pulse.fileno(), ring.fileno(), texts.fileno()), ring="left.ring", driver={})
    os.close(pidfd)
    assert made._look() == ""
    assert end.heard() == {"ok": True, "to": "watch"}
    return made, ring, end


@pytest.mark.usefixtures("clock")
def test_a_guard_is_there_for_its_agent_once_its_memory_is_locked(
    tmp_path: Path, port: str, agent: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which takes a second or more, and its agent waits two for an answer."""
    there = list[bool]()
    monkeypatch.setattr(guard, "quiet_memory", lambda: there.append((tmp_path / "socket").exists()))
    with ExitStack() as stack:
        watching(stack, tmp_path, port, [], emulated=False, pid=agent.pid)
        assert (tmp_path / "socket").is_socket()
    assert there == [False]


@pytest.mark.fault("P2")
@pytest.mark.parametrize(
    ("more", "emulated", "first_ms", "then_ms"),
    [(WORKS, False, 100, 18), (WORKS, True, 150, 150), (FLOATS, False, 500, 100), (FLOATS, True, 500, 500)],
)
@pytest.mark.parametrize("rows", [0, 1])
def test_a_guard_waits_longer_for_the_first_row_than_for_the_next(
    tmp_path: Path, port: str, agent: subprocess.Popen[bytes], clock: Clock,
    more: list[str], emulated: bool, first_ms: int, then_ms: int, rows: int,
) -> None:  # fmt: skip
    with ExitStack() as stack:
        made, ring, _ = watching(stack, tmp_path, port, more, emulated, agent.pid)
        for _ in range(rows):
            ring.commit()
            assert made._look() == ""
        clock.now_ms, waited_ms = clock.now_ms + 1000, 2 * LOOK_MS  # a host that stalls: nobody looked meanwhile
        while not (reason := made._look()):
            assert agent.poll() is None
            assert waited_ms < 1000
            clock.now_ms, waited_ms = clock.now_ms + LOOK_MS, waited_ms + LOOK_MS
    expected_ms = then_ms if rows else first_ms
    assert reason == f"the agent hung (no row for {expected_ms} ms) and was ended"
    assert agent.wait() == -signal.SIGKILL
    assert waited_ms == expected_ms


@pytest.mark.parametrize("for_s", ["soon", *map(long, (None, [], float("inf"))), float("nan"), 10**400])
def test_a_moment_that_is_none_is_refused_and_ends_no_guard(
    tmp_path: Path, port: str, agent: subprocess.Popen[bytes], clock: Clock, for_s: object
) -> None:
    with ExitStack() as stack:
        made, _, end = watching(stack, tmp_path, port, WORKS, emulated=False, pid=agent.pid)
        end.say(Word.BUSY, for_s=for_s)
        assert made._look() == ""
        answer = end.heard()
    assert answer is not None
    assert (answer["ok"], answer["remedy"]) == (False, "start agent and guard from one release")


@pytest.mark.fault("P7")
@pytest.mark.parametrize(
    ("driver", "emulated", "stale_ms"),
    [(DriverKind.DYNAMIXEL, False, 200), (DriverKind.DYNAMIXEL, True, 500), (DriverKind.SIM, False, 500)],
)
def test_an_agent_bears_more_of_its_guard_where_its_arm_is_none(
    tmp_path: Path, driver: DriverKind, emulated: bool, stale_ms: int
) -> None:
    options = GuardOptions(
        cell=Path(), arm="left", driver=driver, emulated=emulated, socket=tmp_path / "socket", control=None,
        post_mortem=tmp_path, hold=True,
    )  # fmt: skip
    made = guard_vigil(load_cell(Path("two_wx200")), shared=options.shared)()
    assert (made.stale_ns, made.look_ns) == (stale_ms * MS, 5 * MS)
