"""An agent's view of its guard: when it counts on one, what it says and when, and what it does once it is gone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.guard import guarded
from agent.guard.guarded import Guarded
from agent.guard.line import GuardError, Word
from agent.guard.pulse import Pulse, pulse_vigil
from agent.telemetry.row.event import Level
from drivers.interface import StaleStateError

PATH, CELL = Path("left.guard"), "ab" * 32
AGAIN_AFTER, HAND_OVER_AFTER = 50, 100  # cycles
MS = 1_000_000
TOLD = "the guard hangs (no look for 200 ms): nobody takes over should this process end, and the arm falls limp then"
NOBODY = GuardError("guard", found="nobody", expected="one", remedy="start it")


vigil = partial(pulse_vigil, 5 * MS, shared=False)


class Ended(BaseException):
    """Instead of the end of this process."""


class Line:
    """The agent's end of a line to a guard that the test plays."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.open = True

    def ask(self, word: Word, fds: Sequence[int] = (), **content: Any) -> tuple[int, ...]:
        self.say(word, fds, **content)
        return (7,)

    def say(self, word: Word, fds: Sequence[int] = (), **content: Any) -> None:
        if self._bench.silent:
            raise NOBODY
        self._bench.said.append((word, tuple(fds), content))

    def heard(self) -> Mapping[str, Any] | None:
        return self._bench.answers.pop(0) if self._bench.answers else {}

    def close(self) -> None:
        self.open = False


