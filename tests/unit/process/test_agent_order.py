"""From the moment an arm has torque its servos' watchdogs run: what takes long on a busy host is done before it."""

from __future__ import annotations

import dataclasses
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import configs
from agent.around import RunSummary, Schedule, Surroundings
from agent.config.agent import build_agent
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line
from agent.guard.guarded import BUSY_S, UNGUARDED, Guarded
from agent.guard.line import GuardError
from agent.guard.takeover import stale_ns
from agent.host.notify import Notifier
from agent.host.signals import StopFlag
from agent.modes import TABLE, Mode
from agent.operator.socket import Standing
from agent.process import agent as process
from agent.process import let_go as ending
from agent.process.commands import AgentOptions
from agent.process.let_go import let_go
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.topics import Kind
from agent.verify.check import examine
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.line.codec import HEADER
from drivers.interface import ConnectError, Driver
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from tests.support.servos.dxl_rig import START, VirtualClock, VirtualPort, wiring
from tests.support.servos.tool_rig import WRITING

SLOW_NS = 500_000_000  # longer than any watchdog of a cell
MARKS = {"left": 1, "right": 2}
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml")
EXAMINED = cache(lambda: examine(CELL))


def swapped() -> tuple[EmulatedCell, VirtualPort, VirtualClock, DynamixelDriver]:
    """The driver of the left arm on the servos of the right one: they are alike but for their marks."""
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", [f"arms.{n}.dynamixel.mark={m}" for n, m in MARKS.items()])
    left, right = (arm_map(cell, arm, f"/dev/coop/{arm.name}", np.zeros(3)) for arm in cell.arms)
    emulated = EmulatedCell([EmulatedArm(wiring(right))], None, start_ns=10_000_000_000)
    injector = Injector(emulated.arms[0], None, seed=1)
    clock = VirtualClock(emulated, injector)
    port = VirtualPort(Line(emulated, 0, injector, clock), left.baud)
    return emulated, port, clock, DynamixelDriver(left, clock, scan_s=0.05, port=port)


@pytest.fixture(autouse=True)
def memory_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """An agent looks for garbage no more, in a process of its own; what it finds of the same cell is the same."""
    monkeypatch.setattr(process, "quiet_memory", lambda: None)
    monkeypatch.setattr(process, "examine", lambda cell: EXAMINED() if cell is CELL else examine(cell))


@pytest.mark.fault("G3")
def test_an_agent_at_another_arms_port_ends_in_one_line_and_has_written_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulated, port, clock, driver = swapped()
    monkeypatch.setattr(process, "build_driver", lambda *_: (driver, clock))
    said = list[str]()
    with pytest.raises(ConnectError) as refused:
        process.run_agent(CELL, options(tmp_path), StopFlag(), said.append)
    assert refused.value.exit_code == 3
    assert str(refused.value) == (
        "mark on /dev/coop/left: found 2, arm right's, expected 1, arm left's; the cables of left and right are swapped"
    )
    assert not [text for text in said if "torque" in text]
    assert port.writes
    assert not {data[len(HEADER) + 3] for data in port.writes} & WRITING
    assert emulated.arms[0].bus.counters.watchdog_trips == 0


def rig() -> tuple[EmulatedCell, VirtualClock, DynamixelDriver]:
    arm = CELL.arm("left")
    servos = arm_map(CELL, arm, "virtual", np.array([START[name] for name in arm.entry.controlled]))
    emulated = EmulatedCell([EmulatedArm(wiring(servos))], None, start_ns=10_000_000_000)
    injector = Injector(emulated.arms[0], None, seed=1)
    clock = VirtualClock(emulated, injector)
    port = VirtualPort(Line(emulated, 0, injector, clock), arm.baud)
    return emulated, clock, DynamixelDriver(servos, clock, scan_s=0.05, port=port)


