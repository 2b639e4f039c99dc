"""One pytest session for one module: tests are collected once, then each change runs in a child forked from there."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from types import FrameType
from typing import Any

import pytest

from tests.mutate.forks import Job, Tell, run_all
from tests.mutate.mutants import Mutant, exchange, source_of

FIRST_S = 600.0  # for all tests of a module without a change
WALL_S = 60.0  # of one test, however little it computes
CPU_S = 1.0  # of one test, and ten times what it takes without a change


@dataclass
class Measured:
    """One test without a change."""

    cpu_s: float
    ran: frozenset[str | int]  # of the module: functions as qualified names, and lines


@dataclass(eq=False)
class Noticing:
    """A pytest plugin that runs every wanted change instead of running the tests, and tells what became of it.

    tell gets ("verdict", place in `mutants`, test that failed or ""), ("fresh", place), ("problem", text).
    """

    module: str
    mutants: Sequence[Mutant]
    wanted: Sequence[int]
    at_once: int
    tell: Tell
    warm: Sequence[str] = ()
    problem: str = ""
    _measured: dict[str, Measured] = field(default_factory=dict)
    _kills: Counter[str] = field(default_factory=Counter)
    _say: Tell | None = None

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Measure the tests, then run the changes."""
        if session.testsfailed:
            self.problem = "the tests cannot be collected"
        else:
            run_all([Job(lambda tell: self._measure(session, tell), FIRST_S, self._take_measure)], 1)
            self._warm()
        if self.problem:
            self.tell(("problem", self.problem))
        else:
            run_all((self._job(session, i) for i in self.wanted), self.at_once)
        return True

    # --- without a change ---------------------------------------------------------------------------------------------

    def _measure(self, session: pytest.Session, tell: Tell) -> None:
        watch = CallWatch(str(source_of(self.module)))
        session.config.pluginmanager.register(watch)
        self._say = tell
        for item, following in _in_turn(session.items):
            tell(("running", item.nodeid))
            begin_s = time.process_time()
            watch.begin()
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            ran = watch.ran(item)
            tell(("measured", item.nodeid, Measured(time.process_time() - begin_s, ran)))
        tell(("complete",))

    def _take_measure(self, said: list[Any]) -> None:
        failed = [entry for entry in said if entry[0] == "failed"]
        if failed:
            self.problem = f"{failed[0][1]} fails without a change:\n{failed[0][2]}"
        elif not said or said[-1] != ("complete",):
            self.problem = f"the tests ended in {said[-1] if said else 'nothing'}"
        self._measured = {entry[1]: entry[2] for entry in said if entry[0] == "measured"}

    def _warm(self) -> None:
        """Fill the caches that no change can be seen in, for all children."""
        watch = CallWatch(str(source_of(self.module)))
        watch.begin()
        for name in self.warm:
            module, function = name.split(":")
            getattr(import_module(module), function)()
        if called := watch.seen():
            self.problem = (
                f"{', '.join(self.warm)}: called once for all changes, yet they run {sorted(map(str, called))}"
            )

    # --- with a change ------------------------------------------------------------------------------------------------

    def _job(self, session: pytest.Session, i: int) -> Job:
        mutant = self.mutants[i]
        items = self._chosen(session.items, mutant)
        limit_s = WALL_S + 20.0 * sum(self._measured[item.nodeid].cpu_s for item in items)

        def done(said: list[Any]) -> None:
            if ("fresh",) in said:
                self.tell(("fresh", i))
                return
            test = noticed_by(said)
            self._kills[test.split(" ")[0]] += bool(test)
            self.tell(("verdict", i, test))

        return Job(lambda tell: self._run(session, mutant, items, tell), limit_s, done)

    def _chosen(self, items: Sequence[pytest.Item], mutant: Mutant) -> list[pytest.Item]:
        """Those that run the statement, first the quick ones that noticed most so far; where none is seen to run it
        those that run the function, or else all.

        Another test could notice only through a result that one of these left behind.
        """
        ran, lines = self._measured, range(mutant.line, mutant.end + 1)
        reaching = [item for item in items if not ran[item.nodeid].ran.isdisjoint(lines)]
        calling = reaching or [item for item in items if mutant.where in ran[item.nodeid].ran]
        return sorted(
            calling or items, key=lambda item: self._measured[item.nodeid].cpu_s / (1 + self._kills[item.nodeid])
        )

    def _run(self, session: pytest.Session, mutant: Mutant, items: Sequence[pytest.Item], tell: Tell) -> None:
        if not exchange(mutant):
            tell(("fresh",))
            return
        self._say = tell
        signal.signal(signal.SIGVTALRM, _too_long)
        for item, following in _in_turn(items):
            tell(("running", item.nodeid))
            signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S + 10.0 * self._measured[item.nodeid].cpu_s, CPU_S)
            item.add_marker(pytest.mark.timeout(WALL_S))
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        tell(("complete",))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A failure is all that a child is for: it ends there."""
        if report.failed and self._say is not None:
            self._say(("failed", report.nodeid, str(report.longrepr)[-4000:]))
            os._exit(0)


@dataclass(eq=False)
class CallWatch:
    """A pytest plugin that notes what each test runs of one file, itself or by a fixture it shares."""

    file: str
    _ran: set[str | int] = field(default_factory=set)
    _by_fixture: dict[str, set[str | int]] = field(default_factory=dict)

    def begin(self) -> None:
        """Note functions and lines from here on, in all threads."""
        self._ran = set()
        threading.settrace(self._see)
        sys.settrace(self._see)

    def ran(self, item: pytest.Item) -> frozenset[str | int]:
        """What was run since `begin`, and by fixtures that were set up for an earlier test."""
        shared = (self._by_fixture.get(name, set()) for name in getattr(item, "fixturenames", ()))
        return self.seen().union(*shared)

    def seen(self) -> frozenset[str | int]:
        """What was run since `begin`, after which nothing is noted."""
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        return frozenset(self._ran)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[None]:
        """Remember what a fixture runs."""
        before = set(self._ran)
        self._ran.clear()
        yield
        self._by_fixture.setdefault(fixturedef.argname, set()).update(self._ran)
        self._ran |= before

    def _see(self, frame: FrameType, event: str, _: Any) -> Callable[[FrameType, str, Any], Any] | None:
        if frame.f_code.co_filename != self.file:
            return None
        if event == "call":
            self._ran.add(frame.f_code.co_qualname.split(".<locals>")[0])
        self._ran.add(frame.f_lineno)
        return self._see


def _in_turn(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    return zip(items, [*items[1:], None], strict=True)


def noticed_by(said: list[Any]) -> str:
    """The test that failed, or that was running when nothing more came."""
    if not said:
        return "the start of its tests"
    last = said[-1]
    match last[0]:
        case "failed":
            return str(last[1])
        case "running":
            return f"{last[1]} (it hung or died)"
        case "crashed" if "TooLong" in last[1]:  # the limit fell on what runs between tests
            return f"{next(word[1] for word in reversed(said) if word[0] == 'running')} (it hung)"
        case "crashed":
            raise RuntimeError(f"the tests could not be run: {last[1]}")
    return ""


class TooLong(BaseException):
    """A test computes for longer than it may; no Exception, which the code under test might catch."""


def _too_long(_: int, __: FrameType | None) -> None:
    raise TooLong
