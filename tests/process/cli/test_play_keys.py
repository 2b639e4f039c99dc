"""`coop play` on a real terminal: keys pause, step, seek and end it, and the terminal is as it was."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from agent.cli.keys import Keyboard
from tests.support.coop import COOP
from tests.support.telemetry.log_maker import make_log

ROWS = 6000  # 30 s at 200 Hz
PAUSED = r"([\d.]+) s of 30\.00 s +0\.01x +paused"


@dataclass
class Played:
    """A player on a pseudo terminal."""

    process: subprocess.Popen[bytes]
    terminal: int
    said: str = ""

    def type(self, keys: bytes) -> None:
        os.write(self.terminal, keys)

    def read(self) -> str:
        try:
            self.said += os.read(self.terminal, 4096).decode()
        except (BlockingIOError, OSError):
            time.sleep(0.01)
        return self.said

    def until(self, done: str) -> re.Match[str]:
        end = time.monotonic() + 60.0
        while (found := re.search(done, self.read())) is None:
            assert time.monotonic() < end, self.said
        self.said = self.said[found.end() :]
        return found


@pytest.fixture
def player(tmp_path: Path) -> Iterator[Played]:
    make_log(tmp_path / "run.mcap", ROWS)
    ours, theirs = pty.openpty()
    os.set_blocking(ours, False)
    command = [*COOP, "play", str(tmp_path / "run.mcap"), "--listen", "tcp/127.0.0.1:0", "--speed", "0.01"]
    before = termios.tcgetattr(theirs)
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
    played = Played(process, ours)
    try:
        played.until("READY")
        yield played
        assert termios.tcgetattr(theirs) == before
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(10.0)
        os.close(ours)
        os.close(theirs)


def test_pause_step_seek_and_quit(player: Played) -> None:
    player.type(b" ")
    waiting = player.until(PAUSED)
    here = float(waiting[1])
    player.type(b"\x1b[C\x1b[C")
    assert float(player.until(r"(1\d\.\d\d) s of 30\.00 s")[1]) == pytest.approx(here + 10.0, abs=0.011)
    player.type(b"...")
    assert float(player.until(r"(1\d\.\d\d) s of 30\.00 s")[1]) <= here + 10.03
    player.type(b"\x1b[D")
    assert float(player.until(r"([56]\.\d\d) s of 30\.00 s")[1]) == pytest.approx(here + 5.0, abs=0.03)
    player.type(b"0")
    player.until(r" 0\.00 s of 30\.00 s")
    player.type(b"+")
    player.until(r"0\.02x")
    player.type(b"q")
    told = player.until(r"(\d+) rows and 0 events played, 0 times to the end")
    assert 0 < int(told[1]) < 3 * 1000
    assert player.process.wait(30.0) == 0


def test_ctrl_c_ends_it_as_ever(player: Played) -> None:
    player.until(r"s of 30\.00 s")
    player.process.send_signal(signal.SIGINT)
    player.until("rows and 0 events played")
    assert player.process.wait(30.0) == 0


def test_a_terminal_that_is_gone_is_left_without_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with Keyboard() as keyboard:
            assert keyboard.present
            os.close(ours)
            assert keyboard.orders() == []
            assert not keyboard.present
        with pytest.raises(termios.error):
            termios.tcgetattr(theirs)
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with Keyboard():
            os.close(ours)
