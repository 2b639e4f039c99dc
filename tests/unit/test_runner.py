"""The loop around `step`: start, stop, release, lost states, servo faults, lateness; on a clock that the test moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.modes import Event, Mode, next_mode
from agent.process.build import build_agent
from agent.runner import Runner, RunSummary, Schedule, Surroundings
from agent.safety import Flag
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.check import examine
from drivers.interface import ArmInfo, BusCounters, JointState, ServoFault, ServoHealth, StaleStateError, Vector

CELL = load_cell(configs.CELLS_DIR / "paper.toml")
ARM = CELL.arms[0]
Q_START = examine(CELL).q_start[0]
PERIOD_NS = CELL.period_ns
START_AFTER = 10  # cycles of READY


class MovedClock:
    """Time passes in `sleep_until`, and where the test says so."""

    utc_offset_ns = 6_000_000_000

    def __init__(self) -> None:
        self.ns = 1_000_000_000

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


class StillArm:
    """An arm that stays at its start pose, and fails on the reads the test names."""

    def __init__(self, clock: MovedClock, failures: Mapping[int, Exception], pauses_ns: Mapping[int, int]) -> None:
        self.counters = BusCounters()
        self.clock = clock
        self.failures = failures
        self.pauses_ns = pauses_ns
        self.reads = 0
        self.written: list[Vector] = []

    def connect(self) -> ArmInfo:
        raise NotImplementedError

    def enable(self) -> None: ...

    def read(self) -> JointState:
        self.reads += 1
        self.clock.ns += self.pauses_ns.get(self.reads, 0)
        if self.reads in self.failures:
            raise self.failures[self.reads]
        return self.state()

    def state(self) -> JointState:
        return JointState(self.clock.ns, Q_START.copy(), np.zeros(3), np.full(3, np.nan))

    def write(self, tau_Nm: Vector) -> Vector:
        assert np.isfinite(tau_Nm).all()
        self.written.append(tau_Nm.copy())
        return tau_Nm

    def health(self) -> ServoHealth:
        raise NotImplementedError

    def disable(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class Log:
    """Rows as they were committed."""

    message: Any = field(default_factory=lambda: np.zeros((), AGENT_STATE.dtype))
    rows: list[Any] = field(default_factory=list)

    def commit(self) -> None:
        self.rows.append(self.message.copy())

    def wait_for_space(self) -> None: ...


@dataclass
class Outcome:
    """What a run of the loop left."""

    summary: RunSummary
    arm: StillArm
    rows: Any
    modes: list[Mode]


def lost() -> StaleStateError:
    return StaleStateError("state", found="no reply", expected="a reply", remedy="check the cable")


def fault(arm_state: bool) -> ServoFault:
    error = ServoFault("servo 2", found="torque off", expected="on", remedy="look")
    if arm_state:
        error.state = JointState(0, Q_START.copy(), np.zeros(3), np.full(3, np.nan))
    return error


def run(
    operator: Callable[[int], Event] = lambda _: Event.NONE,
    failures: Mapping[int, Exception] | None = None,
    pauses_ns: Mapping[int, int] | None = None,
    *,
    ticks: int = 20,
    hold_at_end: bool = False,
    start: bool = True,
) -> Outcome:
    clock = MovedClock()
    arm = StillArm(clock, failures or {}, pauses_ns or {})
    log = Log()
    modes: list[Mode] = []
    zero_ns = clock.ns + START_AFTER * PERIOD_NS + PERIOD_NS // 3
    schedule = Schedule(PERIOD_NS, ticks, False, 3, 8, hold_at_end)
    around = Surroundings(
        wall_ns=clock.now_ns,
        operator=lambda: operator(arm.reads),
        start_ns=lambda: zero_ns if start and arm.reads > 2 else None,
        heartbeat=lambda: None,
        mode_changed=modes.append,
    )
    row = AgentRow(log.message, 3, CELL.config_id)
    runner = Runner(build_agent(CELL, ARM), arm, clock, schedule, row, log, around)
    summary = runner.run()
    return Outcome(summary, arm, np.array(log.rows), modes)


def test_the_start_pose_is_held_until_the_common_instant() -> None:
    done = run()
    rows = done.rows
    assert done.modes == [Mode.TRACK]
    ready = rows["mode"] == Mode.READY
    assert (rows["t"][~ready] >= 0).all()
    assert rows["t"][~ready][0] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(rows["t"][~ready]) == pytest.approx(PERIOD_NS * 1e-9)
    assert rows["e_p"][ready] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(rows["e_p"][~ready]).max() > 1e-3, "the trajectory starts 3 mm away"
    assert len(rows[~ready]) == 20


def test_without_a_start_the_arm_goes_on_holding_its_start_pose() -> None:
    done = run(lambda reads: Event.STOP | Event.RELEASED if reads > 40 else Event.NONE, start=False)
    assert done.modes == [Mode.HOLD, Mode.OFF]
    assert (done.rows["mode"][:40] == Mode.READY).all()


def test_rows_are_numbered_without_gaps() -> None:
    rows = run(failures={15: lost()}).rows
    assert rows["sequence"].tolist() == list(range(len(rows)))


def test_every_row_is_stamped_with_the_clocks_own_tie_to_utc() -> None:
    rows = run(failures={15: lost()}).rows
    assert set((rows["utc_ns"] - rows["stamp_ns"]).tolist()) == {MovedClock.utc_offset_ns}


def test_an_idle_cycle_changes_no_mode() -> None:
    """The loop asks for the next mode only when something has happened."""
    assert all(next_mode(mode, Event.NONE) is mode for mode in Mode)


def test_a_stop_holds_and_only_a_release_ends_it() -> None:
    done = run(lambda n: Event.STOP if n == 20 else Event.RELEASED if n == 60 else Event.NONE, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    hold = done.rows["mode"] == Mode.HOLD
    assert np.abs(done.rows["e_p"][hold]).max() < 5e-4, "but for what the observer still expects of the motion"
    assert 35 < hold.sum() < 45


def test_the_end_of_the_trajectory_is_held_on_real_arms() -> None:
    done = run(lambda n: Event.RELEASED if n == 80 else Event.NONE, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    tracked = done.rows[done.rows["mode"] == Mode.TRACK]
    assert len(tracked) == 20


def test_single_lost_states_keep_the_last_torque_and_go_on() -> None:
    done = run(failures={15: lost(), 18: lost()})
    assert done.summary.mode is Mode.TRACK
    assert done.summary.stale_cycles == 2
    stale = np.flatnonzero(done.rows["flags"] & Flag.STALE.value)
    assert len(stale) == 2
    for i in stale:
        assert np.isnan(done.rows["q"][i][:3]).all()
        np.testing.assert_array_equal(done.arm.written[i], done.arm.written[i - 1])


def test_states_lost_in_a_row_hold_the_object() -> None:
    done = run(
        lambda n: Event.RELEASED if n == 40 else Event.NONE,
        failures={i: lost() for i in range(15, 20)},
        hold_at_end=True,
    )
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    assert "no reply" in done.summary.reason


def test_a_bus_that_stays_silent_ends_in_fault() -> None:
    done = run(failures={i: lost() for i in range(15, 60)}, hold_at_end=True)
    assert done.summary.mode is Mode.FAULT
    assert done.arm.reads < 30


def test_a_servo_fault_holds_the_object_with_the_others() -> None:
    done = run(lambda n: Event.RELEASED if n == 40 else Event.NONE, failures={15: fault(True)}, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    assert "torque off" in done.summary.reason


def test_a_servo_fault_without_a_state_ends_in_fault() -> None:
    assert run(failures={15: fault(False)}).summary.mode is Mode.FAULT


def test_a_late_cycle_keeps_the_phase_and_is_not_caught_up() -> None:
    done = run(pauses_ns={20: int(3.4 * PERIOD_NS)})
    tracked = done.rows[done.rows["mode"] == Mode.TRACK]
    phase = (tracked["stamp_ns"] - tracked["stamp_ns"][0]) % PERIOD_NS
    assert (np.minimum(phase, PERIOD_NS - phase) == 0).sum() >= len(tracked) - 1
    assert len(tracked) == 20 - 3


def test_an_early_release_does_nothing_while_tracking() -> None:
    done = run(lambda n: Event.RELEASED if n == 20 else Event.NONE)
    assert done.modes == [Mode.TRACK]
    assert done.summary.mode is Mode.TRACK
