"""How the loop of a floating arm is put together, and what it makes of each end of its run; the run is played."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.around import Beginning, RunSummary, Surroundings
from agent.config import floating
from agent.config.cell import Cell, load_cell
from agent.grip import GripResult
from agent.loop import Agent, initial_memory
from agent.modes import Event, Mode
from agent.process import float_loop
from agent.process.build import build_agent
from agent.process.float_loop import FloatError, FloatLoop, Floats, Grasp
from agent.telemetry.row.event import Level
from agent.ticks import NOT_YET_NS
from drivers.dynamixel.arm_map import JointRole
from drivers.interface import GripState, StaleStateError
from tests.support.servos.float_rig import Rows

ALONE = ('floating.arms=["left"]',)
HOLDING = (*ALONE, "floating.holding=true")
TOGETHER = (*HOLDING, "floating.others_move=true")
SUMMARY = RunSummary(7, 0, 0, Mode.OFF, "", 1.0)
NOW_NS = 5_000_000_000


@cache
def cell_of(*settings: str) -> Cell:
    return load_cell(Path("two_wx200"), [*settings])


@cache
def agent_of(name: str, *settings: str) -> Agent:
    cell = cell_of(*settings)
    return build_agent(cell, cell.arm(name))


# --- the arm ----------------------------------------------------------------------------------------------------------


def test_an_arm_that_takes_no_part_is_refused() -> None:
    assert not Floats.of(cell_of(*ALONE), "left").moves
    assert Floats.of(cell_of(*TOGETHER), "right").moves
    with pytest.raises(FloatError, match=r"arm right: found no floating.arms that names it, expected one; `coop float"):
        Floats.of(cell_of(*ALONE), "right")


def test_a_floating_arm_may_stand_anywhere_but_for_joints_that_are_held() -> None:
    cell = cell_of(*ALONE)
    servos = Floats.of(cell, "left").servos("here")
    assert servos.port == "here"
    assert {joint.name for joint in servos.joints if joint.role is JointRole.CONTROLLED} == {
        joint.name for joint in servos.joints if joint.start_rad is None and joint.role is not JointRole.GRIPPER
    }
    assert any(joint.role is JointRole.HELD and joint.start_rad is not None for joint in servos.joints)


def test_an_arm_that_moves_begins_where_the_motion_does_if_the_cell_may_run(monkeypatch: pytest.MonkeyPatch) -> None:
    starts, required = [np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])], []
    report = SimpleNamespace(q_start=starts, require=lambda: required.append(1))
    monkeypatch.setattr(float_loop, "examine", lambda _: report)
    servos = Floats.of(cell_of(*TOGETHER), "right").servos("here")
    assert required == [1]
    assert [j.start_rad for j in servos.joints if j.role is JointRole.CONTROLLED] == starts[1].tolist()


# --- the loop ---------------------------------------------------------------------------------------------------------


class Gripper:
    def __init__(self) -> None:
        self.widths: list[float] = []
        self.states: list[GripState | None] = []

    def grip(self, width_m: float) -> None:
        self.widths.append(width_m)

    def grip_state(self) -> GripState | None:
        return self.states.pop(0)


class Bench:
    """A loop around a runner that does as the test says; what it was given, and what was told."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, name: str, *settings: str, builds: bool = False, guarded: bool = True
    ) -> None:
        self.runs: list[Callable[[], RunSummary]] = [lambda: SUMMARY]
        self.runners: list[tuple[Any, ...]] = []
        self.begun_by: list[Event] = []
        self.told: list[Any] = []
        self.beats: list[str] = []
        self.stops = False
        clock = SimpleNamespace(process_time=iter([10.0, 12.5]).__next__, perf_counter_ns=lambda: 0)
        monkeypatch.setattr(float_loop, "time", clock)
        monkeypatch.setattr(float_loop, "Runner", self._runner)
        heart = SimpleNamespace(mode=self._heart, beat=self._beat("heart"), busy=self._beat("heart is busy"))
        monkeypatch.setattr(float_loop, "Heart", lambda *_: heart)
        monkeypatch.setattr(float_loop, "ServoTeller", lambda *_: SimpleNamespace(beat=self._beat("servos")))
        self.cell = cell_of(*settings)
        floats = Floats.of(self.cell, name)
        self.agent, self.ring, self.gripper = agent_of(name, *settings), Rows(), Gripper()
        self.ring.kept = [None] * 9
        tell = SimpleNamespace(event=self._event, end=self._end, trouble=None, warn=self._warn)
        now = SimpleNamespace(now_ns=lambda: NOW_NS, utc_offset_ns=0)
        told = SimpleNamespace(start_ns=lambda: 77, entered=lambda mode: self.told.append(("entered", mode)))
        given: Any = (floats, self.gripper, now, self.ring, lambda: self.stops, tell, None, None)
        guard = SimpleNamespace(busy=self._beat("guard is told")) if guarded else None
        more: Any = {
            "shared": False,
            "guard": guard,
            "agent": None if builds else self.agent,
            "told": told if floats.moves else None,
        }
        monkeypatch.setattr(float_loop, "build_agent", lambda *_: self.agent if builds else pytest.fail("it has one"))
        self.loop = FloatLoop(*given, **more)

    def _runner(self, *given: Any) -> Any:
        self.runners.append(given)
        return SimpleNamespace(run=self._run, memory=self.memory)

    @property
    def memory(self) -> Any:
        """Of a runner: what it had when it failed."""
        return initial_memory(self.agent)._replace(
            hold=(0.0,) * 7, q_hold=np.ones(3), primed=True, age=4.0, dq=np.full(3, 0.25)
        )

    def _run(self, event: Event) -> RunSummary:
        self.begun_by.append(event)
        return self.runs.pop(0)()

    def _beat(self, name: str) -> Callable[[], None]:
        return lambda: self.beats.append(name)

    def _heart(self, mode: Mode) -> None:
        self.told.append(mode)

    def _event(self, level: Level, text: str, **data: float) -> None:
        self.told.append((level, text, data) if data else (level, text))

    def _warn(self, text: str) -> None:
        self.told.append(text)

    def _end(self, summary: RunSummary, cpu_s: float) -> None:
        assert cpu_s == 2.5, "of this run alone"
        self.told.append(summary)

    def beginning(self, place: int = 0) -> Beginning:
        found = self.runners[place][-1]
        assert isinstance(found, Beginning)
        return found


