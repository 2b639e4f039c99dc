"""A stop that a run has arranged: in one cycle of the trajectory, once, and it lets nothing go."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from agent.around import Schedule
from agent.config.cell import load_cell
from agent.host.signals import StopFlag
from agent.modes import Event, Mode
from agent.operator.socket import Standing
from agent.process.arranged import REASON, Arranged, arranged
from agent.process.children import Children
from agent.process.commands import EmulateCommand, PlantCommand
from agent.process.operated import Operator
from agent.process.run_kind import RunKind
from agent.telemetry.row.event import Level

PERIOD_NS, ZERO_NS = 5_000_000, 1_000_000_000


class Clock:
    """Says what it is told."""

    utc_offset_ns = 0
    at_ns = 0

    def now_ns(self) -> int:
        return self.at_ns

    def sleep_until(self, deadline_ns: int) -> None:
        raise AssertionError(deadline_ns)


class Told:
    """Remembers what the agent says."""

    def __init__(self) -> None:
        self.said: list[tuple[Level, str]] = []

    def __call__(self, level: Level, text: str, **data: float | str) -> None:
        assert not data
        self.said.append((level, text))


def operator(stop: StopFlag | None = None) -> tuple[Operator, Clock, Told, Standing]:
    clock, told, standing = Clock(), Told(), Standing("left")
    made = Operator(stop or StopFlag(), None, clock, told, drops_on_stop=True, standing=standing)
    return made, clock, told, standing


def schedule(*, lockstep: bool, ready_ns: int = 0) -> Schedule:
    return Schedule(PERIOD_NS, 100, lockstep, hold_at_end=False, ready_ns=ready_ns)


@pytest.mark.parametrize(("cycle", "ready"), [(0, 0), (3, 0), (3, 4)])
def test_in_lockstep_it_comes_in_its_cycle_whatever_the_arms_clock_says_and_no_second_time(
    cycle: int, ready: int
) -> None:
    asked = arranged(operator()[0], cycle, schedule(lockstep=True, ready_ns=ready * PERIOD_NS))
    heard = [asked.events() for _ in range(12)]
    assert [i for i, event in enumerate(heard) if event is Event.STOP] == [ready + cycle]
    assert set(heard) == {Event.STOP, Event.NONE}, "nothing is released, also in simulation"


def test_at_the_wall_clocks_pace_it_comes_with_the_first_cycle_at_its_instant_from_the_common_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, clock, _, _ = operator()
    asked = arranged(made, 3, schedule(lockstep=False, ready_ns=10**12))
    starts = iter([None, ZERO_NS])
    monkeypatch.setattr(made, "start_ns", lambda: next(starts))
    clock.at_ns = 10**15
    assert asked.events() is Event.NONE
    assert asked.start_ns() is None
    assert asked.events() is Event.NONE, "nobody has given a start"
    assert asked.start_ns() == ZERO_NS
    for since, event in ((-1, Event.NONE), (0, Event.NONE), (3, Event.STOP), (4, Event.NONE)):
        clock.at_ns = ZERO_NS + since * PERIOD_NS
        assert asked.events() is event, since
    late = Arranged(made, 3, PERIOD_NS, None)
    monkeypatch.setattr(made, "start_ns", lambda: ZERO_NS)
    late.start_ns()
    clock.at_ns = ZERO_NS + 3 * PERIOD_NS - 1
    assert late.events() is Event.NONE


def test_what_the_operator_says_besides_is_heard() -> None:
    stop = StopFlag()
    asked = arranged(operator(stop)[0], 3, schedule(lockstep=True))
    assert asked.events() is Event.NONE
    stop.stopped = True
    assert asked.events() == Event.STOP | Event.RELEASED


def test_the_arm_says_why_it_holds() -> None:
    made, _, told, standing = operator()
    asked = arranged(made, 0, schedule(lockstep=True))
    asked.events()
    made.mode(Mode.HOLD)
    assert standing.reason == REASON
    assert told.said == [(Level.WARN, REASON)]


def test_an_arm_for_which_nothing_is_arranged_asks_its_operator() -> None:
    made = operator()[0]
    assert arranged(made, None, schedule(lockstep=True)) is made
    made.mode(Mode.HOLD)
    assert made._standing.reason == "the trajectory has ended"


@pytest.mark.parametrize("kind", RunKind)
def test_every_kind_of_run_has_the_arm_stopped_that_holds(tmp_path: Path, kind: RunKind) -> None:
    faults = ["kind='limp', arm='left', at_s=1.0"]
    faults += [f"kind='hold', arm='right', at_s={at_s}" for at_s in (9.0, 2.001)]
    cell = load_cell(Path("two_wx200"), [f"simulation.fault=[{', '.join(f'{{{one}}}' for one in faults)}]"])
    made: Any = Children(cell, kind, 0, None, tmp_path / "run.mcap", tmp_path)
    assert made._agent_command("left").stop_in is None
    assert made._agent_command("right").stop_in == 401, "the soonest"
    plant = made._plant_command()
    assert isinstance(plant, EmulateCommand if kind is RunKind.WIRE else PlantCommand)
    assert plant.stops
