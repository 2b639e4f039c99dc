"""The writer of the post-mortem is waited for once the arm is let go of, not for ever, and the watchdog is stroked."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.guard import black_box
from agent.guard.black_box import BlackBox
from agent.modes import Mode
from agent.process import successor
from agent.process.successor import Successor

CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml")


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """In place of the writer: a program that notes its arguments and ends once somebody has opened this pipe."""
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    (tmp_path / "waits.py").write_text(
        f"import sys; open({str(tmp_path / 'told')!r}, 'a').write(' '.join(sys.argv[1:])); open({str(gate)!r}).read()"
    )
    monkeypatch.setattr(black_box, "WRITER", "waits")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    yield gate
    with contextlib.suppress(OSError):  # nobody reads: it has ended
        os.close(os.open(gate, os.O_WRONLY | os.O_NONBLOCK))


@pytest.mark.parametrize("beats", [1, 3])
def test_whoever_waits_for_the_writer_is_called_again_and_again_until_it_has_ended(gate: Path, beats: int) -> None:
    box = BlackBox(["once"], gate.parent / "log", 2, wanted=True)
    for _ in range(beats):
        box.beat()
    looks: list[int] = []

    def meanwhile() -> None:
        looks.append(1)
        if len(looks) == 3:
            gate.write_text("go")  # returns when the writer reads

    box.finish(meanwhile, pytest.fail)
    assert len(looks) >= 3
    assert (gate.parent / "told").read_text() == "once"
    box.finish(lambda: pytest.fail("it has ended"), pytest.fail)


@pytest.mark.parametrize("beats", [0, 2])
def test_a_writer_that_hangs_is_ended_after_a_while_and_told(
    gate: Path, monkeypatch: pytest.MonkeyPatch, beats: int
) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Noted(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    monkeypatch.setattr(black_box, "PATIENCE_S", 3 * black_box.LOOK_S)
    box = BlackBox(["once"], gate.parent / "log", 2, wanted=True)
    for _ in range(beats):
        box.beat()
    looks, told = list[int](), list[str]()
    box.finish(lambda: looks.append(1), told.append)
    assert len(looks) >= 3
    assert told == ["its writer had not ended after 0.06 s and was killed"], "it began nothing"
    assert [writer.returncode for writer in started] == [-signal.SIGKILL]
    box.finish(lambda: pytest.fail("nobody is there"), pytest.fail)


def test_no_key_of_the_guards_terminal_reaches_its_writer(gate: Path) -> None:
    (gate.parent / "waits.py").write_text("import os, sys; sys.exit(os.getsid(0) != os.getpid())")
    BlackBox([], gate.parent / "log", 2, wanted=True).finish(lambda: None, pytest.fail)


def test_a_writer_that_fails_or_cannot_be_started_is_told(gate: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = gate.parent / "log.part"
    (gate.parent / "waits.py").write_text(f"open({str(part)!r}, 'x'); raise SystemExit(4)")
    told: list[str] = []
    BlackBox([], gate.parent / "log", 2, wanted=True).finish(lambda: None, told.append)
    assert told == [f"its writer ended with 4, see the guard's journal; what it began is in {part}"]
    monkeypatch.setattr(sys, "executable", str(gate.parent / "none"))
    BlackBox([], gate.parent / "log", 2, wanted=True).finish(lambda: pytest.fail("nobody is there"), told.append)
    assert told[1:] == ["its writer could not be started (No such file or directory)"]


def test_a_hold_that_was_asked_for_has_no_post_mortem(gate: Path) -> None:
    box = BlackBox(["never"], gate.parent / "log", 2, wanted=False)
    box.beat()
    box.finish(lambda: pytest.fail("there is nobody to wait for"), pytest.fail)
    assert not (gate.parent / "told").exists()


def test_a_guard_names_the_file_that_its_writer_was_given(gate: Path) -> None:
    (gate.parent / "waits.py").write_text("import sys; open(sys.argv[4] + '.part', 'x'); raise SystemExit(4)")
    options: Any = SimpleNamespace(cell=gate.parent / "cell.toml", post_mortem=gate.parent)
    guard: Any = Successor(CELL, CELL.arm("left"), None, options, None, None)  # type: ignore[arg-type]
    told: list[str] = []
    guard._black_box(gate.parent / "left.ring", "the agent has died", wanted=True).finish(lambda: None, told.append)
    (part,) = gate.parent.glob("*-left-post-mortem.mcap.part")
    assert told == [f"its writer ended with 4, see the guard's journal; what it began is in {part}"]


@pytest.mark.parametrize("fails", [False, True])
def test_an_arm_is_let_go_of_before_its_post_mortem_is_waited_for_and_the_watchdog_is_stroked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    done, wants = list[str](), list[bool]()

    def did(what: str) -> Any:
        return lambda *_, **__: done.append(what)

    def run() -> Any:
        done.append("held")
        return 1 / 0 if fails else SimpleNamespace(mode=Mode.OFF)

    begun = SimpleNamespace(mode=Mode.HOLD)
    written = SimpleNamespace(finish=did("ring finished"), row=None)
    watched: Any = SimpleNamespace(
        inherit=did("inherited"), last_rows=list, writer=written, ring=tmp_path / "ring", process=None,
        handed_over=fails,
        texts=SimpleNamespace(finish=did("texts finished"), event=lambda _: None),
    )  # fmt: skip
    driver: Any = SimpleNamespace(disable=did("torque off"), close=did("closed"))
    notifier: Any = SimpleNamespace(alive=did("stroke"), stopping=did("stopping"))
    options: Any = SimpleNamespace(
        control=None, hold=True, shared=False, driver=SimpleNamespace(value="dynamixel"), cell=tmp_path / "cell.toml",
        post_mortem=tmp_path,
    )  # fmt: skip
    box = SimpleNamespace(
        drops_on_stop=False, finish=lambda meanwhile, missing: (done.append("waited"), meanwhile(), missing("it hung")),
    )  # fmt: skip
    with ExitStack() as stack:
        for name, fake in {
            "clock_of": lambda _: SimpleNamespace(utc_offset_ns=0), "go_on": lambda *_, **__: begun,
            "BlackBox": lambda *_, wanted: (wants.append(wanted), box)[1], "schedule_of": lambda *_, **__: None,
            "AgentRow": lambda *_: None, "Watch": lambda *_: None,
            "Runner": lambda *given: (given[6].busy(), SimpleNamespace(run=run))[1],
            "Teller": lambda *_: SimpleNamespace(
                event=lambda *_, **__: None, end=did("told"), warn=done.append, trouble=None,
            ),
            "Heart": lambda *_: SimpleNamespace(mode=lambda _: None, beat=None, busy=did("busy")),
            "Operator": lambda *_, **__: box,
            "ServoTeller": lambda *_: None,
        }.items():  # fmt: skip
            stack.enter_context(pytest.MonkeyPatch.context()).setattr(successor, name, fake)
        box.events = box.mode = None
        stack.enter_context(pytest.MonkeyPatch.context()).setattr(successor.ArmLost, "check", lambda *_, **__: None)
        stop = SimpleNamespace(released=True)
        held = Successor(CELL, CELL.arm("left"), None, options, stop, notifier)  # type: ignore[arg-type]
        if fails:
            with pytest.raises(ZeroDivisionError):
                held.hold(watched, driver, "the agent has died", session=False)
        else:
            held.hold(watched, driver, "the agent has died", session=False)
    assert not stop.released, "said before there was a hold to be released"
    assert wants == [not fails], "none of a hand-over"
    late = ["waited", "stroke", "no post-mortem: it hung"]
    end = ["torque off", "closed", *late, "ring finished", "texts finished"]
    assert done == ["inherited", "busy", "held", *([] if fails else ["told"]), *end, *([] if fails else ["stopping"])]