def test_an_arm_floats_without_end_and_one_that_moves_holds_at_the_end_of_the_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    alone, moves = (
        Bench(monkeypatch, "left", *ALONE).loop.schedule,
        Bench(monkeypatch, "right", *TOGETHER).loop.schedule,
    )
    assert (alone.hold_at_end, moves.hold_at_end) == (True, True)
    assert alone.ticks == 1 << 40
    cell = cell_of(*TOGETHER)
    assert moves.ticks == round(cell.file.duration_s * cell.file.rate_hz)


def test_a_loop_without_an_agent_builds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *ALONE, builds=True)
    bench.loop.run()
    assert bench.runners[0][0] is bench.agent


def test_an_arm_that_sinks_lies_after_as_many_cycles_as_its_weight_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *ALONE)
    bench.loop.run()
    operator, sinking = bench.runners[0][6].operator, bench.agent.floating
    assert sinking is not None
    cycles = round(sinking.sink_s * bench.cell.file.rate_hz)
    bench.loop._mode_changed(Mode.SINK)
    assert {operator() for _ in range(cycles - 1)} == {Event.NONE}
    assert Event.ARRIVED in [operator(), operator()]


@pytest.mark.parametrize(
    ("name", "settings", "event", "zero_ns", "start_ns"),
    [
        ("left", ALONE, Event.FLOATED, NOW_NS, None),
        ("right", TOGETHER, Event.ENABLED, NOW_NS + NOT_YET_NS, 77),
    ],
)
def test_a_loop_begins_without_torque_and_tells_its_end(
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    settings: tuple[str, ...],
    event: Event,
    zero_ns: int,
    start_ns: int | None,
) -> None:
    bench = Bench(monkeypatch, name, *settings)
    assert bench.loop.run() is SUMMARY
    begins = bench.beginning()
    assert (begins.mode, begins.zero_ns, begins.rows, begins.reason) == (Mode.OFF, zero_ns, 0, "")
    assert begins.memory.flatten() == initial_memory(bench.agent).flatten()
    assert bench.begun_by == [event]
    assert bench.told[-1] is SUMMARY
    agent, driver, _, schedule, _, ring, around, monitors, _ = bench.runners[0]
    assert (agent, driver, schedule, ring) == (bench.agent, bench.gripper, bench.loop.schedule, bench.ring)
    assert around.start_ns() == start_ns
    assert monitors is not None
    around.mode_changed(Mode.STAND)
    assert Mode.STAND in bench.told
    assert (("entered", Mode.STAND) in bench.told) is (start_ns is not None)
    around.heartbeat()
    assert bench.beats == ["heart", "servos"]


@pytest.mark.fault("P7")
@pytest.mark.parametrize("guarded", [True, False])
def test_an_arm_that_floats_tells_its_guard_before_what_takes_longer_than_a_cycle(
    monkeypatch: pytest.MonkeyPatch, guarded: bool
) -> None:
    bench = Bench(monkeypatch, "left", *ALONE, guarded=guarded)
    bench.loop.run()
    around: Surroundings = bench.runners[0][6]
    around.busy()
    assert bench.beats == ["heart is busy", *(["guard is told"] if guarded else [])]


def test_a_stop_is_asked_for_with_the_speed_of_the_fastest_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *ALONE)
    bench.loop.run()
    asked: list[float] = []
    ending: Any = SimpleNamespace(events=lambda fastest: asked.append(fastest) or Event.STOP)
    bench.loop._ending = ending
    bench.ring.row["dq"][:] = 0.0
    bench.ring.row["dq"][:3] = (0.1, -0.4, 0.2)
    assert bench.runners[0][6].operator() is Event.STOP
    assert asked == [0.4]


