"""A line beside a loop: on a terminal, without waiting for one, and nowhere else."""

from __future__ import annotations

import os
import sys
import termios
from pathlib import Path

import pytest

from agent.host.aside import Aside


def test_a_line_is_on_the_terminal_and_is_lost_where_that_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    own, theirs = os.openpty()
    os.set_blocking(own, False)
    with os.fdopen(theirs, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        aside = Aside()
        assert os.get_blocking(theirs), "others who write there wait as before"
        aside("arm left holds")
        assert os.read(own, 100) == b"arm left holds\r\n"
        termios.tcflow(theirs, termios.TCOOFF)  # Ctrl-S
        for _ in range(10_000):
            aside("arm left holds")
        termios.tcflow(theirs, termios.TCOON)
        aside("and goes on")
        assert os.read(own, 100) == b"and goes on\r\n"
    os.close(own)
    aside("nobody is there any more")


def test_there_is_no_line_in_a_file_that_a_loop_would_wait_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "words").open("w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        Aside()("arm left holds")
    assert (tmp_path / "words").read_text() == ""
    Aside()("of a stream that is closed")
