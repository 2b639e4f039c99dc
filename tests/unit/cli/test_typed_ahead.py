"""What was typed before a question of `coop` is no answer to it, whichever command asks."""

from __future__ import annotations

import os
import re
import sys
import termios
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support.command import coop

AGENT = Path(__file__).parents[3] / "agent"
SETUP = ("motors", "setup", "--port", "/dev/null", "--arm-model", "wx200", "--joint", "waist")
MARK = ("motors", "mark", "two_wx200", "--arm", "left")


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A person at a terminal who has typed yes already, and types no once they are asked."""
    ours, theirs = os.openpty()
    os.write(ours, b"y\n")
    flush = termios.tcflush

    def asked(terminal: object, queue: int) -> None:
        flush(theirs, queue)
        os.write(ours, b"n\n")

    monkeypatch.setattr(termios, "tcflush", asked)
    with os.fdopen(theirs) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield
    os.close(ours)


@pytest.mark.parametrize("command", [SETUP, MARK])
def test_a_servo_is_not_written_to_by_a_yes_from_before_it_was_shown(
    command: tuple[str, ...], hasty: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    change = SimpleNamespace(register=SimpleNamespace(name="ID"), found=1, wanted=2, line="ID: 1 → 2")
    servos = SimpleNamespace(port="/dev/null", baud=1, mark=SimpleNamespace(own=1))
    monkeypatch.setattr("agent.motors.line.open_line", lambda *_: nullcontext())
    monkeypatch.setattr("agent.motors.setup.plan_setup", lambda *_: SimpleNamespace(title="one", changes=[change]))
    monkeypatch.setattr("agent.motors.mark.marked", lambda *_: servos)
    monkeypatch.setattr("agent.motors.mark.plan_mark", lambda *_, **__: [change])
    monkeypatch.setattr("agent.motors.mark.lit", lambda *_: nullcontext())
    for write in ("setup.apply_setup", "mark.apply_mark"):
        monkeypatch.setattr(f"agent.motors.{write}", lambda *_: pytest.fail("it is written"))
    done = coop(*command)
    assert (done.code, done.err.endswith("[y/N]:coop: stopped at a question\n")) == (1, True)


def test_every_yes_is_asked_for_in_one_place() -> None:
    asking = {
        path.relative_to(AGENT).as_posix()
        for path in AGENT.rglob("*.py")
        if re.search(r"\bconfirm\(|\binput\(|\b(Confirm|Prompt)\.ask\b", path.read_text())
    }
    assert asking == {"cli/options.py"}