def test_monitors_are_those_of_a_floating_arm_and_warn_as_the_ending_lets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    monkeypatch.setattr(float_loop, "Monitors", lambda *given: made.append(given))
    bench = Bench(monkeypatch, "left", *ALONE)
    floats = Floats.of(bench.cell, "left")
    ((bounds, warn),) = made
    assert bounds == floating.bounds(bench.cell, floats.arm, floats.spec)
    warn("x")
    bench.loop._mode_changed(Mode.SINK)
    warn("y")
    assert "x" in bench.told
    assert "y" not in bench.told


def test_an_arm_has_stopped_by_itself_unless_somebody_had_asked_it_to(monkeypatch: pytest.MonkeyPatch) -> None:
    for asked in (False, True):
        bench = Bench(monkeypatch, "left", *ALONE)
        bench.loop._tell.trouble = bench.told.append
        bench.loop.run()
        around = bench.runners[0][6]
        bench.stops = asked
        assert around.operator() is (Event.STOP if asked else Event.NONE)
        bench.stops = False
        around.trouble("it is too quick")
        assert bench.loop.stopped_by == ("" if asked else "it is too quick")
        assert "it is too quick" in bench.told


def test_an_arm_that_another_process_let_float_goes_on_in_its_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *HOLDING)
    stands = Beginning(Mode.STAND, initial_memory(bench.agent), 3, 5, "the agent has died")
    bench.loop.run(stands)
    assert bench.beginning() is stands
    assert bench.begun_by == [Event.NONE]
    assert bench.told[0] is Mode.STAND
    assert len(bench.gripper.widths) == 1, "it may have stopped meanwhile"


def failing(error: Exception) -> Callable[[], RunSummary]:
    def run() -> RunSummary:
        raise error

    return run


def test_a_refusal_ends_the_run_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *ALONE)
    bench.runs = [failing(StaleStateError("state", found="none", expected="one", remedy="look"))]
    with pytest.raises(StaleStateError):
        bench.loop.run()
    assert (len(bench.runners), bench.told) == (1, [])


def test_an_error_of_the_loop_itself_lets_the_arm_stand_and_is_raised_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch, "left", *ALONE)
    bench.runs = [failing(RuntimeError("a defect")), lambda: SUMMARY]
    with pytest.raises(RuntimeError, match="a defect"):
        bench.loop.run()
    again = bench.beginning(1)
    assert (again.mode, again.zero_ns, again.rows, again.reason) == (Mode.STAND, NOW_NS, 9, "the loop failed")
    memory = again.memory
    assert (memory.hold, memory.q_hold, memory.primed, memory.age) == (None, None, False, 0.0)
    assert memory.dq.tolist() == [0.25] * 3, "all else is as it was"
    assert bench.begun_by == [Event.FLOATED, Event.NONE]
    assert bench.told[0] == (Level.ERROR, "the loop failed: RuntimeError: a defect")
    assert bench.told[1] is Mode.STAND
    assert bench.told[-1] is SUMMARY


# --- the gripper ------------------------------------------------------------------------------------------------------


def test_an_arm_that_floats_with_the_object_closes_its_gripper_first(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "left", *HOLDING)
    bench.loop.run()
    assert bench.gripper.widths == [
        Grasp(Floats.of(bench.cell, "left"), bench.gripper, bench.loop._tell)._plan.closed_m
    ]  # type: ignore[arg-type]
    alone = Bench(monkeypatch, "left", *ALONE)
    alone.loop.run()
    assert alone.gripper.widths == []


@pytest.mark.parametrize(
    ("width_m", "effort", "level", "verdict"),
    [(0.0, 1.0, Level.INFO, GripResult.HOLDS), (-0.02, 1.0, Level.WARN, GripResult.NOTHING)],
)
def test_what_came_of_closing_is_told_once(
    monkeypatch: pytest.MonkeyPatch, width_m: float, effort: float, level: Level, verdict: GripResult
) -> None:
    """width_m: beyond that of the object."""
    bench = Bench(monkeypatch, "left", *HOLDING)
    bench.loop.run()
    operator = bench.runners[0][6].operator
    grasp = bench.loop._grasp
    assert grasp is not None
    end_m = grasp._plan.width_m + width_m
    bench.gripper.states = [
        None,
        *(
            GripState(round(t * 1e9), end_m + 0.01 * (t < 0.3), -0.02 * (t < 0.3), effort, 1.0)
            for t in (0.0, 0.2, 0.4, 0.44, 0.6)
        ),
    ]
    bench.told.clear()
    for _ in range(5):
        operator()
        assert bench.told == []
    operator()
    told = (level, f"gripper {verdict.value}, {end_m * 1e3:.1f} mm", {"width_m": end_m})
    assert bench.told == [told]
    operator()
    assert bench.told == [told], "and it is not asked any more"


def test_a_gripper_that_cannot_be_closed_keeps_its_place() -> None:
    file = SimpleNamespace(gripper=SimpleNamespace(closed_tick=None, open_tick=1, horn_radius_m=1.0, rod_length_m=1.0))
    floats: Any = SimpleNamespace(arm=SimpleNamespace(file=file))
    nobody: Any = None
    assert Grasp.of(floats, nobody, nobody) is None
