"""What a guard does in one look: it strokes its watchdog, hears its agent, and finds it dead, hanging or busy."""

from __future__ import annotations

import os
import tty
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.config.schema.driver import DriverKind
from agent.guard.line import Said, Word
from agent.guard.pulse import Pulse
from agent.guard.vigil import Vigil
from agent.guard.watched import Watched
from agent.process import guard as process
from agent.process.guard import _Guard
from agent.process.successor import HANDED_OVER
from agent.telemetry.ring.reader import RowBlock
from drivers.clock import MonotonicClock
from drivers.interface import Refusal

MS = 1_000_000


class Handle:
    """Of a process that is alive until the test says otherwise."""

    gone = False
    killed: Any = None

    def kill(self, meanwhile: Any) -> None:
        self.killed = meanwhile


class Seen(Watched):
    """An agent of which nothing is there but its handle."""

    def last_rows(self) -> Any:
        return "rows"

    def close(self) -> None:
        self.process.gone = True  # type: ignore[misc]


@dataclass
class Line:
    """What the agent says, and what it is told."""

    words: list[Said] = field(default_factory=list)
    answers: list[tuple[int, ...]] = field(default_factory=list)
    refusals: list[Refusal] = field(default_factory=list)

    def hear(self) -> Said | None:
        return self.words.pop(0) if self.words else None

    def answer(self, fds: tuple[int, ...] = ()) -> None:
        self.answers.append(fds)

    def refuse(self, error: Refusal) -> None:
        self.refusals.append(error)


class Port:
    """One of two descriptors, the second once it was opened again."""

    def __init__(self, fd: int) -> None:
        self.fd, self.closed = fd, False

    def close(self) -> None:
        self.closed = True

    def fileno(self) -> int:
        return self.fd


class Ring:
    """Of an agent, as the guard goes on with it."""

    def __init__(self) -> None:
        self.written, self.damage = 7, ""

    def catch_up(self) -> int:
        return self.written