def options(folder: Path, **more: Any) -> AgentOptions:
    usual: dict[str, Any] = {"driver": DriverKind.DYNAMIXEL, "emulated": True, "real_time": True, "hold": False}
    return AgentOptions(cell=Path(), arm="left", ring=folder / "left.ring", control=None, **(usual | more))


def test_a_host_that_builds_the_law_slowly_trips_no_watchdog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real loop and driver on emulated servos, in virtual time."""
    emulated, clock, driver = rig()
    build = build_agent

    def slowly(*given: Any) -> Any:
        clock.sleep_until(clock.now_ns() + SLOW_NS)
        return build(*given)

    stop, said = StopFlag(), list[str]()

    def ready(text: str) -> None:
        said.append(text)
        stop.stopped = text == "torque=on"

    monkeypatch.setattr(process, "build_agent", slowly)
    monkeypatch.setattr(process, "build_driver", lambda *_: (driver, clock))
    summary = process.run_agent(CELL, options(tmp_path), stop, ready)
    assert said[-1] == "torque=on"
    assert summary.ticks >= 1
    assert emulated.arms[0].bus.counters.watchdog_trips == 0


def test_what_takes_long_is_done_before_an_agent_is_a_real_time_thread_and_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its unit ends one that does not sleep for 50 ms."""
    _, clock, driver = rig()
    stop, done = StopFlag(), list[str]()

    def noted(name: str, does: Any) -> Any:
        return lambda *given, **named: (done.append(name), does(*given, **named))[1]

    def ready(text: str) -> None:
        stop.stopped = text == "torque=on"

    nothing = lambda *_: None  # noqa: E731
    for name in ("_law", "quiet_memory", "become_realtime", "leave_realtime"):
        where = ending if name == "leave_realtime" else process
        monkeypatch.setattr(where, name, noted(name, process._law if name == "_law" else nothing))
    for name in ("connect", "enable", "close"):
        monkeypatch.setattr(driver, name, noted(name, getattr(driver, name)))
    monkeypatch.setattr(process, "build_driver", lambda *_: (driver, clock))
    process.run_agent(CELL, options(tmp_path, priority=80), stop, ready)
    begun, ended = done[: done.index("enable") + 1], done[-2:]
    assert [name for name in begun if name != "close"] == [
        "connect", "_law", "quiet_memory", "become_realtime", "enable",
    ]  # fmt: skip
    assert ended == ["close", "leave_realtime"]


@pytest.mark.fault("C3")
def test_an_agent_tells_that_the_wall_clock_was_set_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, clock, driver = rig()
    stop, looks = StopFlag(), list[int]()

    def offset_ns() -> int:
        looks.append(clock.now_ns())
        stop.stopped = len(looks) == 2
        return clock.utc_offset_ns + 2_000_000_000

    monkeypatch.setattr(process, "utc_offset_ns", offset_ns)
    monkeypatch.setattr(process, "build_driver", lambda *_: (driver, clock))
    process.run_agent(CELL, options(tmp_path), stop, lambda _: None)
    assert looks[1] - looks[0] == pytest.approx(1e9, rel=1e-3), "once a second"
    texts = [text for kind, text in TextReader(tmp_path / "left.ring").read_new() if kind is Kind.EVENT]
    told = [event for text in texts if "wall clock" in (event := Event.from_json(text)).text]
    assert [(event.level, event.text) for event in told] == [(Level.WARN, "the wall clock was set by +2 s")]


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize(("driver", "real_time", "lockstep"), [
    (DriverKind.SIM, False, True), (DriverKind.SIM, True, False), (DriverKind.DYNAMIXEL, False, False),
])  # fmt: skip
def test_the_ticks_of_an_agent_are_as_it_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, driver: DriverKind, real_time: bool, lockstep: bool, hold: bool
) -> None:
    _, clock, servos = rig()
    schedules = list[Schedule]()

    def runner(_: object, __: object, ___: object, schedule: Schedule, *____: object, **_____: object) -> Any:
        schedules.append(schedule)
        return SimpleNamespace(run=lambda _: RunSummary(1, 0, 0, Mode.OFF, "", 0.0))

    monkeypatch.setattr(process, "build_driver", lambda *_: (servos, clock))
    monkeypatch.setattr(process, "_law", lambda *_: SimpleNamespace(agent=None, session=None, watch=None))
    monkeypatch.setattr(process, "Runner", runner)
    given = options(tmp_path, driver=driver, real_time=real_time, hold=hold)
    process.run_agent(CELL, given, StopFlag(), lambda _: None)
    assert [(made.lockstep, made.hold_at_end) for made in schedules] == [(lockstep, hold)]


