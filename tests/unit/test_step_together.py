"""What one tick does with what it senses of the others: braking a hold, noticing, aligning, and the pose it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from agent import standing
from agent.calm import BRAKE, JOINTS, LAW
from agent.control.alignment import Alignment, between
from agent.control.memory import Memory
from agent.control.residual import Channels, nothing_sensed
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.safety import Flag
from agent.standing import hold_after, hold_here, wait_here
from drivers.interface import JointState, Vector
from tests.unit.test_step_rules import arm, start

BOUND = 0.5
T = 0.7
SHIFT = (0.001, -0.002, 0.003, 0.01, -0.02, 0.03)
FOUND = (0.0, 0.0, 0.007, 0.0, 0.0, 0.0)
SETTLED = (0.004, 0.0, 0.0, 0.0, 0.05, 0.0)
TURNED = (math.cos(0.1), math.sin(0.1), 0.0, 0.0)
START = (0.3, 0.1, 0.2), TURNED


def at(
    agent: Agent, dq: tuple[float, ...], mode: Mode, memory: Memory | None = None, q: Vector | None = None
) -> Outcome:
    state = JointState(0, start() if q is None else q, np.array(dq), np.zeros(3))
    return step(agent, state, T, mode, memory or initial_memory(agent))


def holding(agent: Agent, **more: Any) -> Memory:
    return hold_here(agent, start(), initial_memory(agent))._replace(**more)


# --- a hold that is too fast -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dq", "before", "calm"),
    [
        ((BOUND, 0.0, 0.0), LAW, LAW), ((BOUND + 1e-9, 0.0, 0.0), LAW, BRAKE), ((0.0, 0.0, -0.6), LAW, BRAKE),
        ((0.0, -0.6, 0.3), LAW, BRAKE), ((0.1, -0.1, 0.1), BRAKE, JOINTS), ((0.0, -0.1001, 0.0), BRAKE, BRAKE),
        ((0.0, 0.4, 0.0), LAW, LAW), ((0.0, 0.4, 0.0), JOINTS, JOINTS), ((0.0, 0.6, 0.0), JOINTS, BRAKE),
    ],
)  # fmt: skip
def test_a_hold_brakes_above_a_speed_and_until_it_is_nearly_at_rest(
    dq: tuple[float, ...], before: int, calm: int
) -> None:
    agent = arm(damp_above_rad_per_s=BOUND)
    outcome = at(agent, dq, Mode.HOLD, holding(agent, calm=before))
    assert (Flag.DAMPED in outcome.flags) is (calm == BRAKE)
    assert (Flag.GENTLE in outcome.flags) is (calm == JOINTS)
    assert outcome.memory.calm == calm
    terms = outcome.terms
    assert terms is not None
    braking = terms.tau_object - 30.0 * terms.kinematics.B @ np.array(dq) + terms.kinematics.g
    np.testing.assert_allclose(outcome.tau, braking if calm == BRAKE else terms.tau_cmd, rtol=1e-12)
    assert not np.allclose(braking, terms.tau_cmd)


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode is not Mode.HOLD])
def test_only_a_hold_brakes(mode: Mode) -> None:
    agent = arm(damp_above_rad_per_s=BOUND)
    outcome = at(agent, (0.0, 2.0, 0.0), mode, holding(agent, calm=BRAKE))
    assert Flag.DAMPED not in outcome.flags
    assert outcome.memory.calm == LAW


# --- noticing --------------------------------------------------------------------------------------------------------


@dataclass
class Noticing:
    """Stands in for the residual: remembers what it is asked, and trips when the test says so."""

    trips: bool = True
    pulls: bool = False
    asked: list[dict[str, Any]] = field(default_factory=list)

    def advance(
        self, sense: Any, _terms: Any, _J_inv_P: Any, dq: Any, tau: Any, factor: float, *, ready: bool, periods: int
    ) -> Any:
        asked = {"sense": sense, "dq": dq, "tau": tau, "factor": factor, "ready": ready, "periods": periods}
        self.asked.append(asked)
        return sense._replace(residual=np.array([1.0, 2.0, 3.0]), ticks=sense.ticks + 1.0)

    def over_a_gap(self, sense: Any, _terms: Any, dq: Any) -> Any:
        self.asked.append({"sense": sense, "dq": dq, "gap": True})
        return sense._replace(residual=np.array([1.0, 2.0, 3.0]))

    def channels(self, sense: Any, wrench: Any) -> Channels:
        assert sense.residual.tolist() == [1.0, 2.0, 3.0]
        self.asked[-1]["wrench"] = wrench
        return Channels(10.0, 20.0, 30.0, 40.0)

    def tripped(self, found: Channels, sense: Any, wrench: Any) -> bool:
        assert found == (10.0, 20.0, 30.0, 40.0)
        assert sense.residual.tolist() == [1.0, 2.0, 3.0]
        assert wrench is self.asked[-1]["wrench"]
        return self.trips

    def pulled(self, sense: Any) -> bool:
        assert sense.residual.tolist() == [1.0, 2.0, 3.0]
        return self.pulls


def primed(agent: Agent, **more: Any) -> Memory:
    """As a tick leaves it, with a torque and a sense that are known again."""
    n = agent.model.n
    sense = nothing_sensed(n)._replace(ticks=7.0)
    tau, before = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])
    return initial_memory(agent)._replace(primed=True, t=T, sense=sense, tau=tau, tau_before=before, **more)


def test_who_senses_nothing_says_nothing() -> None:
    outcome = at(arm(), (0.1, 0.2, 0.3), Mode.TRACK)
    assert outcome.sensed is None
    assert Flag.UNEXPECTED not in outcome.flags
    assert outcome.memory.sense.ticks == 0.0


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD])
def test_the_residual_is_given_the_memory_of_the_last_tick(mode: Mode) -> None:
    noticing = Noticing()
    agent = arm(residual=noticing)
    memory = primed(agent, friction_factor=1.3)
    outcome = at(agent, (0.1, 0.2, 0.3), mode, memory)
    (asked,) = noticing.asked
    assert asked["sense"] is memory.sense
    assert asked["factor"] == 1.3
    assert asked["tau"] == (memory.tau, memory.tau_before)
    assert asked["dq"].tolist() == [0.1, 0.2, 0.3]
    assert asked["ready"] is (mode is Mode.READY)
    assert outcome.terms is not None
    assert outcome.terms.J_inv_P is not None
    wrench = outcome.terms.J_inv_P.T @ np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(asked["wrench"], wrench, rtol=1e-12)
    assert outcome.sensed == (*asked["wrench"].tolist(), 10.0, 20.0, 30.0, 40.0)
    assert outcome.memory.sense.ticks == 8.0


@pytest.mark.parametrize(
    ("mode", "passed", "periods"),
    [
        (Mode.TRACK, 0.4, 1), (Mode.TRACK, 1.4, 1), (Mode.TRACK, 1.6, 2), (Mode.TRACK, 3.4, 3), (Mode.TRACK, 3.6, None),
        (Mode.READY, 1000.0, 1), (Mode.READY, 2.0, 1), (Mode.HOLD, 3.6, 1), (Mode.HOLD, 2.0, 1),
    ],
)  # fmt: skip
def test_an_arm_that_missed_cycles_of_the_motion_counts_them_or_keeps_what_it_has_found(
    mode: Mode, passed: float, periods: int | None
) -> None:
    """Before the start, t jumps to it; a hold that missed many begins to sense anew."""
    noticing = Noticing()
    agent = arm(residual=noticing)
    memory = primed(agent)._replace(t=T - passed * agent.period_s)
    at(agent, (0.1, 0.2, 0.3), mode, memory)
    (asked,) = noticing.asked
    assert asked.get("periods") == periods
    assert ("gap" in asked) is (periods is None)
    assert asked["dq"].tolist() == [0.1, 0.2, 0.3]
    assert (asked["sense"] is memory.sense) is (mode is not Mode.HOLD or passed < 3.5)


@pytest.mark.parametrize("periods", [1, 2])
def test_a_cycle_is_missed_when_more_than_half_a_period_is_over(periods: int) -> None:
    noticing = Noticing()
    agent = arm(residual=noticing)
    memory, limit = primed(agent)._replace(t=0.0), (periods + 0.5) * agent.period_s
    for t in (limit, np.nextafter(limit, 1.0)):
        step(agent, JointState(0, start(), np.zeros(3), np.zeros(3)), float(t), Mode.TRACK, memory)
    assert [asked["periods"] for asked in noticing.asked] == [periods, periods + 1]


def test_an_arm_that_missed_cycles_before_it_sensed_anything_begins() -> None:
    noticing = Noticing()
    agent = arm(residual=noticing)
    at(agent, (0.0, 0.0, 0.0), Mode.TRACK, primed(agent)._replace(t=T - 5 * agent.period_s, primed=False))
    assert "gap" not in noticing.asked[0]


def test_a_memory_that_was_not_kept_up_begins_anew() -> None:
    noticing = Noticing()
    agent = arm(residual=noticing)
    outcome = at(agent, (0.0, 0.0, 0.0), Mode.TRACK, primed(agent)._replace(primed=False))
    assert outcome.memory.sense.ticks == 1.0


@pytest.mark.parametrize("trips", [True, False])
@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD])
def test_only_who_tracks_asks_for_a_hold_and_only_beyond_a_threshold(mode: Mode, trips: bool) -> None:
    outcome = at(arm(residual=Noticing(trips)), (0.0, 0.0, 0.0), mode)
    assert (Flag.UNEXPECTED in outcome.flags) is (trips and mode is Mode.TRACK)


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD])
def test_who_is_pulled_back_while_tracking_asks_for_a_hold(mode: Mode) -> None:
    outcome = at(arm(residual=Noticing(trips=False, pulls=True)), (0.0, 0.0, 0.0), mode)
    assert (Flag.UNEXPECTED in outcome.flags) is (mode is Mode.TRACK)


def test_a_hold_by_springs_senses_nothing() -> None:
    agent = arm(residual=Noticing(), sigma_min=1e3)
    outcome = at(agent, (0.0, 0.0, 0.0), Mode.HOLD, holding(agent, primed=True))
    assert outcome.terms is not None
    assert outcome.terms.J_inv_P is None
    assert outcome.sensed is None
    assert outcome.memory.sense.ticks == 0.0
    assert Flag.UNEXPECTED not in outcome.flags


# --- alignment -------------------------------------------------------------------------------------------------------


@dataclass
class Aligning:
    """Stands in for the alignment."""

    asked: list[tuple[Any, ...]] = field(default_factory=list)
    settles: list[tuple[Any, ...]] = field(default_factory=list)

    def advance(self, shift: Any, settled: Any, _errors: Any, dt: float, *, ready: bool) -> Any:
        self.asked.append((shift, settled, dt, ready))
        return (0.5, *shift[1:])

    def settle(self, settled: Any, shift: Any, since_s: float) -> Any:
        self.settles.append((settled, shift, since_s))
        return FOUND


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("known", [True, False])
def test_the_shift_goes_on_while_waiting_or_tracking_with_a_memory_that_was_kept_up(mode: Mode, known: bool) -> None:
    aligning = Aligning()
    agent = arm(alignment=aligning, start=START)
    outcome = at(agent, (0.0, 0.0, 0.0), mode, primed(agent, shift=SHIFT)._replace(primed=known, settled=SETTLED))
    goes_on = known and mode in (Mode.READY, Mode.TRACK)
    assert aligning.asked == ([(SHIFT, SETTLED, agent.period_s, mode is Mode.READY)] if goes_on else [])
    assert outcome.memory.shift == ((0.5, *SHIFT[1:]) if goes_on else SHIFT)
    assert at(arm(), (0.0, 0.0, 0.0), mode, primed(agent, shift=SHIFT)).memory.shift == SHIFT


@pytest.mark.parametrize("mode", list(Mode))
def test_what_the_start_leaves_of_a_shift_is_that_of_the_last_tick_before_it(mode: Mode) -> None:
    aligning = Aligning()
    agent, after = arm(alignment=aligning, start=START), (0.5, *SHIFT[1:])
    outcome = at(agent, (0.0, 0.0, 0.0), mode, primed(agent, shift=SHIFT)._replace(settled=SETTLED))
    assert outcome.memory.settled == {Mode.READY: after, Mode.TRACK: FOUND}.get(mode, SETTLED)
    assert aligning.settles == ([(SETTLED, after, T)] if mode is Mode.TRACK else [])
    plain = at(arm(), (0.0, 0.0, 0.0), Mode.TRACK, primed(agent, shift=SHIFT)._replace(settled=SETTLED))
    assert plain.memory.settled == SETTLED, "it does not align itself"


def desired_of(agent: Agent, mode: Mode, memory: Memory) -> tuple[Any, Any, Any]:
    terms = at(agent, (0.0, 0.0, 0.0), mode, memory).terms
    assert terms is not None
    return terms.desired.p, terms.desired.quat, (*terms.desired.v, *terms.desired.a)


def test_what_is_desired_in_each_mode() -> None:
    aligned = arm(alignment=Alignment(True), start=START)
    still = (0.0,) * 12
    motion = aligned.trajectory.at(0.7)
    waiting = holding(aligned)
    assert waiting.hold is not None
    seen = waiting.hold[:3], waiting.hold[3:], still
    moving = motion.p, motion.quat, (*motion.v, *motion.a)
    assert moving[2] != still
    assert desired_of(aligned, Mode.READY, waiting) == (*START, still), "where the cell says, not where it is seen"
    assert desired_of(arm(start=START), Mode.READY, waiting) == seen
    assert desired_of(arm(alignment=Alignment(True), start=None), Mode.READY, waiting) == seen
    for agent in (aligned, arm()):
        assert desired_of(agent, Mode.TRACK, waiting) == moving
        assert desired_of(agent, Mode.HOLD, waiting) == seen
        assert desired_of(agent, Mode.HOLD, initial_memory(agent)) == moving
    shifted = waiting._replace(shift=(0.01, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert desired_of(aligned, Mode.READY, shifted)[0] == pytest.approx((0.31, 0.1, 0.2))
    assert desired_of(aligned, Mode.TRACK, shifted)[0][0] == pytest.approx(motion.p[0] + 0.01)
    assert desired_of(aligned, Mode.HOLD, shifted) == seen, "a pose that was held has its shift"


# --- what is held ----------------------------------------------------------------------------------------------------


def off(agent: Agent, metres: float, radians: float = 0.0, sign: float = 1.0) -> Outcome:
    """A tick whose object was so far from the pose that it was to have."""
    outcome = at(agent, (0.0, 0.0, 0.0), Mode.TRACK)
    assert outcome.terms is not None
    errors = outcome.terms.errors._replace(
        e_p=(0.6 * metres, 0.0, 0.8 * metres),
        e_eps=(0.0, 0.6 * math.sin(radians / 2), 0.8 * math.sin(radians / 2)),
        e_eta=sign * math.cos(radians / 2),
    )
    return outcome._replace(terms=outcome.terms._replace(errors=errors))


def keeps_the_desired(agent: Agent, outcome: Outcome) -> bool:
    memory = hold_after(agent, outcome)
    assert memory.q_hold is not None
    assert memory.q_hold.tolist() == outcome.q.tolist()
    seen = hold_here(agent, outcome.q, outcome.memory).hold
    assert outcome.terms is not None
    desired = (*outcome.terms.desired.p, *outcome.terms.desired.quat)
    assert seen != desired
    assert memory.hold in (seen, desired)
    return memory.hold == desired


@pytest.mark.parametrize(
    ("metres", "radians", "kept"),
    [
        (0.0, 0.0, True), (0.0199, 0.0, True), (0.0201, 0.0, False), (0.0, 0.0999, True), (0.0, 0.1001, False),
        (math.nan, 0.0, False), (0.0, math.nan, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_aligned_arm_holds_the_pose_that_it_followed_while_the_object_is_near_it(
    metres: float, radians: float, kept: bool, sign: float
) -> None:
    aligned = arm(alignment=Alignment(True))
    assert keeps_the_desired(aligned, off(aligned, metres, radians, sign)) is kept
    assert not keeps_the_desired(arm(), off(arm(), metres, radians, sign)), "any other holds the object where it is"


def test_the_distance_and_the_angle_themselves_are_near(monkeypatch: pytest.MonkeyPatch) -> None:
    aligned = arm(alignment=Alignment(True))
    turned = off(aligned, 0.0, 0.05)
    assert turned.terms is not None
    errors = turned.terms.errors
    angle = 2.0 * math.atan2(math.hypot(*errors.e_eps), abs(errors.e_eta))
    monkeypatch.setattr(standing, "HOLD_DESIRED_MAX_RAD", angle)
    assert keeps_the_desired(aligned, turned)
    outcome = off(aligned, 0.0)
    assert outcome.terms is not None
    exact = outcome.terms._replace(errors=outcome.terms.errors._replace(e_p=(0.02, 0.0, 0.0)))
    assert keeps_the_desired(aligned, outcome._replace(terms=exact))


def test_an_aligned_arm_near_a_singular_pose_or_without_a_law_holds_where_it_is() -> None:
    aligned = arm(alignment=Alignment(True))
    outcome = off(aligned, 0.0)
    assert keeps_the_desired(aligned, outcome._replace(flags=Flag.SATURATED))
    assert not keeps_the_desired(aligned, outcome._replace(flags=Flag.SATURATED | Flag.SINGULAR))
    nothing = hold_after(aligned, outcome._replace(terms=None))
    assert nothing.hold == hold_here(aligned, outcome.q, outcome.memory).hold


def test_an_aligned_arm_waits_with_the_shift_between_what_it_sees_and_what_the_cell_says() -> None:
    aligned = arm(alignment=Alignment(True), start=START)
    memory = wait_here(aligned, start(), initial_memory(aligned))
    assert memory.hold is not None
    pose: Any = memory.hold
    assert memory.shift == between(pose[:3], pose[3:], *START)
    assert memory.shift != initial_memory(aligned).shift
    held = wait_here(aligned, start(), initial_memory(aligned), Mode.HOLD)  # the way down counts from where it stood
    assert (held.hold, held.shift) == (memory.hold, initial_memory(aligned).shift)
    blind = wait_here(aligned, start() * math.nan, initial_memory(aligned))
    for other in (
        wait_here(replace(aligned, alignment=None), start(), initial_memory(aligned)),
        wait_here(replace(aligned, start=None), start(), initial_memory(aligned)),
        blind,
    ):
        assert other.shift == initial_memory(aligned).shift
    assert blind.hold is None