class Bench:
    """A guard without processes, on a clock of the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, driver: DriverKind = DriverKind.DYNAMIXEL) -> None:
        self.now_ns, self.strokes, self.rehearsals = 5_000 * MS, 0, list[Any]()
        self.line, self.dropped = Line(), 0
        monkeypatch.setattr(process, "time", SimpleNamespace(monotonic_ns=lambda: self.now_ns))
        monkeypatch.setattr(process, "beginning", lambda *given, **more: self.rehearsals.append((*given, more)))
        self.guard: Any = _Guard.__new__(_Guard)
        self.guard._line = self.line
        self.asides = list[str]()
        self.guard._aside = self.asides.append
        self.guard._arm = SimpleNamespace(name="left")
        self.guard._notifier = SimpleNamespace(alive=self._alive, send=lambda _: None)
        self.guard._options = SimpleNamespace(driver=driver, socket=Path("left.guard"))
        self.guard._agent, self.guard._session, self.guard._stroked_ns = "law", True, 0
        self.guard._port, self.guard._drivers, self.guard._told = None, (), {}
        self.guard._driver = SimpleNamespace(drop=self._drop)
        self.ring = Ring()
        vigil = Vigil(stale_ns=20 * MS, look_ns=2 * MS)
        reader: Any = SimpleNamespace(read_at=lambda first, _: RowBlock(first, 0, b""))
        rows: Any = self.ring
        texts: Any = Ring()
        self.process: Any = Handle()
        self.agent = Seen(self.process, Path("ring"), reader, rows, texts, Pulse.made(), vigil)
        self.guard._watched = self.agent

    def _alive(self) -> None:
        self.strokes += 1

    def _drop(self) -> None:
        self.dropped += 1

    def look(self, later_ns: int = 2 * MS) -> str:
        self.now_ns += later_ns
        reason: str = self.guard._look()
        return reason

    def says(self, word: Word, **content: Any) -> str:
        self.line.words.append(Said(word, content, ()))
        return self.look()


def test_its_own_watchdog_is_stroked_every_twenty_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.guard._watched = None
    assert [(bench.look(later), bench.strokes) for later in (0, 20 * MS - 1, 1, 20 * MS - 1, 1)] == [
        ("", 1), ("", 1), ("", 2), ("", 2), ("", 3),
    ]  # fmt: skip


def test_an_agent_that_died_is_told_from_one_that_handed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    assert bench.look() == ""
    bench.process.gone = True
    assert bench.look() == "the agent has died"
    bench = Bench(monkeypatch)
    assert bench.says(Word.TAKE) == ""
    assert bench.line.answers == [()], "which its agent waits for"
    bench.process.gone = True
    assert bench.look() == HANDED_OVER
    bench = Bench(monkeypatch)
    bench.says(Word.TAKE, why="SIGHUP: its terminal or connection is gone")
    bench.process.gone = True
    assert bench.look() == f"{HANDED_OVER} (SIGHUP: its terminal or connection is gone)", "as the agent would have"
    bench = Bench(monkeypatch)
    bench.says(Word.TAKE)
    bench.agent.handed_over = True
    assert any((found := bench.look()) for _ in range(20))
    assert found == HANDED_OVER, "its process takes its time to end"
    assert bench.process.killed is not None


@pytest.mark.fault("P14")
def test_what_has_become_of_an_agents_files_is_told_with_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.look()
    bench.ring.damage = "cut to 0 of 9 bytes"
    assert bench.look(30 * MS) == "", "it lives"
    assert any((found := bench.look()) for _ in range(20))
    assert found == "the agent hung (no row for 20 ms) and was ended: its ring was cut to 0 of 9 bytes"
    bench.process.gone = True
    assert bench.look() == "the agent has died: its ring was cut to 0 of 9 bytes"


@pytest.mark.fault("P1")
@pytest.mark.parametrize("gone", [True, False])
def test_a_guard_that_is_asked_to_end_goes_on_with_an_arm_that_was_left_to_it_before(
    monkeypatch: pytest.MonkeyPatch, gone: bool
) -> None:
    bench, held = Bench(monkeypatch), list[str]()
    bench.guard._stop = SimpleNamespace(stopped=True)
    bench.guard._successor = SimpleNamespace(hold=lambda _watched, _driver, reason, **_: held.append(reason))
    bench.guard._wait = lambda: 1 / 0
    bench.process.gone = gone
    bench.guard.run()
    assert held == (["the agent has died"] if gone else [])
    said = "arm left: the agent has died: the guard goes on in its place until `coop release`"
    assert bench.asides == ([said] if gone else []), "on its terminal"


def test_a_guard_that_is_asked_to_end_waits_for_an_agent_that_it_has_said_yes_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, held = Bench(monkeypatch), list[str]()
    bench.guard._stop = SimpleNamespace(stopped=True)
    bench.guard._successor = SimpleNamespace(hold=lambda _watched, _driver, reason, **_: held.append(reason))
    bench.line.words.append(Said(Word.TAKE, {}, ()))
    bench.guard._wait = lambda: setattr(bench.process, "gone", True)
    bench.guard.run()
    assert (held, bench.line.answers) == ([HANDED_OVER], [()])


def test_an_agent_that_hangs_is_ended_before_anything_else_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    assert [bench.look() for _ in range(10)] == [""] * 10
    assert bench.process.killed is None
    assert bench.look() == "the agent hung (no row for 20 ms) and was ended"
    assert bench.process.killed == bench.guard._notifier.alive


@pytest.mark.parametrize(("written", "waits"), [(0, True), (1, False)])
def test_a_simulated_agent_without_a_row_is_not_ended(
    monkeypatch: pytest.MonkeyPatch, written: int, waits: bool
) -> None:
    bench = Bench(monkeypatch, DriverKind.SIM)
    bench.ring.written = written
    assert any(bench.look() for _ in range(40)) is not waits
    assert (bench.process.killed is None) is waits


def test_a_hold_is_rehearsed_once_there_are_twenty_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for written in (18, 19):
        bench.ring.written = written
        bench.look()
    assert bench.rehearsals == []
    for written in (20, 21):
        bench.ring.written = written
        assert bench.look() == ""
        assert bench.rehearsals == [("law", "rows", "", {"session": True})]


@pytest.mark.parametrize(("for_s", "excused_ms"), [(0.6, 600), (5.0, 1000)])
def test_a_busy_agent_is_excused_for_a_second_at_most(
    monkeypatch: pytest.MonkeyPatch, for_s: float, excused_ms: int
) -> None:
    bench = Bench(monkeypatch)
    bench.says(Word.BUSY, for_s=for_s)
    assert bench.agent.vigil.excused_until_ns == bench.now_ns + excused_ms * MS
    assert bench.line.answers == [], "it does not wait for one"


@pytest.mark.parametrize("word", [Word.BUSY, Word.TAKE])
def test_words_of_an_agent_that_is_not_watched_change_nothing(monkeypatch: pytest.MonkeyPatch, word: Word) -> None:
    bench = Bench(monkeypatch)
    bench.guard._watched = None
    assert bench.says(word, for_s=1.0) == ""
    assert (bench.line.answers, bench.line.refusals) == ([], [])


def test_an_agent_that_leaves_is_let_go_and_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.says(Word.LEAVE)
    assert (bench.guard._watched, bench.guard._driver, bench.dropped) == (None, None, 1)
    assert (bench.process.gone, bench.line.answers) == (True, [()])


@pytest.mark.fault("P7")
def test_a_guard_that_stood_still_hears_that_its_agent_has_left_before_it_finds_it_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its torque is off: nobody may hold the arm in its place."""
    bench = Bench(monkeypatch)
    bench.process.gone = True
    bench.line.words += [Said(Word.BUSY, {"for_s": 0.6}, ()), Said(Word.LEAVE, {}, ())]
    assert bench.look() == ""
    assert bench.guard._watched is None