class Bench:
    """An agent whose guard is there, and what was said and told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: list[tuple[Word, tuple[int, ...], dict[str, Any]]] = []
        self.told: list[tuple[Level, str]] = []
        self.answers: list[Mapping[str, Any] | None] = []
        self.ended: list[int] = []
        self.lines: list[tuple[Line, tuple[Any, ...], dict[str, Any]]] = []
        self.pulse: Any = None  # as the guard has it
        self.silent = self.absent = False
        monkeypatch.setattr(guarded, "AgentEnd", self._connect)
        self.flushed: list[str] = []
        out, err = (SimpleNamespace(flush=partial(self.flushed.append, name)) for name in ("out", "err"))
        monkeypatch.setattr(guarded, "sys", SimpleNamespace(stdout=out, stderr=err))
        self.now_ns = 7_000 * MS
        monkeypatch.setattr(guarded, "time", SimpleNamespace(monotonic_ns=lambda: self.now_ns))
        monkeypatch.setattr(guarded, "os", SimpleNamespace(**{**vars(os), "_exit": self._exit}))
        self.agent = Guarded(PATH, CELL)
        self.fds = (os.dup(0), os.dup(0))

    def _connect(self, *given: Any, **more: Any) -> Line:
        if self.absent:
            raise NOBODY
        self.lines.append((Line(self), given, more))
        return self.lines[-1][0]

    def _exit(self, code: int) -> None:
        self.ended.append(code)
        raise Ended

    def tell(self, level: Level, text: str) -> None:
        self.told.append((level, text))

    def watch(self) -> int:
        """Its process handle, once it is watched; what was said of it is forgotten."""
        self.agent.watch(self.fds, self.tell, vigil, ring="r")
        ((word, fds, content),) = self.said
        assert (word, fds[2:], content) == (Word.WATCH, self.fds, {"ring": "r"})
        self.said.clear()
        self.handles = fds[:2]
        self.pulse = Pulse(os.dup(fds[1]))
        return fds[0]

    def cycles(self, count: int, *, looks: bool) -> list[str]:
        """What so many cycles of 5 ms find; looks: whether the guard does so meanwhile."""
        found = []
        for _ in range(count):
            self.now_ns += 5 * MS
            if looks:
                self.pulse.beat()
            found.append(self.agent.poll())
        return found

    def loses(self) -> None:
        """The guard is gone, as the next cycle finds."""
        self.answers = [None]
        assert self.agent.poll() == "the guard is gone"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    made = Bench(monkeypatch)
    yield made
    if made.pulse is not None:
        made.pulse.close()
    for fd in made.fds:
        os.close(fd)


def test_somebody_goes_on_only_behind_an_agent_that_is_watched(bench: Bench) -> None:
    assert (bench.agent.there, bench.agent.state) == (False, "gone")
    bench.watch()
    assert (bench.agent.there, bench.agent.state, bench.agent.missing) == (True, "watches", "")
    bench.loses()
    assert (bench.agent.there, bench.agent.state, bench.agent.missing) == (False, "gone", "the guard is gone")
    bench.agent.leave()


def test_a_second_port_is_asked_for_as_one_that_was_lost(bench: Bench) -> None:
    assert not bench.agent.has_lent
    assert [bench.agent.borrow() for _ in range(3)] == [7, 7, 7]
    assert bench.agent.has_lent
    assert bench.said == [(Word.PORT, (), {"again": again}) for again in (False, True, True)]
    bench.loses()
    with pytest.raises(GuardError, match=r"port from the guard at left\.guard: found no guard any more"):
        bench.agent.borrow()


def test_a_busy_agent_says_for_how_long_and_nothing_once_nobody_hears(bench: Bench) -> None:
    bench.agent.busy()
    assert bench.said == [(Word.BUSY, (), {"for_s": 0.6})]
    bench.silent = True
    bench.agent.busy()
    bench.loses()
    bench.silent = False
    bench.agent.busy()
    assert len(bench.said) == 1


@pytest.mark.fault("P7")
def test_a_guard_that_hangs_is_told_once_and_nobody_goes_on_until_it_works_again(bench: Bench) -> None:
    bench.watch()
    assert bench.cycles(100, looks=True) == [""] * 100
    assert bench.cycles(39, looks=False) == [""] * 39
    assert (bench.agent.state, bench.told) == ("watches", [])
    assert bench.cycles(30, looks=False) == ["the guard hangs", *[""] * 29]
    assert (bench.agent.there, bench.agent.state, bench.agent.missing) == (False, "hangs", "the guard hangs")
    assert bench.told == [(Level.ERROR, TOLD)]
    with pytest.raises(
        GuardError, match=r"port from the guard at left\.guard: found the guard hangs, .*one that lends"
    ):
        bench.agent.borrow()
    bench.agent.give_up(RuntimeError("a defect"))
    assert bench.ended == [], "an orderly end follows"
    assert bench.cycles(1, looks=True) == [""]
    assert (bench.agent.there, bench.agent.state) == (True, "watches")
    assert bench.told[1:] == [(Level.INFO, "the guard works again and watches")]
    assert bench.cycles(40, looks=False)[-1] == "the guard hangs"
    assert bench.told[2:] == [(Level.ERROR, TOLD)]
    bench.agent.leave()


@pytest.mark.fault("P7")
def test_time_in_which_the_agent_itself_stood_still_is_not_held_against_its_guard(bench: Bench) -> None:
    bench.watch()
    bench.cycles(1, looks=True)
    bench.now_ns += 10_000 * MS
    assert bench.cycles(37, looks=False) == [""] * 37, "ten seconds in which nobody looked count as two cycles"
    bench.agent.leave()


@pytest.mark.fault("P7")
def test_a_guard_that_hung_and_died_is_gone_and_the_next_one_is_not_blamed(bench: Bench) -> None:
    bench.watch()
    assert bench.cycles(41, looks=False)[-1] == "the guard hangs"
    bench.loses()
    assert bench.agent.state == "gone"
    bench.answers = [{}, {}, {"ok": True}]
    assert bench.cycles(AGAIN_AFTER + 3, looks=False) == [""] * (AGAIN_AFTER + 3)
    assert (bench.agent.there, bench.agent.state) == (True, "watches")
    assert bench.cycles(38, looks=False) == [""] * 38
    assert bench.cycles(3, looks=False) == ["", "the guard hangs", ""], "nor trusted"
    bench.agent.leave()


def test_an_agent_that_is_asked_to_end_asks_a_guard_that_hangs_too(bench: Bench) -> None:
    """Which goes on once it works again; until then the agent holds."""
    bench.watch()
    bench.cycles(41, looks=False)
    assert not any(bench.agent.poll(ending=True, why="SIGINT: Ctrl-C") for _ in range(HAND_OVER_AFTER))
    assert bench.said == [(Word.TAKE, (), {"why": "SIGINT: Ctrl-C"})], "which the guard names in its place"
    bench.answers = [{"ok": True}]
    with pytest.raises(Ended):
        bench.agent.poll(ending=True)


@pytest.mark.fault("P7")
def test_a_guard_that_is_gone_is_told_once_and_looked_for_every_fifty_cycles(bench: Bench) -> None:
    bench.watch()
    bench.loses()
    assert not bench.lines[0][0].open
    assert bench.told == [
        (Level.ERROR, "the guard is gone: nobody takes over should this process end, and the arm falls limp then")
    ]
    bench.absent = True
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER))
    assert bench.said == []
    bench.absent, bench.silent = False, True
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER))
    assert (bench.said, bench.agent.there) == ([], False)
    bench.silent = False
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER - 1))
    assert len(bench.lines) == 2
    assert not bench.agent.poll()
    assert bench.lines[2][1:] == ((PATH, CELL), {"patience_s": 0.0})
    assert bench.said == [(Word.WATCH, (*bench.handles, *bench.fds), {"ring": "r"})]
    assert not bench.agent.there
    bench.answers = [{}, {"ok": True}]
    assert not bench.agent.poll()
    assert not bench.agent.there, "it has not said yes yet"
    assert not bench.agent.poll()
    assert bench.agent.there
    assert bench.told[1:] == [(Level.INFO, "the guard is back and watches")]
    bench.loses()
    assert len(bench.told) == 3
    bench.agent.leave()


def test_a_guard_that_is_back_and_refuses_goes_on_behind_nobody(bench: Bench) -> None:
    bench.watch()
    bench.loses()
    bench.answers = [{"ok": False, "found": "another cell"}]
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER + 1))
    assert bench.told[1:] == [(Level.ERROR, "the guard is back and does not watch: found another cell")]
    assert not bench.agent.there
    bench.agent.give_up(RuntimeError("a defect"))
    assert bench.ended == [], "an orderly end follows"
    bench.agent.leave()


def test_a_guard_that_came_back_before_the_torque_watches_as_any_other(bench: Bench) -> None:
    bench.loses()
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER))
    assert bench.said == []
    bench.watch()
    assert bench.agent.there
    bench.agent.leave()


def test_torque_without_a_guard_is_watched_by_the_next_one(bench: Bench) -> None:
    bench.loses()
    bench.agent.watch(bench.fds, bench.tell, vigil, ring="r")
    assert not bench.agent.there
    assert not any(bench.agent.poll() for _ in range(AGAIN_AFTER))
    assert [word for word, *_ in bench.said] == [Word.WATCH]
    bench.agent.leave()


def test_answers_that_nobody_waits_for_change_nothing(bench: Bench) -> None:
    bench.watch()
    bench.answers = [{"ok": True}, {"ok": False, "found": "x"}]
    assert [bench.agent.poll(), bench.agent.poll()] == ["", ""]
    assert (bench.told, bench.agent.there) == ([], True)
    bench.agent.leave()


def test_an_agent_that_was_asked_to_end_hands_over_after_a_hundred_cycles_of_its_hold(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.watch()
    for _ in range(7):
        bench.agent.poll()
    for _ in range(HAND_OVER_AFTER - 1):
        assert not bench.agent.poll(ending=True)
    assert bench.said == []
    assert not any(bench.agent.poll(ending=True) for _ in range(HAND_OVER_AFTER)), "a guard that hangs holds nothing"
    assert bench.said == [(Word.TAKE, (), {"why": ""})], "once"
    assert bench.told == []
    bench.answers = [{"ok": False}, {"ok": True}]
    assert not bench.agent.poll(ending=True)
    with pytest.raises(Ended):
        bench.agent.poll(ending=True)
    assert bench.told == [(Level.INFO, "hands the arm to the guard, as it was asked to end")]
    assert (bench.ended, bench.flushed) == ([0], ["out", "err"])


def test_a_guard_that_goes_while_it_is_handed_an_arm_is_asked_again_once_it_is_back(bench: Bench) -> None:
    bench.watch()
    assert not any(bench.agent.poll(ending=True) for _ in range(HAND_OVER_AFTER))
    bench.loses()
    bench.said.clear()
    bench.answers = [{"ok": True}]
    assert not any(bench.agent.poll(ending=True) for _ in range(AGAIN_AFTER + 1)), "it says that it watches"
    assert bench.agent.there
    assert not bench.agent.poll(ending=True)
    assert [word for word, *_ in bench.said] == [Word.WATCH, Word.TAKE]
    assert bench.ended == []
    bench.agent.leave()


@pytest.mark.parametrize("why", ["gone", "silent", "back and not heard yet"])
def test_an_agent_that_nobody_relieves_stays(bench: Bench, why: str) -> None:
    bench.watch()
    bench.silent = why == "silent"
    if not bench.silent:
        bench.loses()
        bench.absent = why == "gone"
    assert not any(bench.agent.poll(ending=True) for _ in range(2 * HAND_OVER_AFTER))
    assert bench.ended == []
    assert Word.TAKE not in [word for word, *_ in bench.said]
    bench.agent.leave()


@pytest.mark.parametrize(
    ("error", "code"),
    [(RuntimeError("a defect"), 1), (StaleStateError("state", found="none", expected="one", remedy="look"), 3)],
)
def test_a_loop_that_failed_ends_at_once_with_the_code_of_its_error(
    bench: Bench, capsys: pytest.CaptureFixture[str], error: Exception, code: int
) -> None:
    bench.watch()
    with pytest.raises(Ended):
        bench.agent.give_up(error)
    assert bench.told == [(Level.ERROR, f"{type(error).__name__}: {error}; the guard goes on")]
    assert bench.ended == [code]
    assert type(error).__name__ in capsys.readouterr().err


def is_open(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True


@pytest.mark.parametrize("silent", [False, True])
def test_who_leaves_says_so_and_gives_everything_back_once(bench: Bench, silent: bool) -> None:
    handle = bench.watch()
    bench.silent = silent
    bench.agent.leave()
    assert bench.said == ([] if silent else [(Word.LEAVE, (), {})])
    assert bench.told == ([(Level.WARN, str(NOBODY))] if silent else [])
    assert not bench.lines[0][0].open
    assert not is_open(handle)
    assert all(map(is_open, bench.fds)), "they are the ring's and its texts'"
    bench.silent = False
    bench.agent.busy()
    other = os.dup(0)  # gets the number that is free again
    bench.agent.leave()
    assert is_open(other)
    os.close(other)
    assert len(bench.said) == (0 if silent else 1)


def test_a_cycle_waits_for_no_guard_whether_that_watches_hangs_is_gone_or_is_to_take_over(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.watch()
    asked: list[Word] = []
    monkeypatch.setattr(Line, "ask", lambda _, word, *__, **___: asked.append(word) or (7,))
    bench.cycles(100, looks=True)
    bench.cycles(100, looks=False)
    bench.agent.busy()
    for _ in range(100):
        bench.agent.poll(ending=True)
    bench.answers.append(None)
    bench.cycles(500, looks=False)
    assert len(bench.lines) > 1, "it has looked for another"
    assert bench.lines[-1][2] == {"patience_s": 0.0}
    assert asked == []
    bench.agent.leave()
    assert asked == [Word.LEAVE]


def test_who_was_never_watched_leaves_without_a_word(bench: Bench) -> None:
    bench.agent.leave()
    assert bench.said == []
    assert not bench.lines[0][0].open


def test_only_the_answer_to_a_word_says_that_it_was_heard(bench: Bench) -> None:
    bench.watch()
    bench.answers = [{"ok": True, "to": "port"}] * (HAND_OVER_AFTER + 3)
    assert not any(bench.agent.poll(ending=True) for _ in range(HAND_OVER_AFTER + 3))
    assert bench.ended == [], "the port is not the hand-over"
    bench.answers = [{"ok": True, "to": "take"}]
    with pytest.raises(Ended):
        bench.agent.poll(ending=True)


def test_a_guard_that_is_back_watches_once_it_has_answered_that_word(bench: Bench) -> None:
    bench.watch()
    bench.loses()
    bench.answers = [{}] * AGAIN_AFTER + [{"ok": True, "to": "port"}, {"ok": True, "to": "watch"}]
    seen = []
    while bench.answers:
        bench.agent.poll()
        seen.append(bench.agent.there)
    assert seen[-2:] == [False, True]
    bench.agent.leave()


def test_an_answer_without_the_port_is_an_error_that_the_loop_knows(bench: Bench) -> None:
    bench.lines[0][0].ask = lambda *_, **__: ()  # type: ignore[method-assign]
    with pytest.raises(GuardError, match="found 0 descriptors, expected one"):
        bench.agent.borrow()
    fds = os.pipe()
    bench.lines[0][0].ask = lambda *_, **__: fds  # type: ignore[method-assign]
    with pytest.raises(GuardError, match="found 2 descriptors, expected one"):
        bench.agent.borrow()
    for fd in fds:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(fd)


def test_a_guard_that_did_not_hear_that_it_is_to_go_on_is_told_again(bench: Bench) -> None:
    bench.watch()
    bench.silent = True
    for _ in range(HAND_OVER_AFTER + 3):
        bench.answers = [{"ok": True}]  # of another word
        bench.agent.poll(ending=True)
    bench.silent = False
    assert (bench.agent.poll(ending=True), bench.said, bench.ended) == ("", [(Word.TAKE, (), {"why": ""})], [])
    bench.answers = [{"ok": True}]
    with pytest.raises(Ended):
        bench.agent.poll(ending=True)


def test_an_agent_that_leaves_gives_its_pulse_back_once(bench: Bench) -> None:
    process, pulse = bench.watch(), bench.handles[1]
    bench.agent.leave()
    for fd in (process, pulse):
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(fd)
    others = [os.dup(0) for _ in range(4)]  # which have those numbers now
    bench.agent.leave()
    for fd in others:
        os.close(fd)
