"""The latency test in virtual time, what it keeps, and what it says of a host."""

from __future__ import annotations

import gc
import json
import math
import os
import signal
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.host import latency, realtime
from agent.host.latency import (
    EDGES_US,
    SYSTEM_FILE,
    Fitness,
    Histogram,
    Latency,
    files,
    keep,
    measure,
    newest,
    own_file,
)
from agent.host.realtime import RealTime, granted
from drivers.interface import Clock as AnyClock
from tests.support.command import coop

RATE_HZ, PERIOD_NS = 200.0, 5_000_000
FIFO = RealTime("SCHED_FIFO", 80, 1 << 20)


class Clock:
    """Every reading takes 100 µs; a sleep ends as late as the test says, by its number."""

    utc_offset_ns = 0

    def __init__(self, late_ns: dict[int, int]) -> None:
        self.ns = 0
        self.sleeps = 0
        self.deadlines: list[int] = []
        self._late_ns = late_ns

    def now_ns(self) -> int:
        self.ns += 100_000
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.deadlines.append(deadline_ns)
        self.ns = max(self.ns, deadline_ns) + self._late_ns.get(self.sleeps, 0)
        self.sleeps += 1


def never() -> bool:
    return False


def result(max_s: float, *, others: int = 99_999, loaded: bool = True, real_time: RealTime = FIFO) -> Latency:
    """A test in which one cycle was late, and the others were by 10 µs."""
    found = Histogram()
    for late_s in (max_s, 1e-5):
        found.add(late_s)
    found.counts[10] += others - 1
    found.cycles += others - 1
    return Latency(7, "6.12", 4, 500.0, RATE_HZ, loaded, real_time, found)