def test_an_agent_is_watched_once_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, watched = Bench(monkeypatch), list[Said]()
    bench.guard._watch = watched.append
    bench.says(Word.WATCH, driver={})
    assert [said.word for said in watched] == [Word.WATCH]


def test_what_makes_no_sense_is_refused_and_nothing_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for content in ({}, {"for_s": "soon"}, {"for_s": None}):
        bench.says(Word.BUSY, **content)
    assert [error.what for error in bench.line.refusals] == [Word.BUSY] * 3
    assert bench.agent.vigil.excused_until_ns == 0


def test_the_port_is_lent_and_opened_anew_for_an_agent_that_lost_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    first, second = Port(3), Port(4)
    bench.guard._port = first
    bench.guard._open_port = lambda: second
    bench.guard._prepared = lambda: "prepared"
    bench.says(Word.PORT)
    assert (bench.line.answers, first.closed, bench.agent.vigil.excused_until_ns) == ([(3,)], False, 0)
    bench.says(Word.PORT, again=True)
    assert (bench.line.answers, first.closed) == ([(3,), (4,)], True)
    assert bench.agent.vigil.excused_until_ns == bench.now_ns + 1000 * MS
    assert bench.guard._driver == "prepared"


def test_a_guard_lends_again_while_nobody_is_watched_and_has_no_port_of_a_simulated_arm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch)
    bench.guard._port, bench.guard._watched, bench.guard._driver = Port(3), None, None
    bench.guard._open_port = lambda: Port(4)
    bench.says(Word.PORT, again=True)
    assert (bench.line.answers, bench.guard._driver) == ([(4,)], None)
    bench.guard._port = None
    bench.says(Word.PORT)
    (refusal,) = bench.line.refusals
    assert str(refusal).startswith("port from the guard at left.guard: found a simulated arm"), "its agent tells it so"


@pytest.mark.parametrize("kept", [True, False])
def test_a_port_that_the_service_manager_kept_is_taken_as_it_is_and_one_opened_anew_is_made_ready(
    monkeypatch: pytest.MonkeyPatch, kept: bool
) -> None:
    """Its agent is in the middle of an exchange where the guard was gone alone."""
    bench, manager = Bench(monkeypatch), list[tuple[str, int]]()
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)
    os.write(master, b"R" * 40)  # that the agent has not read yet
    monkeypatch.setattr(process, "stored_fds", lambda: {"port": os.dup(slave)} if kept else {})
    monkeypatch.setattr(process, "port_of", lambda *_: os.ttyname(slave))
    bench.guard._arm, bench.guard._clock = SimpleNamespace(baud=1_000_000), MonotonicClock()
    bench.guard._notifier.keep = lambda *given: manager.append(given)
    port = bench.guard._open_port()
    assert manager == [("port", port.fileno())]
    assert len(port.read_now()) == (40 if kept else 0)
    port.close()
    os.close(slave)
    os.close(master)
