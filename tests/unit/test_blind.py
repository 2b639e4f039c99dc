"""Arms that nobody sees: the weight's torque, silence, the servos' watchdogs, and the way back; and a hold that shakes.

Rows P3, P12, B2, B3, B4, B11, S6, M5 and M6 of the fault matrix, with real drivers, loops and emulated servos that
carry one object, in virtual time and with the patience of real arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.monitors import FASTEST
from agent.control.joint_hold import weight
from agent.modes import Event, Mode, mode_of
from agent.process.build import build_agent
from agent.replay.chain import Chain
from agent.replay.tick import state_at
from agent.safety import Flag
from drivers.dynamixel.servo import table
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.servos.coupled_rig import CoupledRun, Truth
from tests.support.servos.dxl_rig import loses

FAULT_S = 0.1
READY_S = 0.1
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["duration_s=10.0", "safety.recover_s=0.1"])
PERIOD_S = CELL.period_ns * 1e-9
N = 3
LEFT = slice(0, N)
KINDS = {
    "all": Fault(kind=FaultKind.MUTE, arm="left", start_s=FAULT_S),
    "one": Fault(kind=FaultKind.MUTE, arm="left", servo=4, start_s=FAULT_S),
    "dropped": Fault(kind=FaultKind.DROP, arm="left", probability=0.9, start_s=FAULT_S),
}


def until(end_s: float, stop_s: float = 1e3) -> Callable[[str, float], Event]:
    """An operator who stops the arms at an instant, and at another says that the object is supported."""

    def words(_arm: str, now_s: float) -> Event:
        if now_s >= end_s:
            return Event.STOP | Event.RELEASED
        return Event.STOP if now_s >= stop_s else Event.NONE

    return words


def moved(truth: list[Truth]) -> float:
    """Largest way of any joint of any arm."""
    q = np.array([one.q for one in truth])
    return float(np.abs(q - q[0]).max())


def fastest(truth: list[Truth]) -> float:
    return float(max(np.abs(one.dq).max() for one in truth))


def assert_replays(rows: Any, arm: int = 0, cell: Cell = CELL) -> None:
    """Every row from the one before it, bit for bit; and from itself alone."""
    agent = build_agent(cell, cell.arms[arm])
    chain = Chain(agent)
    chain.start()
    for i, row in enumerate(rows):
        for again in (False, True):
            if again and i % 7 == 0:
                chain.restore(rows[i])
            elif again:
                continue
            mode = mode_of(int(row["mode"]))
            assert mode is not None
            memory, outcome = chain.pass_row(state_at(rows, i, N), float(row["t"]), mode, int(row["flags"]))
            assert np.array(memory.flatten()).tobytes() == row["memory"].tobytes(), i
            assert outcome.tau.tobytes() == row["tau_limited"][:N].tobytes(), i
            assert int(outcome.flags) == row["flags"], i


def flagged(rows: Any, flag: Flag) -> Any:
    return np.flatnonzero(rows["flags"] & np.uint32(flag.value))


# --- silence ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "mode"),
    [
        ("all", Mode.TRACK), ("dropped", Mode.HOLD),
        *(
            pytest.param(*pair, marks=pytest.mark.long)
            for pair in (
                ("all", Mode.READY), ("all", Mode.HOLD), ("one", Mode.READY), ("one", Mode.TRACK), ("one", Mode.HOLD),
                ("dropped", Mode.READY), ("dropped", Mode.TRACK),
            )
        ),
    ],
)  # fmt: skip
@pytest.mark.fault("B2", "B3", "B11")
def test_a_silent_bus_gives_the_weights_torque_then_silence_then_the_watchdogs(kind: str, mode: Mode) -> None:
    stop_s, starts = 0.03 if mode is Mode.HOLD else 1e3, mode is not Mode.READY
    words = until(FAULT_S + 0.55, stop_s)
    run = CoupledRun(CELL, [KINDS[kind]], real=True, starts=starts, operator=words, ready_s=READY_S)
    left, right = run.arms["left"], run.arms["right"]
    rows = left.rows
    first = flagged(rows, Flag.STALE)[0]
    assert rows["mode"][first] == mode
    stale = rows[first:]
    assert (stale["flags"] & Flag.STALE.value).all()

    law = rows["tau_limited"][first - 1][:N]
    np.testing.assert_array_equal(
        stale["tau_limited"][:3, :N], np.tile(law, (3, 1)), "three cycles of the law's torque"
    )
    agent = build_agent(CELL, CELL.arms[0])
    wanted = weight(agent.model, agent.offline, rows["q"][first - 1][:N], carries=True)
    np.testing.assert_allclose(stale["tau_limited"][4:, :N], np.tile(wanted, (len(stale) - 4, 1)), rtol=0, atol=1e-12)
    assert (np.abs(stale["tau_limited"][3, :N] - law) <= np.array(agent.limits.tau_step_max_Nm) + 1e-12).all()
    assert flagged(stale, Flag.BLIND).tolist() == list(range(3, len(stale)))
    assert (stale["mode"][4:] == Mode.HOLD).all()

    sent = np.isfinite(stale["tau_sent"][:, :N]).all(axis=1)
    assert np.flatnonzero(sent).tolist() == list(range(40)), "then nothing is said for the blind time is over"
    assert left.tripped_ns is not None
    tripped_s = run.since_s(left.tripped_ns)
    assert tripped_s <= FAULT_S + 0.2 + 0.2 + 0.01
    assert moved(run.between(FAULT_S, tripped_s)) <= 0.1
    assert fastest(run.between(FAULT_S, tripped_s)) <= 0.5

    assert left.summary is not None
    assert left.summary.mode is Mode.FAULT
    assert "no reply" in left.summary.reason
    assert right.summary is not None
    assert right.summary.mode is Mode.OFF, "held until it was released"
    assert ("UNEXPECTED" in right.summary.reason) is (mode is Mode.TRACK), "by itself, once the other arm is limp"
    assert right.tripped_ns is None
    assert_replays(rows)


# --- coming back -----------------------------------------------------------------------------------------------------


BACK = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["duration_s=10.0", "safety.recover_s=1.0"])


def port_away(gone: bool) -> Callable[[CoupledRun], None]:
    def act(run: CoupledRun) -> None:
        port = run.arms["left"].port
        assert port is not None
        port.gone = gone
        port.is_open = port.is_open and not gone

    return act


@pytest.mark.fault("B4")
@pytest.mark.parametrize("away_s", [0.002, pytest.param(0.08, marks=pytest.mark.long)])
def test_a_port_that_comes_back_before_the_watchdogs_fire_leaves_the_arm_in_hold_without_a_jump(away_s: float) -> None:
    """However soon: nothing is opened again before the arm holds."""
    actions = [(FAULT_S, port_away(True)), (FAULT_S + away_s, port_away(False))]
    run = CoupledRun(BACK, real=True, operator=until(FAULT_S + 0.5), actions=actions, ready_s=READY_S)
    left = run.arms["left"]
    rows = left.rows
    assert left.tripped_ns is None
    assert [e.kind.name for e in left.events][-1:] == ["PORT_REOPENED"]
    assert not len(flagged(rows, Flag.RESUMED))
    seen = rows["t"][(rows["flags"] & Flag.STALE.value) == 0]
    assert FAULT_S + away_s < seen[seen > FAULT_S + 0.01][0] < FAULT_S + away_s + 0.1 + 0.06, "tried ten times a second"
    assert (rows["mode"][rows["t"] > FAULT_S + 0.05] == Mode.HOLD).all()
    assert left.summary is not None
    assert left.summary.mode is Mode.OFF
    assert moved(run.between(FAULT_S, FAULT_S + 0.5)) <= 0.02
    assert_replays(rows)


@pytest.mark.fault("S6")
def test_an_arm_whose_watchdogs_fired_is_armed_again_and_holds_where_it_is() -> None:
    fault = Fault(kind=FaultKind.MUTE, arm="left", start_s=FAULT_S, duration_s=0.35)
    run = CoupledRun(BACK, [fault], real=True, operator=until(FAULT_S + 0.9), ready_s=READY_S)
    left = run.arms["left"]
    rows = left.rows
    assert left.tripped_ns is not None
    assert [e.kind.name for e in left.events][-1:] == ["REARMED"]
    (resumed,) = flagged(rows, Flag.RESUMED)
    assert rows["t"][resumed] < FAULT_S + 0.2 + 0.25 + 0.1 + 0.06
    np.testing.assert_array_equal(rows["memory"][resumed][28 : 28 + N], 0.0, "torque begins at zero")
    assert np.abs(rows["e_p"][resumed]).max() < 1e-9, "held is where it is"
    assert (rows["mode"][resumed:] == Mode.HOLD).all()
    assert (rows["flags"][resumed : resumed + 90] & Flag.GENTLE.value).all()
    step = np.array(build_agent(BACK, BACK.arms[0]).limits.tau_step_max_Nm)
    assert (np.abs(np.diff(rows["tau_limited"][resumed - 1 :, :N], axis=0))[1:] <= step + 1e-12).all()
    assert left.summary is not None
    assert left.summary.mode is Mode.OFF
    assert_replays(rows)


@pytest.mark.fault("S6")
def test_an_arm_of_which_one_servo_missed_its_zero_begins_at_zero_with_the_next_attempt() -> None:
    """All watchdogs are armed by then: with old goals it would go back, stiff, to the pose that it has sunk from."""

    def loses_a_zero(run: CoupledRun) -> None:
        loses(run.arms["left"], table.GOAL_CURRENT, 1, 2, 5)

    silent_s, back_s = 1.2, FAULT_S + 1.2
    actions = [(0.05, loses_a_zero)]
    fault = Fault(kind=FaultKind.MUTE, arm="left", start_s=FAULT_S, duration_s=silent_s)
    run = CoupledRun(BACK, [fault], real=True, operator=until(back_s + 0.7), actions=actions, ready_s=READY_S)
    left = run.arms["left"]
    rows = left.rows
    assert [e.kind.name for e in left.events][-1:] == ["REARMED"]
    (resumed,) = flagged(rows, Flag.RESUMED)
    assert rows["t"][resumed] > back_s + 0.05, "by the second attempt"
    assert left.busy_s[-1] - left.busy_s[0] > 0.5, "before each of which whoever watches the loop is told"
    np.testing.assert_array_equal(rows["memory"][resumed][28 : 28 + N], 0.0, "torque begins at zero")
    assert np.abs(rows["e_p"][resumed]).max() < 1e-9, "held is where it is"
    assert (rows["flags"][resumed : resumed + 90] & Flag.GENTLE.value).all()
    after = run.between(float(rows["t"][resumed]), back_s + 0.7)
    assert fastest(after) <= 0.4, "rad/s; 0.8 with the goals of before"


@pytest.mark.fault("B4")
def test_nothing_is_written_to_an_arm_that_is_another_one() -> None:
    """A servo of another model answers from the same port: the arm is not commanded any more."""

    def swap(run: CoupledRun) -> None:
        port_away(False)(run)
        port = run.arms["left"].port
        assert port is not None
        for servo in run.emulated("left").bus.servos:
            servo.firmware.memory.put(table.MODEL_NUMBER, 1060)
        port.writes.clear()

    actions = [(FAULT_S, port_away(True)), (FAULT_S + 0.08, swap)]
    run = CoupledRun(CELL, real=True, operator=until(FAULT_S + 0.7), actions=actions, ready_s=READY_S)
    left = run.arms["left"]
    assert left.summary is not None
    assert left.summary.mode is Mode.FAULT
    assert left.port is not None
    instructions = {packet[7] for packet in left.port.writes}
    assert instructions == {0x01}, "pings, and no other instruction"


# --- lost time -------------------------------------------------------------------------------------------------------


def stall(seconds: float) -> Callable[[CoupledRun], None]:
    def act(run: CoupledRun) -> None:
        run.stall("left", seconds)

    return act


@pytest.mark.parametrize(
    ("seconds", "held"),
    [
        # nine missed cycles go on in test_bench.py, too
        pytest.param(0.045, False, marks=pytest.mark.long),
        (0.08, True),
    ],
)
@pytest.mark.fault("P12")
def test_a_process_that_was_stopped_for_more_than_ten_cycles_holds(seconds: float, held: bool) -> None:
    run = CoupledRun(
        CELL, real=True, operator=until(FAULT_S + 0.3), actions=[(FAULT_S, stall(seconds))], ready_s=READY_S
    )
    left = run.arms["left"]
    rows = left.rows
    gaps = flagged(rows, Flag.GAP)
    assert len(gaps) == held
    assert left.summary is not None
    if held:
        (gap,) = gaps
        assert "no cycle for 0.08" in left.summary.reason
        assert rows["mode"][gap] == Mode.HOLD
        assert rows["mode"][gap - 1] == Mode.TRACK
        assert np.abs(rows["e_p"][gap]).max() < 1e-9, "held is where it is"
        assert np.abs(np.diff(rows["tau_limited"][gap - 1 : gap + 1, :N], axis=0)).max() < 0.5
    else:
        assert left.summary.reason == ""
    assert left.tripped_ns is None
    assert_replays(rows)


# --- a hold that shakes ----------------------------------------------------------------------------------------------


PAPER = load_cell(configs.CELLS_DIR / "paper.toml", ["duration_s=10.0"])
HOLD_S, BEGIN_S, END_S = 0.05, 0.2, 0.8


def held(cell: Cell = PAPER, *actions: tuple[float, Callable[[CoupledRun], None]], end_s: float = END_S) -> CoupledRun:
    """Arms that hold from HOLD_S to end_s while something is done to them."""
    run = CoupledRun(cell, real=True, operator=until(end_s, HOLD_S), actions=actions, ready_s=READY_S)
    for arm in run.arms.values():
        assert arm.summary is not None
        assert arm.summary.mode is Mode.OFF
        assert (arm.rows["mode"][arm.rows["t"] > HOLD_S + 0.02] == Mode.HOLD).all()
    return run


def assert_bounded(run: CoupledRun, cell: Cell, over_s: float, *, end_s: float = END_S) -> None:
    """What a hold must keep: at most 0.5 rad/s 100 ms after `over_s`, never a joint above its speed limit, nor a torque
    above its bound; and an arm that is faster than the cell allows a hold brakes, a period later at most."""
    assert fastest(run.between(over_s + 0.1, end_s)) <= 0.5
    limit = FASTEST * min(m.no_load_rad_per_s for arm in cell.arms for m in arm.servo_models)
    assert fastest(run.between(HOLD_S, end_s)) <= limit
    above = cell.file.safety.hold_speed_max_rad_per_s
    assert above is not None
    for arm in cell.arms:
        rows = run.arms[arm.name].rows
        caps = np.array(build_agent(cell, arm).limits.tau_max_Nm)
        assert (np.abs(rows["tau_limited"][:, :N]) <= caps + 1e-12).all()
        fast = np.abs(rows["dq"][:, :N]).max(axis=1) > above
        braked = rows["flags"] & (Flag.DAMPED | Flag.GENTLE).value != 0
        assert (braked | ~fast)[rows["t"] > HOLD_S + 0.02].all()


def starving(every: int) -> Callable[[CoupledRun], None]:
    """From now on only one cycle of so many brings a state, in both arms."""

    def act(run: CoupledRun) -> None:
        for arm in run.arms.values():
            assert arm.driver is not None
            arm.driver.every = every

    return act


@pytest.mark.parametrize("every", [10, *(pytest.param(every, marks=pytest.mark.long) for every in (4, 6))])
@pytest.mark.fault("M6")
def test_a_hold_that_is_seen_only_now_and_then_moves_hardly(every: int) -> None:
    """20, 30 and 50 ms from one state to the next; the law alone makes 13 rad/s of 30 ms."""
    run = held(PAPER, (BEGIN_S, starving(every)))
    after = run.between(BEGIN_S, END_S)
    assert moved(after) < 0.01
    assert fastest(after) < 0.1
    assert_bounded(run, PAPER, BEGIN_S)
    for arm in run.arms.values():
        stale = arm.rows["flags"][arm.rows["t"] > BEGIN_S + 0.05] & Flag.STALE.value
        assert np.mean(stale > 0) == pytest.approx(1.0 - 1.0 / every, abs=0.05)
        assert len(flagged(arm.rows, Flag.GENTLE)) > 5


def louder(run: CoupledRun) -> None:
    """All gains of both arms times ten."""
    for arm in run.arms.values():
        assert arm.runner is not None
        agent = arm.runner._agent
        gains = agent.offline.gains
        ten = {f.name: tuple(10.0 * x for x in getattr(gains, f.name)) for f in fields(gains)}
        arm.runner._agent = replace(agent, offline=replace(agent.offline, gains=replace(gains, **ten)))


@pytest.mark.parametrize("name", ["two_wx200", pytest.param("paper_real", marks=pytest.mark.long)])
@pytest.mark.fault("M5")
def test_a_hold_of_ten_times_the_gain_brakes_and_goes_on_by_its_joints(name: str) -> None:
    """Without the sign of the torque's steps `two_wx200`, which begins to swing after 0.12 s, makes 0.5 rad/s.

    `paper_real` begins after 0.15 s; by the phase of its cycles one to four of them brake, at 0.27 to 0.54 rad/s.
    """
    swings_s = BEGIN_S + {"two_wx200": 0.0, "paper_real": 0.1}[name]
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml", ["duration_s=10.0"])
    run = held(cell, (BEGIN_S, louder))
    assert_bounded(run, cell, swings_s)
    assert fastest(run.between(BEGIN_S, END_S)) < 1.0
    assert fastest(run.between(swings_s + 0.1, END_S)) <= 0.3
    assert moved(run.between(BEGIN_S, END_S)) < 0.05
    for arm in run.arms.values():
        damped, gentle = flagged(arm.rows, Flag.DAMPED), flagged(arm.rows, Flag.GENTLE)
        assert 0 < len(damped) < 20
        assert gentle[-1] == len(arm.rows) - 1


@pytest.mark.parametrize(
    ("name", "force_N", "swing_s", "most_rad_per_s"),
    [("paper_real", 30.0, 0.125, 2.8), pytest.param("paper", 15.0, 0.08, 1.3, marks=pytest.mark.long)],
)
@pytest.mark.fault("M6")
def test_a_hold_that_is_shaken_stays_below_the_speed_limit_and_the_torque_caps(
    name: str, force_N: float, swing_s: float, most_rad_per_s: float
) -> None:
    """Pushed by more than it can resist it is braked, by the speed that the servos see: by the observer's it is 3.7."""

    def push(size: float) -> Callable[[CoupledRun], None]:
        return lambda run: run.world.plant.push(np.array([size, 0.5 * size, 0.0, 0.0, 0.0, 0.0]))

    cell = load_cell(configs.CELLS_DIR / f"{name}.toml", ["duration_s=10.0"])
    swings = [(BEGIN_S + swing_s * k, push(force_N * (-1.0) ** k)) for k in range(4)]
    over_s, end_s = 0.7, 0.9
    run = held(cell, *swings, (over_s, push(0.0)), end_s=end_s)
    assert_bounded(run, cell, over_s, end_s=end_s)
    assert fastest(run.between(BEGIN_S, END_S)) < most_rad_per_s
    assert moved(run.between(BEGIN_S, END_S)) < 0.4
    for i, arm in enumerate(cell.arms):
        rows = run.arms[arm.name].rows
        assert bool(len(flagged(rows, Flag.DAMPED))) == (force_N > 20.0), "where the law suffices it is not braked"
        assert_replays(rows, i, cell)