@pytest.mark.parametrize(("lockstep", "times"), [(False, 1), (True, 0)])
def test_an_agent_that_nobody_guards_says_so_where_it_runs_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lockstep: bool, times: int
) -> None:
    _, clock, servos = rig()
    released = RunSummary(1, 0, 0, Mode.OFF, "", 0.0)
    monkeypatch.setattr(process, "build_driver", lambda *_: (servos, clock))
    monkeypatch.setattr(process, "_law", lambda *_: None)
    monkeypatch.setattr(process, "_runner", lambda *_: SimpleNamespace(run=lambda _: released))
    given = options(tmp_path, driver=DriverKind.SIM, real_time=not lockstep)
    process.run_agent(CELL, given, StopFlag(), lambda _: None)
    texts = [text for kind, text in TextReader(tmp_path / "left.ring").read_new() if kind is Kind.EVENT]
    told = [event for text in texts if (event := Event.from_json(text)).text == UNGUARDED]
    assert [event.level for event in told] == [Level.WARN] * times


def test_an_agent_that_finds_no_guard_leaves_what_it_found(tmp_path: Path) -> None:
    """`coop status` has it: of an agent that ended so it said that nothing was there."""
    with pytest.raises(GuardError, match="start it first") as refused:
        process.run_agent(CELL, options(tmp_path, guard=tmp_path / "left.guard"), StopFlag(), lambda _: None)
    texts = [text for kind, text in TextReader(tmp_path / "left.ring").read_new() if kind is Kind.EVENT]
    assert [(event.level, event.text) for event in map(Event.from_json, texts)] == [(Level.ERROR, str(refused.value))]