def test_it_wakes_at_absolute_deadlines_works_and_leaves_missed_cycles_out() -> None:
    clock = Clock({3: 400_000, 5: 2 * PERIOD_NS})
    found = measure(0.05, RATE_HZ, clock, never)
    assert (found.cycles, found.missed) == (8, 2)
    steps = [b - a for a, b in zip(clock.deadlines, clock.deadlines[1:], strict=False)]
    assert [step // PERIOD_NS for step in steps] == [1, 1, 1, 1, 1, 3, 1]
    assert found.max_s == pytest.approx(0.0101)
    assert found.share_s(0.5) == pytest.approx(1e-4)
    assert found.share_s(7 / 8) == pytest.approx(10**2.7 * 1e-6, rel=1e-3), "0.5 ms late, by the edge of its bin"
    # 30 % of the period is worked in every cycle
    assert clock.ns - clock.deadlines[-1] == pytest.approx(0.3 * PERIOD_NS, abs=400_000)


def test_a_stop_ends_it() -> None:
    asked = iter([False, False, True])
    assert measure(1e6, RATE_HZ, Clock({}), lambda: next(asked)).cycles == 2


@pytest.mark.parametrize(
    ("late_s", "bin_number"), [(0.0, 0), (1e-6, 0), (1.1e-6, 1), (1e-5, 10), (10.0, 70), (99.0, 71)]
)
def test_each_cycle_has_one_bin(late_s: float, bin_number: int) -> None:
    found = Histogram()
    found.add(late_s)
    assert (found.counts.index(1), sum(found.counts), found.max_s) == (bin_number, 1, late_s)
    assert found.share_s(1.0) == late_s if late_s > 10.0 else found.share_s(1.0) <= late_s


@pytest.mark.parametrize(
    ("found", "rate_hz", "fitness"),
    [
        (result(2.4e-3), 200.0, Fitness.FIT),
        (result(2.6e-3), 200.0, Fitness.DOUBTFUL),
        (result(2.4e-3), 500.0, Fitness.DOUBTFUL),
        (result(2.6e-3, others=900), 200.0, Fitness.UNFIT),
        (result(1e-4, loaded=False), 200.0, Fitness.DOUBTFUL),
        (result(1e-4, real_time=RealTime("SCHED_OTHER", 0, 0)), 200.0, Fitness.DOUBTFUL),
        (replace(result(1e-4), histogram=Histogram()), 200.0, Fitness.UNFIT),
    ],
)
def test_a_host_is_fit_when_no_cycle_is_later_than_half_a_period(
    found: Latency, rate_hz: float, fitness: Fitness
) -> None:
    assert found.fitness(rate_hz) is fitness


def test_what_is_kept_is_read_back_and_the_newest_counts(tmp_path: Path) -> None:
    old, new = tmp_path / "state" / "latency.json", tmp_path / "latency.json"
    keep(old, result(1e-3))
    before = os.umask(0o077)
    try:
        keep(new, replace(result(2e-3), utc_ns=8))
    finally:
        os.umask(before)
    assert stat.S_IMODE(new.stat().st_mode) == 0o644, "agents of other users read root's"
    (tmp_path / "odd.json").write_text('{"schema": 1, "counts": []}')
    assert newest([tmp_path / "none", tmp_path / "odd.json", old]) == result(1e-3)
    assert newest([new, old]) == replace(result(2e-3), utc_ns=8)
    assert newest([]) is None
    document = json.loads(old.read_text())
    assert document["late_s"] == pytest.approx({"p50": 1e-5, "p99": 1e-5, "p99_9": 1e-5, "max": 1e-3})
    assert (document["cycles"], sum(document["counts"]), document["fitness"]) == (100_000, 100_000, "fit")
    assert len(document["counts"]) == len(EDGES_US) + 1


@pytest.mark.parametrize("odd", [None, {}, [], "x", math.inf, 10**400, [None], True], ids=range(8))
def test_a_file_of_anything_is_a_test_that_can_be_told_or_none(tmp_path: Path, odd: object) -> None:
    path = tmp_path / "latency.json"
    for key in result(1e-3).document():
        path.write_text(json.dumps(result(1e-3).document() | {key: odd}))
        found = newest([path])
        assert found is None or (found.text and found.fitness(200.0))
    for text in ("", "[" * 100_000, json.dumps(odd)):
        path.write_text(text)
        assert newest([path]) is None


def test_a_user_keeps_it_at_home_and_root_for_the_host() -> None:
    assert own_file({"HOME": "/home/ann"}, 1000) == Path("/home/ann/.local/state/coop/latency.json")
    assert own_file({"HOME": "/home/ann", "XDG_STATE_HOME": "/s"}, 1000) == Path("/s/coop/latency.json")
    assert own_file({"HOME": "/root"}, 0) == SYSTEM_FILE
    assert files({}) == (SYSTEM_FILE,), "a service has no home"


def test_load_ends_with_its_block() -> None:
    started = []

    class Recorded(latency.subprocess.Popen):  # type: ignore[type-arg,name-defined,misc]
        def __init__(self, *words: object, **more: object) -> None:
            super().__init__(*words, **more)
            started.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(latency.subprocess, "Popen", Recorded)
        with latency.load(2):
            assert [worker.poll() for worker in started] == [None, None]
    assert [worker.returncode for worker in started] == [-9, -9]


def test_what_a_process_has_got_is_what_the_kernel_says() -> None:
    assert granted().policy == "SCHED_OTHER"
    assert not granted().real
    assert FIFO.real
    assert FIFO.text == "SCHED_FIFO 80, 1 MB of memory locked"


def test_the_command_measures_judges_and_keeps(tmp_path: Path) -> None:
    path = tmp_path / "new" / "latency.json"
    done = coop("latency-test", "--seconds", 1, "--priority", 0, "--no-load", "--out", path)
    assert done.code == 1, "without real time and load a host is doubtful at best"
    assert done.out.split(":")[0] in ("doubtful", "unfit")
    kept = newest([path])
    assert kept is not None
    assert kept.histogram.cycles + kept.histogram.missed >= 200
    assert (kept.loaded, kept.real_time.policy) == (False, "SCHED_OTHER")
    assert gc.isenabled(), "for the tests behind this one"


@pytest.mark.parametrize("locks", [True, False])
def test_a_host_that_grants_no_real_time_is_told_what_does_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, locks: bool
) -> None:
    """The test asks for it unless told otherwise, so that there is nothing to leave out."""

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=lambda _: 0 if locks else 1))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    done = coop("latency-test", "--seconds", 1, "--no-load", "--out", tmp_path / "latency.json")
    assert done.code == 8
    assert done.err.endswith("(the shipped unit does), or measure without it: --priority 0\n")
    with pytest.raises(realtime.RealtimeError, match=r"or leave out --priority \(real arms .* --allow-no-realtime"):
        realtime.become_realtime(80)


def test_a_place_that_takes_no_file_is_refused_before_anything_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(*_: object) -> None:
        pytest.fail("somebody would have waited for this")

    monkeypatch.setattr(latency, "measure", measured)
    done = coop("latency-test", "--priority", 0, "--no-load", "--out", "/proc/latency.json")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("coop: file /proc/latency.json: found ")
    assert done.err.endswith("expected a folder to write it into; name another path\n")


@pytest.mark.parametrize("as_json", [False, True])
def test_one_that_is_stopped_is_told_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    def stopped(seconds: float, rate_hz: float, clock: AnyClock, stop: Callable[[], bool]) -> Histogram:
        asked = iter(range(100))

        def asks() -> bool:
            if next(asked) == 3:
                os.kill(os.getpid(), signal.SIGINT)
            return stop()

        return measure(seconds, rate_hz, clock, asks)

    path = tmp_path / "latency.json"
    keep(path, result(1e-3))
    monkeypatch.setattr(latency, "measure", stopped)
    words = ("latency-test", "--seconds", 600, "--priority", 0, "--no-load", "--out", path)
    done = coop(*words, *(["--json"] if as_json else []))
    assert done.code == 130
    assert f"stopped by request; this result is not kept, and {path} is as it was\n" in (
        done.err if as_json else done.out
    )
    assert "kept in" not in done.out + done.err
    assert newest([path]) == result(1e-3)
    if as_json:
        assert json.loads(done.out)["cycles"] == 3
