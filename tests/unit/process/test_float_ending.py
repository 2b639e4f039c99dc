"""When a floating arm stops, sinks and gets no torque any more: at the bounds of the times, on a clock of the test."""

from __future__ import annotations

from typing import Any

import pytest

from agent.modes import Event, Mode
from agent.process.float_loop import SINKS, STANDS, Ending
from agent.telemetry.row.event import Level

PERIOD_S, SINK_S = 0.125, 2.0  # sums of them are exact
NS = 1_000_000_000
NAN = float("nan")


class Bench:
    """An ending in a mode that has just begun, None: as it is made; and what it said."""

    def __init__(self, mode: Mode | None, sink_s: float = SINK_S) -> None:
        self.now_ns, self.stops = 7 * NS, False
        self.said: list[tuple[Level, str]] = []
        self.warned: list[str] = []
        self.ending = Ending(lambda: self.stops, self._tell(), lambda: self.now_ns, sink_s, PERIOD_S)
        if mode is not None:
            self.ending.mode(mode)

    def _tell(self) -> Any:
        bench = self

        class Tell:
            def event(self, level: Level, text: str) -> None:
                bench.said.append((level, text))

            def warn(self, text: str) -> None:
                bench.warned.append(text)

        return Tell()

    def after(self, seconds: float, fastest: float = 0.0) -> Event:
        """One cycle, so long after the mode began."""
        self.now_ns = 7 * NS + round(seconds * NS)
        return self.ending.events(fastest)

    def cycles(self, count: int, fastest: float, seconds: float = 1.0) -> list[Event]:
        return [self.after(seconds, fastest) for _ in range(count)]


def test_it_floats_until_it_is_told_to_stop_seen_or_not() -> None:
    for mode, fastest in ((None, 0.0), (Mode.FLOAT, 2.0), (Mode.FLOAT, NAN)):
        bench = Bench(mode)
        assert bench.after(100.0, fastest) is Event.NONE
        bench.stops = True
        assert bench.after(0.0, fastest) is Event.STOP
        bench.stops = False
        assert bench.after(0.1, fastest) is Event.STOP, "a guard that is gone is told of once"


def test_it_stands_for_three_seconds_and_sinks_only_when_it_is_seen() -> None:
    bench = Bench(Mode.STAND)
    bench.stops = True
    assert bench.after(2.999, 0.0) is Event.NONE
    assert bench.after(3.0, NAN) is Event.NONE
    assert bench.after(3.0, 1.0) is Event.RELEASED


def test_it_lies_once_it_was_slow_for_half_a_second() -> None:
    bench = Bench(Mode.SINK)
    assert set(bench.cycles(16, 0.051)) == {Event.NONE}, "the weight is gone, and it moves"
    assert bench.cycles(4, 0.05) == [Event.NONE] * 3 + [Event.ARRIVED]
    bench = Bench(Mode.SINK)
    bench.cycles(16, 0.051)
    assert set(bench.cycles(3, 0.05)) == {Event.NONE}
    assert bench.after(1.0, 0.051) is Event.NONE
    assert bench.cycles(4, 0.05) == [Event.NONE] * 3 + [Event.ARRIVED], "one cycle of motion begins the count anew"
    assert Bench(Mode.SINK, 0.0).cycles(4, 0.05) == [Event.NONE] * 3 + [Event.ARRIVED], "of an arm without weight"


def test_it_lies_no_earlier_than_its_weight_is_gone_by_cycles_that_saw_it() -> None:
    bench = Bench(Mode.SINK)
    assert bench.cycles(16, 0.0) == [Event.NONE] * 15 + [Event.ARRIVED]
    bench = Bench(Mode.SINK)
    assert set(bench.cycles(15, 0.0)) == {Event.NONE}
    assert set(bench.cycles(20, NAN)) == {Event.NONE}
    assert bench.after(1.0, 0.0) is Event.ARRIVED


def test_an_arm_that_nobody_sees_goes_on_where_it_was_seen_last() -> None:
    bench = Bench(Mode.SINK)
    bench.cycles(16, 0.051)
    bench.cycles(3, 0.05)
    assert bench.after(1.0, NAN) is Event.NONE
    assert bench.after(1.0, 0.05) is Event.ARRIVED


@pytest.mark.parametrize("fastest", [1.0, NAN])
def test_after_half_a_minute_the_torque_goes_off_whatever_is_seen(fastest: float) -> None:
    bench = Bench(Mode.SINK)
    assert bench.after(29.999, fastest) is Event.NONE
    assert bench.after(30.0, fastest) is Event.ARRIVED


def test_each_mode_begins_its_times_anew_and_says_what_comes() -> None:
    bench = Bench(Mode.FLOAT)
    bench.cycles(20, 0.0)
    bench.now_ns = 20 * NS
    bench.ending.mode(Mode.STAND)
    assert bench.ending.events(0.0) is Event.NONE
    bench.ending.mode(Mode.SINK)
    assert bench.ending.events(0.0) is Event.NONE
    assert bench.said == [(Level.WARN, STANDS), (Level.WARN, SINKS)]
    assert "in 3 s it sinks" in STANDS


def test_monitors_have_nothing_to_say_of_an_arm_that_sinks_to_its_end_stops() -> None:
    for mode, heard in ((Mode.FLOAT, ["x"]), (Mode.STAND, ["x"]), (Mode.SINK, [])):
        bench = Bench(mode)
        bench.ending.warn("x")
        assert bench.warned == heard