def arm_with(guard: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Emulated servos for the agent, and that guard, which may be None."""
    _, clock, servos = rig()
    monkeypatch.setattr(process, "_reached", lambda *_: guard)
    monkeypatch.setattr(process, "passed_on", lambda _: ((), {}))
    monkeypatch.setattr(process, "build_driver", lambda *_: (servos, clock))


@pytest.mark.fault("P7")
@pytest.mark.parametrize("guarded", [True, False])
def test_an_agent_says_why_nobody_goes_on_for_it_where_somebody_was_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, guarded: bool
) -> None:
    released = RunSummary(1, 0, 0, Mode.OFF, "", 0.0)
    guard = SimpleNamespace(
        missing="the guard hangs", watch=lambda *_, **__: None, busy=lambda: None, leave=lambda: None
    )
    stood: list[Standing] = []
    arm_with(guard if guarded else None, monkeypatch)
    monkeypatch.setattr(process, "_law", lambda *_: None)
    runner = SimpleNamespace(run=lambda _: released)
    monkeypatch.setattr(process, "_runner", lambda *given: stood.append(given[-1]) or runner)
    process.run_agent(CELL, dataclasses.replace(options(tmp_path), control=tmp_path / "c"), StopFlag(), lambda _: None)
    assert [standing.alone() for standing in stood] == ["the guard hangs" if guarded else ""]


@pytest.mark.fault("P7")
@pytest.mark.parametrize("guarded", [True, False])
def test_an_agent_tells_its_guard_and_the_service_manager_before_it_brings_its_arm_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, guarded: bool
) -> None:
    told = list[str]()
    guard = SimpleNamespace(
        missing="", watch=lambda *_, **__: None, leave=lambda: None, busy=lambda: told.append("guard")
    )
    notified = Notified()
    released = RunSummary(1, 0, 0, Mode.OFF, "", 0.0)

    def runner(*given: Any, **_: Any) -> SimpleNamespace:
        (around,) = (one for one in given if isinstance(one, Surroundings))
        around.busy()
        return SimpleNamespace(run=lambda _: released)

    arm_with(guard if guarded else None, monkeypatch)
    monkeypatch.setattr(process, "Notifier", lambda: notified)
    monkeypatch.setattr(process, "Runner", runner)
    process.run_agent(CELL, options(tmp_path), StopFlag(), lambda _: None)
    assert told == ["guard", "guard"] * guarded, "once now, and once when the torque goes off"
    assert notified.told[1:] == ["busy", "busy", "stopping: torque off"]


def test_an_agent_says_that_it_is_busy_before_its_torque_goes_off_and_leaves_its_guard_after_it() -> None:
    told = list[str]()
    driver, guard, notifier = (
        SimpleNamespace(**{name: partial(told.append, f"{who}: {name}") for name in names.split()})
        for who, names in (("driver", "disable close"), ("guard", "busy leave"), ("manager", "busy"))
    )
    notifier.stopping = lambda status: told.append(f"manager: {status}")
    let_go(cast(Driver, driver), cast(Guarded, guard), cast(Notifier, notifier))
    assert told == [
        "manager: busy", "guard: busy", "driver: disable", "guard: leave", "driver: close", "manager: torque off"
    ]  # fmt: skip
    told.clear()
    let_go(cast(Driver, driver), None, cast(Notifier, notifier))
    assert told == ["manager: busy", "driver: disable", "driver: close", "manager: torque off"]


def test_an_agent_whose_driver_takes_the_time_it_needs_for_its_torque_is_excused_for_longer() -> None:
    """A real arm's guard ends an agent that writes no row for that long."""
    _, clock, driver = rig()
    driver.connect()
    driver.enable()
    driver.read()
    driver.write(np.zeros(3))
    begin_ns = clock.now_ns()
    driver.disable()
    took_ns = clock.now_ns() - begin_ns
    assert stale_ns(CELL.period_ns, emulated=False, simulated=False) < took_ns < 0.25 * BUSY_S * 1e9


class Notified:
    """What a service manager is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def loading(self, status: str) -> None:
        self.told.append(f"loading: {status}")

    def ready(self, status: str) -> None:
        self.told.append(f"ready: {status}")

    def stopping(self, status: str) -> None:
        self.told.append(f"stopping: {status}")

    def alive(self) -> None: ...

    def busy(self) -> None:
        self.told.append("busy")

    def close(self) -> None: ...


@pytest.mark.parametrize(
    ("driver", "whole", "told", "remedy"),
    [
        (DriverKind.DYNAMIXEL, False, "ready: ", "see the log"),
        (DriverKind.SIM, True, "loading: ", process.LOST_REMEDY),
    ],
)
def test_an_arm_that_is_lost_ends_its_process_with_that_and_a_simulated_one_is_not_ready_before_all_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, driver: DriverKind, whole: bool, told: str, remedy: str
) -> None:
    _, clock, servos = rig()
    lost = RunSummary(1, 0, 1, Mode.FAULT, "nobody answers", 0.0)
    notified = Notified()
    monkeypatch.setattr(process, "Notifier", lambda: notified)
    monkeypatch.setattr(process, "build_driver", lambda *_: (servos, clock))
    monkeypatch.setattr(process, "_law", lambda *_: None)
    monkeypatch.setattr(process, "_runner", lambda *_: SimpleNamespace(run=lambda _: lost))
    with pytest.raises(process.ArmLost, match="nobody answers") as caught:
        process.run_agent(CELL, options(tmp_path, driver=driver, whole=whole), StopFlag(), lambda _: None)
    assert caught.value.remedy == remedy
    begins = TABLE[Mode.REST if whole else Mode.READY].says
    assert notified.told == [told + begins, "busy", "stopping: torque off"]
