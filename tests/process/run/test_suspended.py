"""Ctrl-Z on a real terminal: what watches over arms is not suspended; it stops as by Ctrl-C."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.config.schema.driver import DriverKind
from agent.log.read import read_log
from agent.modes import Mode
from agent.operator.ask import ask_arms
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.process import recorder
from tests.support.coop import PAPER, TIMEOUT_S, ready, start
from tests.support.few import long
from tests.support.loaded import Loaded
from tests.support.terminal import CTRL_Z, Terminal

ARMS = ("left", "right")


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of all that the processes of a cell share."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("plant", PAPER, "--real-time"), 0),
        (("guard", PAPER, "--arm", "left", "--driver", "sim"), 0),
        long((("emulate", configs.CELLS_DIR / "two_wx200.toml", "--ports", "ports"), 0)),
        long((("telemetry", PAPER, "--member", "left"), 0)),
        (("record", PAPER, "--listen", "tcp/127.0.0.1:0"), 1),  # of which no row came
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_process_of_a_cell_ends_in_order(session: Path, words: tuple[Any, ...], code: int) -> None:
    with Terminal(*words, folder=session) as terminal:
        terminal.until("READY ")
        terminal.type(CTRL_Z)
        assert terminal.end() == code, terminal.shown
        assert "SUSPENDED" not in terminal.shown


def test_an_agent_holds_its_arm(session: Path) -> None:
    plant = Loaded("plant", PAPER, "--real-time", cwd=session)
    assert plant.stdout.readline().startswith("READY")
    other = Loaded("agent", PAPER, "--arm", "right", "--real-time", "--hold", cwd=session)
    controls = {arm: [session / "coop" / "paper" / f"{arm}.control"] for arm in ARMS}
    try:
        with Terminal("agent", PAPER, "--arm", "left", "--real-time", "--hold", folder=session) as terminal:
            terminal.until("torque=on")
            terminal.type(CTRL_Z)
            deadline = time.monotonic() + TIMEOUT_S
            mode = ""
            while mode != Mode.HOLD.name:
                assert time.monotonic() < deadline, terminal.shown
                heard = ask_arms(controls, Request(Verb.STATUS))["left"]
                assert isinstance(heard, Reply), (heard, terminal.shown)
                mode = heard.mode
            ask_arms(controls, Request(Verb.RELEASE))
            assert terminal.end() == 0, terminal.shown
            assert "SUSPENDED" not in terminal.shown
            stopped = "arm left: SIGTSTP: Ctrl-Z: stops; what has its torque on is held by this process until"
            assert terminal.shown.count(stopped) == 1
            assert "no guard" not in terminal.shown, "nothing can fall"
    finally:
        for process in (other, plant):
            process.kill()
            process.communicate()


@pytest.mark.realtime
def test_nor_do_servos_miss_their_agent(session: Path) -> None:
    """The real driver and loop on emulated servos, whose watchdogs a suspended agent would let fire."""
    cell = configs.CELLS_DIR / "two_wx200.toml"
    servos = start("emulate", cell, "--ports", "ports", cwd=session)
    ready(servos)
    control = {"left": [session / "coop" / "two_wx200" / "left.control"]}
    words = ("--driver", "dynamixel", "--emulated", "--port", session / "ports" / "left", "--hold")
    try:
        with Terminal("agent", cell, "--arm", "left", *words, folder=session) as terminal:
            terminal.until("torque=on")
            terminal.type(CTRL_Z)
            heard = ask_arms(control, Request(Verb.STATUS))["left"]
            while isinstance(heard, Reply) and heard.mode == Mode.READY.name:
                heard = ask_arms(control, Request(Verb.STATUS))["left"]
            assert isinstance(heard, Reply), (heard, terminal.shown)
            assert heard.mode == Mode.HOLD.name
            ask_arms(control, Request(Verb.RELEASE))
            assert terminal.end() == 0, terminal.shown
            assert "SUSPENDED" not in terminal.shown
    finally:
        servos.terminate()
        said = "".join(servos.communicate())
    assert "fired" not in said


@pytest.mark.long  # SIGTERM is in test_run_stopped.py
def test_a_run_keeps_its_log(session: Path) -> None:
    with Terminal("run", PAPER, "--duration", "1000", "--no-report", "--out", "out", folder=session) as terminal:
        terminal.until("x real time")
        terminal.type(CTRL_Z)
        assert terminal.end() == 130, terminal.shown
        assert "stopped by request" in terminal.shown
    assert read_log(session / "out" / "run.mcap").complete


def test_no_key_of_a_recorders_terminal_reaches_the_process_that_describes_its_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    code = "import os; print(os.getsid(0) == os.getpid())"
    monkeypatch.setattr(recorder.python, "command", lambda *_: [sys.executable, "-c", code])
    assert recorder.described(PAPER, DriverKind.SIM, 0) == b"True\n"


# --- what is typed ----------------------------------------------------------------------------------------------------

ASKS = """
import select, sys
from agent.cli import options
print("WAITS", flush=True)
select.select([sys.stdin], [], [])
print("SAYS", options.WAY("Is it EMPTY?"))
"""
WATCHES = """
import select, sys, time
from agent.cli.run import _Terminal
from agent.host.signals import StopFlag
StopFlag()
terminal = _Terminal(print, empty=False)
print("WAITS", flush=True)
select.select([sys.stdin], [], [])
print("SAYS", terminal.hears, terminal.lets_go(), terminal.lets_go(), WAY)
"""


def program(text: str, way: str) -> tuple[str, ...]:
    return sys.executable, "-c", text.replace("WAY", way)


@pytest.mark.parametrize("way", ["asked_yes", "confirmed"])
def test_what_was_typed_before_a_question_is_no_answer_to_it(tmp_path: Path, way: str) -> None:
    with Terminal(folder=tmp_path, program=program(ASKS, way)) as terminal:
        terminal.until("WAITS")
        terminal.type(b"y\n")
        terminal.until("EMPTY?")
        terminal.type(b"n\n")
        terminal.until("SAYS False")
        assert terminal.end() == 0


def test_enter_is_heard_once_and_only_by_who_is_in_front(tmp_path: Path) -> None:
    with Terminal(folder=tmp_path, program=program(WATCHES, "0")) as terminal:
        terminal.until("WAITS")
        terminal.type(b"\n\n")
        terminal.until("SAYS True True False 0")
        assert terminal.end() == 0


def test_who_watches_from_behind_is_not_suspended_hears_nothing_and_asks_nobody(tmp_path: Path) -> None:
    """Not for its words either, where a terminal has `tostop`."""
    way = "terminal.says_empty('left')"
    with Terminal(folder=tmp_path, program=program(WATCHES, way), behind=True, tostop=True) as terminal:
        terminal.until("WAITS")
        terminal.type(b"y\n")
        terminal.until("SAYS False False False False")
        assert terminal.end() == 0


def test_who_reads_a_terminal_that_another_takes_just_then_is_not_suspended(tmp_path: Path) -> None:
    """As between the look at who is in front and the reading."""
    always = "setattr(sys.modules['agent.cli.run'], 'in_front', lambda: True) or terminal.lets_go()"
    with Terminal(folder=tmp_path, program=program(WATCHES, always), behind=True) as terminal:
        terminal.until("WAITS")
        terminal.type(b"\n")
        terminal.until("SAYS False False False False")
        assert terminal.end() == 0


def test_a_terminal_without_job_control_is_heard(tmp_path: Path) -> None:
    """Of another session, as below `setsid`."""
    ours, theirs = os.openpty()
    code = "from agent.cli.options import in_front; print(in_front())"
    try:
        said = subprocess.run(
            [sys.executable, "-c", code], stdin=theirs, capture_output=True, text=True, check=True, timeout=TIMEOUT_S,
            start_new_session=True,
        )  # fmt: skip
    finally:
        os.close(ours)
        os.close(theirs)
    assert said.stdout == "True\n"
