"""Each monitor trips on its own fault, at its bound and not before, by its name, and not when it is switched off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.monitors import bounds
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.monitors.bounds import Bounds, Name
from agent.monitors.gravity import WINDOW_S, WINDOWS
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.safety import Flag
from agent.standing import wait_here
from drivers.interface import JointState, ServoHealth
from tests.support.starts import start_joints

SHAPE = (3,)
JUST = 1e-6


@cache
def cell() -> Cell:
    return load_cell(configs.CELLS_DIR / "two_wx200.toml")


@cache
def agent() -> Agent:
    return build_agent(cell(), cell().arms[0])


@cache
def usual() -> Bounds:
    return bounds(cell(), cell().arms[0])


@cache
def at_rest() -> tuple[JointState, Outcome]:
    """A tick in READY at the start, in which the servos measure what the files say."""
    q = start_joints(cell())[0]
    state = JointState(0, q, np.zeros(SHAPE), np.zeros(SHAPE))
    memory = wait_here(agent(), q, initial_memory(agent()))
    outcome = step(agent(), state, -1.0, Mode.READY, memory)
    outcome = step(agent(), state, -0.995, Mode.READY, outcome.memory)
    assert outcome.terms is not None
    return replace(state, tau=outcome.terms.tau_gravity + outcome.terms.tau_object), outcome


@cache
def health() -> ServoHealth:
    """Of two servos: one tells its current, the other its load."""
    nan = float("nan")
    return ServoHealth(
        0, (4, 8), ("elbow", "wrist_rotate"), np.array([40.0, 40.0]), np.array([12.0, 12.0]), np.zeros(2, np.uint8),
        np.array([0.1, nan]), np.array([nan, 0.1]), np.array([80.0, 72.0]), np.array([9.5, 6.0]),
        np.array([16.0, 14.0]), np.array([2.3, 1.4]), np.zeros(2, np.int64),
    )  # fmt: skip


@dataclass
class Fed:
    """What the monitors are shown on every tick of a case."""

    mode: Mode = Mode.TRACK
    ticks: int = 1
    q: float = 0.0  # beside the start, of the first joint
    dq: float = 0.0  # of the second joint, as the law used it
    turn: float = 0.0  # the same of the third
    tau: float | None = None  # of the third, after the limits
    measured: float = 0.0  # beside the files, of the first joint
    flags: Flag = Flag.NONE
    up_m: float = 0.0  # the object, beside where it is
    shift: tuple[float, ...] = (0.0,) * 6  # of this arm's motion
    feedback: float = 0.0  # of the second joint
    up_m_per_s: float = 0.2  # what the motion asks for
    still_from: int = 0  # tick from which on, pushed by feedback, the second joint reads the same
    told: Callable[[int], ServoHealth] = lambda _: health()

    def run(self, b: Bounds, tell: Callable[[str], None] = lambda _: None) -> str:
        """What the monitors first say."""
        watch = Watch(b, tell)
        state, outcome = at_rest()
        assert outcome.terms is not None
        k = outcome.terms.kinematics
        x, y, z = k.p_object
        joints = outcome.terms.joints.copy()
        terms = outcome.terms._replace(kinematics=k._replace(p_object=(x, y, z + self.up_m)), joints=joints)
        terms.tau_feedback[:] = [0.0, self.feedback, 0.0]
        terms = terms._replace(desired=terms.desired._replace(v=(0.0, 0.0, self.up_m_per_s, 0.0, 0.0, 0.0)))
        tau = outcome.tau.copy()
        if self.tau is not None:
            tau[2] = self.tau
        for tick in range(self.ticks):
            reads = 1e-4 * (tick % 2) if self.feedback == 0.0 or tick < self.still_from else 0.0
            q = state.q + np.array([self.q, reads, 0.0])
            dq = np.array([0.0, self.dq, self.turn])
            seen = replace(state, q=q, tau=state.tau + np.array([self.measured, 0.0, 0.0]), stamp_ns=tick * 5_000_000)
            memory = outcome.memory._replace(shift=self.shift)  # type: ignore[arg-type]
            shown = outcome._replace(terms=terms, tau=tau, dq=dq, flags=self.flags, memory=memory)
            said = watch.after(seen, shown, self.mode, partial(self.told, tick))
            if said:
                return said
        return ""


def read_at(tick: int) -> ServoHealth:
    now_ns = tick * 5_000_000
    return replace(health(), stamp_ns=now_ns, slow_ns=np.array([now_ns, now_ns]))


def hot(tick: int, temperature_C: float = 78.0) -> ServoHealth:
    return replace(read_at(tick), temperature_C=np.array([temperature_C, 40.0]))


def low(tick: int, voltage_V: float = 9.6) -> ServoHealth:
    return replace(read_at(tick), voltage_V=np.array([voltage_V, 12.0]))


def loaded(tick: int, current_A: float = 2.0, load: float = 0.1) -> ServoHealth:
    nan = float("nan")
    return replace(
        health(), current_A=np.array([-current_A, nan]), load=np.array([nan, -load]), stamp_ns=tick * 5_000_000
    )


SPEED = usual().speed_rad_per_s[1]
HIGHEST = usual().position_rad[0][1] - float(start_joints(cell())[0][0])
ROOM_UP = usual().workspace_m[2][1] - cell().file.object.p_start_m[2]
POWER = usual().power_W[2]
TWENTY_MM = (0.012, -0.016, 2e-5)  # and ten billionths of a metre
WINDOWS_TICKS = round(WINDOWS * WINDOW_S * cell().file.rate_hz)
FAULTS: dict[Name, tuple[Fed, str]] = {
    Name.SPEED: (Fed(dq=-SPEED - JUST), "speed of elbow"),
    Name.POWER: (Fed(turn=0.9, tau=-POWER / 0.9 - JUST), "power of wrist_angle"),
    Name.POSITION: (Fed(q=HIGHEST + JUST, mode=Mode.READY), "position of shoulder"),
    Name.START: (Fed(mode=Mode.READY, shift=(*TWENTY_MM, 0.0, 0.0, 1e-3)), "start of the object"),
    Name.WORKSPACE: (Fed(up_m=ROOM_UP + 1e-4), "z of the object"),
    Name.SATURATED: (Fed(flags=Flag.SATURATED, ticks=51), "torque at its limit"),
    Name.RATE_LIMITED: (Fed(flags=Flag.RATE_LIMITED, ticks=51), "torque step at its limit"),
    Name.FROZEN: (Fed(feedback=usual().frozen_Nm[1] + JUST, ticks=60), "reading of elbow"),
    Name.LOAD: (Fed(tau=4.0, ticks=2_000), "load of wrist_angle"),
    Name.GRAVITY: (Fed(mode=Mode.READY, measured=2.0, ticks=WINDOWS_TICKS), "torque at rest"),
    Name.TEMPERATURE: (Fed(told=hot, ticks=100), "temperature of servo 4 (elbow)"),
    Name.VOLTAGE: (Fed(told=low, ticks=100), "supply of servo 4 (elbow)"),
    Name.SERVO_LOAD: (Fed(told=loaded, ticks=4_000), "load of servo 4 (elbow)"),
}


def test_every_monitor_has_a_counter_test() -> None:
    assert set(FAULTS) == set(Name)
    assert usual().watched == frozenset(Name)


@pytest.mark.parametrize("name", Name)
def test_a_monitor_trips_by_its_name_and_says_found_expected_and_remedy(name: Name) -> None:
    fed, what = FAULTS[name]
    said = fed.run(usual())
    assert said.startswith(f"monitor {name}: {what}: found ")
    assert ", expected " in said
    assert len(said.rpartition("; ")[2]) > 20


@pytest.mark.parametrize("name", Name)
def test_the_same_fault_goes_unnoticed_with_the_monitor_switched_off(name: Name) -> None:
    fed, _ = FAULTS[name]
    assert fed.run(replace(usual(), watched=frozenset(Name) - {name})) == ""


WITHIN = {
    "speed": Fed(dq=SPEED),
    "power": Fed(turn=0.9, tau=POWER / 0.9 - JUST),
    "position": Fed(q=HIGHEST),
    "start": Fed(mode=Mode.READY, shift=(0.012, -0.016, 0.0, 0.06, 0.0, -0.08)),
    "start, up and turned": Fed(mode=Mode.READY, shift=(0.0, 0.0, 0.02, 0.06, 0.0, -0.08)),
    "start, once it moves": Fed(shift=(0.03, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "workspace": Fed(up_m=ROOM_UP - 1e-4),
    "saturated": Fed(flags=Flag.SATURATED, ticks=50),
    "rate_limited": Fed(flags=Flag.RATE_LIMITED, ticks=50),
    "frozen, held by friction": Fed(feedback=usual().frozen_Nm[1] - JUST, ticks=60),
    "frozen, for a moment": Fed(feedback=5.0, ticks=9),
    "frozen, asked for little since": Fed(feedback=5.0, ticks=415, still_from=400, up_m_per_s=0.02),
    "frozen, while nothing is asked": Fed(feedback=5.0, ticks=60, mode=Mode.READY),
    "load": Fed(tau=0.44 * 4.1, ticks=12_000),
    "gravity, one window": Fed(mode=Mode.READY, measured=2.0, ticks=WINDOWS_TICKS - 1),
    "gravity, within tolerance": Fed(mode=Mode.READY, measured=0.3, ticks=2 * WINDOWS_TICKS),
    "gravity, on the way": Fed(mode=Mode.TRACK, measured=2.0, ticks=2 * WINDOWS_TICKS),
    "temperature": Fed(told=lambda tick: hot(tick, 77.9), ticks=200),
    "temperature, once": Fed(told=lambda tick: hot(tick, 78.0 if tick < 60 else 40.0), ticks=200),
    "voltage": Fed(told=lambda tick: low(tick, 9.7), ticks=200),
    "voltage, not known": Fed(told=lambda tick: low(tick, float("nan")), ticks=200),
    "servo load": Fed(told=lambda tick: loaded(tick, 0.44 * 2.3), ticks=12_000),
    "no servos": Fed(told=ServoHealth.none, ticks=200),
}


def test_a_turn_at_the_start_counts_as_a_displacement_does() -> None:
    said = Fed(mode=Mode.READY, shift=(0.0, 0.0, 0.0, 0.06, 1e-6, -0.081)).run(usual())
    assert said.startswith("monitor start: start of the object: found 0.0 mm and 101 mrad from where")


@pytest.mark.parametrize("case", WITHIN)
def test_what_is_within_its_bound_is_no_trip(case: str) -> None:
    assert WITHIN[case].run(usual()) == ""


def test_bounds_hold_in_both_directions() -> None:
    lowest = usual().position_rad[0][0] - float(at_rest()[0].q[0])
    for fed in (
        Fed(dq=SPEED + JUST), Fed(turn=0.9, tau=POWER / 0.9 + JUST), Fed(q=lowest - JUST), Fed(up_m=-0.11),
        Fed(mode=Mode.READY, measured=-2.0, ticks=WINDOWS_TICKS), Fed(told=lambda tick: low(tick, 15.9), ticks=100),
        Fed(feedback=-usual().frozen_Nm[1] - JUST, ticks=60),
    ):  # fmt: skip
        assert fed.run(usual())
    assert Fed(q=lowest).run(usual()) == ""


def test_a_servo_without_a_current_sensor_is_judged_by_its_load() -> None:
    said = Fed(told=lambda tick: loaded(tick, 0.1, 0.9), ticks=4_000).run(usual())
    assert "load of servo 8 (wrist_rotate)" in said


def test_load_is_that_of_half_a_minute() -> None:
    """A load of half of stall passes 45 % in the mean square after 30 s ln(0.25 / (0.25 − 0.2025))."""
    b = replace(usual(), watched=frozenset({Name.LOAD}))
    after_s = 30.0 * np.log(0.25 / (0.25 - 0.45**2))
    assert Fed(tau=2.05, ticks=round(200 * after_s * 0.97)).run(b) == ""
    assert Fed(tau=2.05, ticks=round(200 * after_s * 1.03)).run(b) != ""


def test_servo_load_is_that_of_half_a_minute_too() -> None:
    b = replace(usual(), watched=frozenset({Name.SERVO_LOAD}))
    after_s = 30.0 * np.log(0.25 / (0.25 - 0.45**2))
    for share, trips in ((0.97, False), (1.03, True)):
        fed = Fed(told=lambda tick: loaded(tick, 1.15), ticks=round(200 * after_s * share))
        assert bool(fed.run(b)) == trips


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("component", [0, 2, 4])
def test_weight_is_judged_by_each_component_in_both_directions(component: int, sign: float) -> None:
    state, outcome = at_rest()
    assert outcome.terms is not None
    joints = outcome.terms.joints.copy()
    internal = outcome.terms._replace(joints=joints)
    internal.tau_internal[:] = [3.0, -2.0, 1.0]
    wrench = np.zeros(6)
    wrench[component] = sign * usual().gravity[component]
    for share, trips in ((0.95, False), (1.05, True)):
        tau = state.tau + outcome.terms.kinematics.Jt @ (share * wrench) + internal.tau_internal
        watch = Watch(replace(usual(), watched=frozenset({Name.GRAVITY})))
        shown = replace(state, tau=tau), outcome._replace(terms=internal)
        said = [watch.after(*shown, Mode.READY, health) for _ in range(WINDOWS_TICKS)][-1]
        assert bool(said) == trips
        what = ("N along x", "", "N along z", "", "N·m about y")[component]
        assert not trips or what in said


def test_limited_ticks_that_are_long_past_count_no_more() -> None:
    watch, (state, outcome) = Watch(usual()), at_rest()
    for tick in range(1_000):
        flags = Flag.SATURATED if tick % 150 < 40 else Flag.NONE
        assert watch.after(state, outcome._replace(flags=flags), Mode.TRACK, health) == ""


def test_limited_ticks_are_those_of_the_last_hundred() -> None:
    watch, (state, outcome) = Watch(usual()), at_rest()
    for tick in range(400):
        flags = Flag.SATURATED if tick % 2 else Flag.NONE
        assert watch.after(state, outcome._replace(flags=flags), Mode.TRACK, health) == ""


def test_an_arm_that_moves_while_it_waits_is_not_judged_by_its_weight() -> None:
    watch, (state, outcome) = Watch(usual()), at_rest()
    for tick in range(3 * WINDOWS_TICKS):
        swung = replace(state, q=state.q + 1e-3 * tick / 3, tau=state.tau + 2.0)
        assert "gravity" not in watch.after(swung, outcome, Mode.READY, health)


def test_a_joint_that_senses_no_current_is_judged_by_its_command() -> None:
    state, outcome = at_rest()
    blind = replace(state, tau=np.full(SHAPE, np.nan))
    for wrong, held in ((0.0, False), (2.0, True)):
        shown = outcome._replace(tau=state.tau + np.array([wrong, 0.0, 0.0]))
        watch = Watch(usual())
        said = [watch.after(blind, shown, Mode.READY, health) for _ in range(WINDOWS_TICKS)]
        assert any("gravity" in s for s in said) == held


def test_a_window_begins_anew_when_the_wait_does() -> None:
    watch, (state, outcome) = Watch(usual()), at_rest()
    wrong = replace(state, tau=state.tau + 2.0)
    for _ in range(3):
        for _ in range(WINDOWS_TICKS - 1):
            assert watch.after(wrong, outcome, Mode.READY, health) == ""
        assert watch.after(wrong, outcome, Mode.TRACK, health) == ""


def test_in_a_hold_each_monitor_tells_once_and_asks_for_nothing() -> None:
    told: list[str] = []
    fed = Fed(mode=Mode.HOLD, dq=SPEED + JUST, q=HIGHEST + JUST, tau=0.0, ticks=300, told=hot)
    assert fed.run(usual(), told.append) == ""
    assert [text.split(":")[0] for text in told] == ["monitor speed", "monitor position", "monitor temperature"]


def test_of_two_findings_the_first_is_the_reason() -> None:
    assert Fed(dq=SPEED + JUST, up_m=1.0).run(usual()).startswith("monitor speed:")


def test_a_law_that_gave_nothing_is_watched_too() -> None:
    watch, (state, outcome) = Watch(usual()), at_rest()
    for _ in range(300):
        for mode in (Mode.READY, Mode.TRACK, Mode.HOLD):
            assert watch.after(state, outcome._replace(terms=None), mode, health) == ""


# --- of a session, and afloat -----------------------------------------------------------------------------------------

CARRIES, WAITS, BACK = (
    [Mode.APPROACH, Mode.GRASP, Mode.FLOAT],
    [Mode.REST, Mode.HALT, Mode.HOLD, Mode.STAND, Mode.SINK],
    [Mode.LOWER, Mode.RELEASE, Mode.PARK],
)
IN_EVERY_MODE = [Name.SPEED, Name.POWER, Name.POSITION, Name.SATURATED, Name.LOAD, Name.TEMPERATURE, Name.VOLTAGE]


def met(name: Name, mode: Mode) -> tuple[str, list[str]]:
    """What stops the arm, and what is told, of a fault that is beyond the bounds of every mode."""
    fed, _ = FAULTS[name]
    told: list[str] = []
    beyond = replace(fed, mode=mode, dq=10.0 * fed.dq, q=3.0 * fed.q)
    return beyond.run(usual(), told.append), told


@pytest.mark.parametrize("name", IN_EVERY_MODE)
@pytest.mark.parametrize("mode", [*CARRIES, *WAITS, *BACK])
def test_an_arm_of_a_session_or_afloat_is_watched_in_every_mode_and_brought_home_in_spite_of_heat(
    name: Name, mode: Mode
) -> None:
    said, told = met(name, mode)
    stops = mode in CARRIES or (mode in BACK and name in (Name.SPEED, Name.POWER))
    assert said.startswith(f"monitor {name}") == stops
    assert bool(told) != stops


@pytest.mark.parametrize("mode", [Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK, Mode.HALT])
def test_an_arm_that_holds_nothing_has_no_object_to_lose(mode: Mode) -> None:
    assert met(Name.WORKSPACE, mode) == ("", [])
    assert met(Name.GRAVITY, mode) == ("", [])


def test_an_arm_that_holds_nothing_may_go_as_fast_as_the_session_and_lie_as_near_to_its_stops_as_it_rests() -> None:
    own = load_cell(
        configs.CELLS_DIR / "two_wx200.toml", ["session.speed_max_rad_per_s=1.5", "session.off_max_rad=0.1"]
    )
    b, carried = bounds(own, own.arms[0]), usual()
    alone = b.speed_alone_rad_per_s[1]
    assert alone == pytest.approx(usual().speed_alone_rad_per_s[1] + 1.5 - 0.6)
    assert alone > b.speed_rad_per_s[1]
    b = replace(b, power_W=(9.0,) * 3)
    assert Fed(dq=alone, mode=Mode.APPROACH).run(b) == ""
    assert "speed of elbow" in Fed(dq=alone + JUST, mode=Mode.APPROACH).run(b)
    rest = own.arms[0].file.sleep_rad["shoulder"]
    (low, _), (low_carried, _) = b.position_alone_rad[0], b.position_rad[0]
    assert low == pytest.approx(min(low_carried, rest - 0.1))
    assert low < low_carried
    here = float(start_joints(cell())[0][0])
    assert Fed(q=low - here, mode=Mode.APPROACH).run(b) == ""
    assert "position of shoulder" in Fed(q=low - here - JUST, mode=Mode.APPROACH).run(b)
    assert "position of shoulder" in Fed(q=low - here, mode=Mode.TRACK).run(b)
    assert carried.position_alone_rad == carried.position_rad  # without a session there is no rest
