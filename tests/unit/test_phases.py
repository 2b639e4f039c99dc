"""What becomes of a session that is stopped, loses power or loses an agent in each of its phases, and the way back.

Real drivers, loops, operators and guards' own steps on emulated servos with a table, grippers and an object, in virtual
time; `python -m tests.campaign.phases` goes through every phase.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import load_cell
from agent.modes import Mode
from agent.operator.table import Verb
from agent.process.session import LEADS_BACK
from agent.replay.chain import Chain
from agent.safety import Flag
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import JointState
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.servos.phase_rig import At, PhaseArm, PhaseRun, Step

QUICK = [
    "session.speed_max_rad_per_s=2.0", "session.back_off_m=0.04", "session.lift_m=0.015", "session.lift_s=0.8",
    "session.lower_s=0.5", "session.take_up_s=0.3", "session.ease_s=0.3", "duration_s=2.0",
]  # fmt: skip
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", QUICK)
REST, APPROACH, GRASP, READY, TRACK = Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.TRACK
HOLD, LOWER, RELEASE, PARK, HALT = Mode.HOLD, Mode.LOWER, Mode.RELEASE, Mode.PARK, Mode.HALT
SAGS_M = 4e-3  # at the most, within the time that a person needs to look


def nothing(_: PhaseRun) -> None:
    """See how it is."""


def deltas(rig: PhaseRun, ns: int, seconds: float) -> tuple[float, float]:
    """How far the object went down and up from then on, m."""
    before = rig.height(ns)
    after = [z for at, z in rig.heights if ns <= at < ns + seconds * 1e9]
    return before - min(after), max(after) - before


def steps_are_bounded(rig: PhaseRun) -> None:
    for arm in rig.arms.values():
        n = arm.agent.model.n
        steps = np.abs(np.diff(arm.rows["tau_limited"][:, :n], axis=0))
        assert (steps <= np.array(arm.agent.limits.tau_step_max_Nm) + 1e-12).all()


def pressing_N(rig: PhaseRun) -> float:
    """With how much the two arms press against each other through the object now."""
    left, right = rig.world.plant.observe(rig.world.tau_Nm).grasp_wrench[:, :3]
    return float(np.linalg.norm(left - right)) / 2.0


def replays(arm: PhaseArm) -> None:
    """Every row of the agent follows from the one before it, bit for bit."""
    chain, n = Chain(arm.agent), arm.agent.model.n
    chain.restore(arm.rows[0])
    for row in arm.rows:
        state = JointState(int(row["stamp_ns"]), *(row[f][:n] for f in ("q_measured", "dq_measured", "tau_measured")))
        memory, outcome = chain.pass_row(state, float(row["t"]), Mode(int(row["mode"])), int(row["flags"]))
        assert np.array_equal(outcome.tau, row["tau_limited"][:n])
        assert np.array_equal(memory.flatten(), row["memory"])


def test_an_arm_that_misses_one_state_in_eight_goes_its_way_at_the_pace_of_the_clock() -> None:
    def lossy(rig: PhaseRun) -> None:
        rig.injectors["left"].add([Fault(kind=FaultKind.DROP, arm="left", probability=0.05)], rig.now_ns)

    steps = [Step(REST, lossy), Step(REST, Verb.APPROACH, APPROACH), Step(APPROACH, nothing, None, 1.5)]
    rig = PhaseRun(CELL, At.REST, steps, limit_s=3.0)
    for name, misses in (("left", True), ("right", False)):
        arm, session = rig.arms[name], rig.lives[name]
        assert session is not None
        rows, n = arm.rows[arm.rows["mode"] == APPROACH], arm.agent.model.n
        stale = rows["flags"] & Flag.STALE != 0
        assert bool(0.08 < stale.mean() < 0.2) is misses
        fresh = rows[~stale]
        way = session.life.journey(fresh["q_measured"][0, :n], forward=True)
        passed_s = (fresh["stamp_ns"] - rows["stamp_ns"][0]) * 1e-9
        off = [abs(q - way.at(s).q).max() for q, s in zip(fresh["q_measured"][:, :n], passed_s, strict=True)]
        assert max(off) < 0.015  # a way by the ticks that had a state would end 0.2 rad behind
        assert arm.reasons == []
        replays(arm)


@pytest.mark.long  # the same is stopped at the object below; `make phases` goes through every phase
def test_a_person_stops_before_the_grasp_and_on_the_way_home_and_goes_on_or_back() -> None:
    rig = PhaseRun(
        CELL,
        At.REST,
        [
            Step(REST, Verb.STOP, REST),
            Step(REST, Verb.APPROACH, APPROACH),
            Step(APPROACH, PhaseRun.interrupt, HALT, 0.5),
            Step(HALT, Verb.APPROACH, APPROACH),
            Step(APPROACH, Verb.PARK, PARK, 0.3),
            Step(PARK, PhaseRun.interrupt, HALT, 0.3),
            Step(HALT, Verb.PARK, PARK, 0.2),
        ],
        limit_s=4.0,
    )
    assert rig.finished
    for name, arm in rig.arms.items():
        assert rig.way(name)[:-1] == [REST, APPROACH, HALT, APPROACH, PARK, HALT, PARK]
        halted = arm.rows[arm.rows["mode"] == HALT]
        assert np.ptp(halted["q_measured"][-20:, :3], axis=0).max() < 0.01  # it stands within a tenth of a second
    assert deltas(rig, rig.step_ns[0], 10.0) == (0.0, 0.0)
    steps_are_bounded(rig)


def test_a_person_stops_at_the_object_and_nothing_is_dropped_and_a_start_of_before_counts_no_more() -> None:
    opened: list[float] = []

    def look(rig: PhaseRun) -> None:
        opened.append(rig.world.fingers[0].width_m())
        rig.start_in(1.75)  # comes true when the load has just been taken up: nobody has asked these arms, READY now

    rig = PhaseRun(
        CELL,
        At.GRASP,
        [
            Step(APPROACH, Verb.GRASP, GRASP),
            Step(GRASP, Verb.STOP, HALT, 0.3),
            Step(HALT, look, None, 0.4),
            Step(HALT, Verb.APPROACH, APPROACH),
            Step(APPROACH, Verb.GRASP, GRASP),
            Step(GRASP, nothing, READY),
            Step(READY, Verb.STOP, HOLD, 0.3),
            Step(HOLD, Verb.LOWER, LOWER),
            Step(LOWER, PhaseRun.interrupt, HOLD, 0.2),
            Step(HOLD, Verb.RELEASE, RELEASE),
            Step(RELEASE, Verb.STOP, HOLD, 0.1),
            Step(HOLD, Verb.RELEASE, RELEASE),
            Step(RELEASE, Verb.STOP, HALT, 0.5),
            Step(HALT, Verb.PARK, PARK),
        ],
        limit_s=6.0,
    )
    assert rig.finished
    width = rig.world.whole.hands[0].width_m
    assert opened[0] > width + 0.02  # who stopped it may have had a finger in it
    for name in rig.arms:
        way = [APPROACH, GRASP, HALT, APPROACH, GRASP, READY, HOLD, LOWER, HOLD, RELEASE, HOLD, RELEASE, HALT, PARK]
        assert rig.way(name)[:-1] == way
    down, up = deltas(rig, rig.step_ns[0], 10.0)
    assert max(down, up) < 1e-3  # it stood on the table all the time
    replays(rig.arms["right"])
    assert rig.world.holding == [False, False]
    steps_are_bounded(rig)


def test_a_guard_goes_on_with_the_grip_and_leads_back_by_the_same_words() -> None:
    held: list[list[bool]] = []
    rig = PhaseRun(
        CELL,
        At.GRIPPED,
        [
            Step(READY, Verb.START, TRACK, 0.35),
            Step(TRACK, lambda rig: rig.kill("left"), None, 0.2),
            Step(TRACK, lambda rig: rig.interrupt("right"), HOLD, 0.05, ("right",)),
            Step(HOLD, lambda rig: held.append(list(rig.world.holding)), None, 0.3),
            Step(HOLD, Verb.LOWER, LOWER),
            Step(LOWER, Verb.RELEASE, RELEASE),
        ],
        limit_s=6.0,
    )
    assert rig.finished
    assert rig.arms["left"].guarded
    assert held == [[True, True]]
    assert rig.arms["left"].reasons == ["the agent has died; way back: `coop lower`, `coop release`, `coop park`"]
    assert rig.way("left")[:-1] == [READY, TRACK, HOLD, LOWER, RELEASE]
    down, _ = deltas(rig, rig.step_ns[1], 0.3)
    assert down < SAGS_M
    assert rig.world.set_down_error()[0] < 3e-3
    steps_are_bounded(rig)


def test_a_guard_of_an_arm_that_holds_nothing_stands_without_the_object_s_weight() -> None:
    rig = PhaseRun(
        CELL,
        At.REST,
        [
            Step(REST, Verb.APPROACH, APPROACH),
            Step(APPROACH, lambda rig: rig.kill("left"), None, 0.5),
            Step(HALT, Verb.APPROACH, None, 0.3, ("left",)),
            Step(HALT, Verb.PARK, PARK, 0.1, ("left",)),
        ],
        limit_s=4.0,
    )
    assert rig.finished
    left, n = rig.arms["left"], 3
    halted = left.rows[left.rows["mode"] == HALT]
    assert np.abs(halted["tau_object"][:, :n]).max() == 0.0
    assert np.ptp(halted["q_measured"][5:, :n], axis=0).max() < 0.06
    assert left.refused == ["approach: the guard holds the arm in its agent's place and leads it back alone"]
    assert left.standing.no_start == LEADS_BACK, "for the operator, who is told what works in its place"


@pytest.mark.long  # `make phases` does it in every phase; that the other holds: tests/unit/faults/test_bench.py
def test_power_lost_by_one_arm_leaves_the_other_holding_and_all_come_back_with_it() -> None:
    rig = PhaseRun(
        CELL,
        At.GRIPPED,
        [
            Step(READY, Verb.START, TRACK, 0.35),
            Step(TRACK, lambda rig: rig.power("left", on=False), None, 0.5),
            Step(TRACK, Verb.STOP, HOLD, 0.1, ("right",)),
            Step(HOLD, nothing, None, 0.3, ("right",)),
            Step(HOLD, Verb.LOWER, LOWER, 0.0, ("right",)),
            Step(LOWER, Verb.RELEASE, RELEASE, 0.0, ("right",)),
            Step(RELEASE, Verb.PARK, PARK, 0.0, ("right",)),
            Step(Mode.FAULT, nothing, None, 0.0, ("left",)),
        ],
        limit_s=8.0,
    )
    assert rig.finished
    left, right = rig.arms["left"], rig.arms["right"]
    (said,) = left.reasons
    assert "does not answer" in said
    assert "12 V supply; way back once it answers again: `coop lower`" in said
    assert left.summary is not None
    assert left.summary.mode is Mode.FAULT
    assert right.reasons == []
    down, _ = deltas(rig, rig.step_ns[1], 0.4)
    assert down < SAGS_M  # the other carries all of it
    replays(left)
    rig.again([Step(REST, Verb.APPROACH, APPROACH), Step(APPROACH, nothing, None, 0.2)])
    assert rig.finished
    assert {name: rig.way(name)[:2] for name in rig.arms} == {name: [REST, APPROACH] for name in rig.arms}


@pytest.mark.fault("B4")
@pytest.mark.parametrize(("begins", "word", "mode"), [(At.REST, Verb.APPROACH, APPROACH), (At.GRASP, Verb.PARK, PARK)])
def test_an_arm_on_its_way_whose_port_is_away_for_a_moment_stands_and_goes_on(
    begins: At, word: Verb, mode: Mode
) -> None:
    before = REST if begins is At.REST else APPROACH
    steps = [Step(before, word, mode), Step(mode, lambda rig: rig.unplug("left", 0.1), None, 0.6)]
    rig = PhaseRun(CELL, begins, steps, back=True, real=True, limit_s=5.0)
    left = rig.arms["left"]
    assert rig.way("left")[-4:-1] == [HALT, PARK, REST]
    assert rig.way("right")[-2] is REST
    rows = left.rows[left.rows["stamp_ns"] >= rig.step_ns[-1]]
    blind = rows[rows["flags"] & Flag.STALE != 0]
    assert blind["stamp_ns"][-1] - rig.step_ns[-1] < 1e9 * WATCHDOG_S, "its servos have not let go"
    assert np.nanmax(np.abs(rows["dq_measured"][:, :3])) < 2.2, "of 2 rad/s on its way"
    steps_are_bounded(rig)


@pytest.mark.long  # closed on nothing: tests/unit/test_session.py; refused, it opens again: test_session_modes.py
@pytest.mark.fault("F9")
def test_an_object_ten_millimetres_off_is_refused_and_the_gripper_opens_again() -> None:
    rig = PhaseRun(
        CELL,
        At.GRASP,
        [Step(APPROACH, Verb.GRASP, GRASP), Step(GRASP, nothing, APPROACH), Step(APPROACH, Verb.PARK, PARK)],
        object_off=pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.0])),
        limit_s=4.0,
    )
    assert rig.finished
    for arm in rig.arms.values():
        assert any("closed on nothing: found 30.1 mm, expected 44.0 mm" in text for text in arm.refused)
    assert rig.world.holding == [False, False]


@pytest.mark.fault("F9")
def test_a_gripper_that_loses_the_object_is_noticed_and_both_arms_hold() -> None:
    rig = PhaseRun(
        CELL,
        At.GRIPPED,
        [
            Step(READY, Verb.START, TRACK, 0.35),
            Step(TRACK, lambda rig: rig.world.lose(0), None, 0.6),
            Step(HOLD, nothing, None, 0.0, ("left",)),
        ],
        limit_s=4.0,
    )
    assert rig.finished
    assert rig.done_ns is not None
    assert (rig.done_ns - rig.step_ns[1]) * 1e-9 < 0.4
    (said,) = rig.arms["left"].reasons
    assert said.startswith("the gripper lost the object")
    assert rig.world.holding == [False, True]  # who still has it keeps it


def test_a_fault_that_lasts_holds_once_and_does_not_stop_the_way_back() -> None:
    overload = Fault(kind=FaultKind.OVERLOAD, arm="left", servo=1)  # of the waist, which nobody moves in this cell
    rig = PhaseRun(
        CELL,
        At.GRIPPED,
        [
            Step(READY, lambda rig: rig.injectors["left"].add([overload], rig.now_ns), None, 0.35),
            Step(HOLD, nothing, None, 0.1, ("left",)),
            Step(READY, Verb.STOP, HOLD, 0.0, ("right",)),
            Step(HOLD, Verb.LOWER, LOWER),
            Step(LOWER, Verb.RELEASE, RELEASE),
            Step(RELEASE, nothing, None, 0.15),
        ],
        limit_s=4.0,
    )
    assert rig.finished
    assert rig.way("left")[:-1] == [READY, HOLD, LOWER, RELEASE]
    (said,) = rig.arms["left"].reasons
    assert "servo 1 (waist)" in said
    assert said.endswith("; way back: `coop lower`, `coop release`, `coop park`")


@pytest.mark.long  # how both lower is in tests/unit/test_whole.py
def test_an_arm_that_lowers_while_the_other_was_stopped_presses_a_little_until_both_are_told_the_same() -> None:
    """No arm is told what another was: docs/session.md has the figures."""
    pressed: list[float] = []

    def press(rig: PhaseRun) -> None:
        pressed.append(pressing_N(rig))

    rig = PhaseRun(
        CELL,
        At.GRIPPED,
        [
            Step(READY, Verb.START, TRACK, 0.35),
            Step(TRACK, Verb.STOP, HOLD, 1.0),
            Step(HOLD, Verb.LOWER, LOWER, 0.2),
            Step(LOWER, lambda rig: rig.interrupt("left"), HOLD, 0.05, ("left",)),
            Step(HOLD, press, None, 1.5, ("left",)),
            Step(LOWER, Verb.STOP, HOLD, 0.0, ("right",)),
            Step(HOLD, Verb.LOWER, LOWER),
            Step(LOWER, press, None, 1.5),
            Step(LOWER, Verb.RELEASE, RELEASE),
        ],
        limit_s=8.0,
    )
    assert rig.finished
    assert rig.way("left")[:-1] == rig.way("right")[:-1] == [READY, TRACK, HOLD, LOWER, HOLD, LOWER, RELEASE]
    assert 2.0 < pressed[0] < 6.0
    assert pressed[1] < 1.0
    assert rig.world.set_down_error()[0] < 3e-3
    steps_are_bounded(rig)
