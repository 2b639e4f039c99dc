"""What an unexpected wrench is put down to, by direction, and by real laws and faults in one process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.schema.fault import Fault, FaultKind
from agent.config.schema.reality import ArmReality, Reality
from agent.control import cause
from agent.control.against import Against, Pull
from agent.control.borne import NOT_BORNE, Bearing, Borne
from agent.control.cause import Cause, behind, causes, described, named, parts
from agent.control.friction import Friction
from agent.control.knock import Knock, Struck
from agent.control.residual import Channels, Residual, nothing_sensed
from agent.control.terms import DQ_REF, Terms
from agent.modes import Mode
from agent.safety import Flag
from agent.study.lab import Laboratory, Run
from tests.support.branched import branched, ways

GRAVITY, FORWARD = (0.0, 0.0, -9.81), (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
LIMITS = Channels(2.0, 0.4, 0.8, 0.2)


def told(*f: float, v: tuple[float, ...] = FORWARD, limit_N: float = 2.0) -> tuple[Cause, ...]:
    return causes(np.array(f), limit_N, v, GRAVITY)


@pytest.mark.parametrize(
    ("f", "expected"),
    [
        ((0.0, 0.0, -3.0), (Cause.WEIGHT,)),
        ((2.0, 0.0, -2.5), (Cause.WEIGHT,)),
        ((-2.0, 0.0, -2.5), (Cause.WEIGHT, Cause.BACK)),
        ((-2.5, 0.0, -2.0), (Cause.BACK, Cause.WEIGHT)),
        ((-3.0, 0.5, 0.5), (Cause.BACK,)),
        ((0.0, 0.5, 3.0), (Cause.LIFT,)),
        ((3.0, 0.0, 0.0), (Cause.PUSH,)),
        ((0.0, 3.0, 1.0), (Cause.PUSH,)),
        ((0.0, 0.0, -1.1), (Cause.WEIGHT,)),
        ((0.0, 0.0, -0.9), (Cause.TWIST,)),
        ((np.nan, 0.0, 0.0), (Cause.TWIST,)),
    ],
)
def test_a_force_is_put_down_to_what_fits_its_direction(f: tuple[float, ...], expected: tuple[Cause, ...]) -> None:
    assert told(*f) == expected


def test_the_cosine_from_which_on_a_direction_fits() -> None:
    for angle, fits in ((1.0, True), (1.2, False)):
        assert (Cause.WEIGHT in told(3.0 * np.sin(angle), 0.0, -3.0 * np.cos(angle))) is fits


def test_a_motion_at_rest_pulls_nobody_back() -> None:
    assert told(-3.0, 0.0, 0.0, v=(5e-4, 0.0, 0.0, 0.0, 0.0, 0.0)) == (Cause.PUSH,)
    assert told(-3.0, 0.0, 0.0, v=(2e-3, 0.0, 0.0, 0.0, 0.0, 0.0)) == (Cause.BACK,)


@pytest.mark.parametrize(("gravity", "expected"), [(0.0, Cause.PUSH), (-0.5, Cause.WEIGHT)])
def test_without_weight_nothing_is_limp_and_weak_gravity_has_a_direction_too(gravity: float, expected: Cause) -> None:
    assert causes(np.array([0.0, 0.0, -3.0]), 2.0, FORWARD, (0.0, 0.0, gravity)) == (expected,)


def test_the_first_part_is_that_of_the_channel_farthest_above_its_limit() -> None:
    residual, wrench = Residual(5e-3, 1.0, LIMITS), np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.1])
    sense = nothing_sensed(3)._replace(
        base=np.array([0.0, 0.5, 0, 0, 0, 0]), slow=np.array([1.3, 0, 0, 0, 0, 0]), rest=np.array([0.4, 0, 0, 0, 0, 0])
    )
    (fast, fast_N), (slow, slow_N) = parts(residual, sense, wrench)
    assert fast.tolist() == [0.0, 2.5, 0.0, 0.0, 0.0, 0.1]
    assert slow.tolist() == pytest.approx([0.9, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert (fast_N, slow_N) == (2.0, 0.8)
    (slower, slow_N), (_, fast_N) = parts(residual, sense._replace(slow=np.array([1.9, 0, 0, 0, 0, 0])), wrench)
    assert slower[:3].tolist() == pytest.approx([1.5, 0.0, 0.0])
    assert (slow_N, fast_N) == (0.8, 2.0)


@pytest.mark.parametrize(
    ("wrench", "slow", "size_N", "limit_N"),
    [
        ((0.0, 1.0, 0.0, 0.0, 0.0, 0.5), (0.9, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 2.0),  # a sudden moment, 1.25 times
        ((0.0, 2.4, 0.0, 0.0, 0.0, 0.0), (0.9, 0.0, 0.0, 0.0, 0.0, 0.3), 0.9, 0.8),  # one that stays, 1.5 times
    ],
)
def test_a_moment_counts_as_a_force_does(
    wrench: tuple[float, ...], slow: tuple[float, ...], size_N: float, limit_N: float
) -> None:
    sense = nothing_sensed(3)._replace(slow=np.array(slow))
    part, limit = parts(Residual(5e-3, 1.0, LIMITS), sense, np.array(wrench))[0]
    assert (np.linalg.norm(part[:3]), limit) == (size_N, limit_N)


BEYOND = (0.0, 9.81 * 0.15, 0.0)  # of an object 0.15 m ahead of the arm, along x


def both(
    first: tuple[float, ...], other: tuple[float, ...] = (), beyond: tuple[float, ...] = BEYOND, g: float = 9.81
) -> tuple[Cause, ...]:
    """What is named of a part with a limit of 2 N, the farthest above its own, and another one with 1 N."""
    a, b = (np.array([*f, *[0.0] * (6 - len(f))]) for f in (first, other))
    return named([(a, 2.0), (b, 1.0)], FORWARD, (0.0, 0.0, -g), beyond)


@pytest.mark.parametrize(
    ("first", "other", "expected"),
    [
        ((0.0, 0.0, 0.5), (0.0, 0.0, -1.01), (Cause.WEIGHT,)),
        ((0.0, 0.0, 0.5), (1.01, 0.0, 0.0), (Cause.PUSH,)),
        ((0.0, 0.0, 0.5), (0.0, 0.0, -0.99), (Cause.TWIST,)),
        ((-3.0, 0.0, 0.0), (0.0, 0.0, -1.01), (Cause.BACK, Cause.WEIGHT)),
        ((-3.0, 0.0, 0.0), (0.0, 0.0, -0.99), (Cause.BACK,)),
        ((-3.0, 0.0, 0.0), (0.0, 0.0, -0.99, 0.5, 0.0, 0.0), (Cause.BACK,)),  # a moment is no force
        ((-3.0, 0.0, 0.0), (-1.1, 0.0, -1.0), (Cause.BACK, Cause.WEIGHT)),
        ((-3.0, 0.0, 0.0), (1.5, 0.0, 0.0), (Cause.BACK,)),
        ((3.0, 0.0, 0.0), (0.0, 0.0, 1.5), (Cause.PUSH, Cause.LIFT)),
        ((3.0, 0.0, 0.0), (1.5, 0.0, 0.0), (Cause.PUSH,)),
        ((3.0, 0.0, 0.0), (np.nan, 0.0, 0.0), (Cause.PUSH,)),
    ],
)
def test_what_fits_the_force_of_the_other_channel_is_named_where_that_is_above_its_limit_too(
    first: tuple[float, ...], other: tuple[float, ...], expected: tuple[Cause, ...]
) -> None:
    assert both(first, other) == expected


def test_a_moment_without_a_force_may_be_that_of_a_weight_on_the_far_side_of_the_object() -> None:
    """An adaptive arm takes up the force of a limp neighbour, and not where it acts."""
    assert both((0.0, 0.0, -0.1, 0.0, 0.5, 0.0)) == (Cause.WEIGHT, Cause.TWIST)
    assert both((0.0, 0.0, -0.1, 0.0, -0.5, 0.0)) == (Cause.TWIST,), "a lift there"
    assert both((0.0, 0.0, -0.1, 0.5, 0.0, 0.0)) == (Cause.TWIST,), "about the line between them"
    assert both((0.0, 0.0, 0.0, 0.0, 0.5, 0.0), (-1.5, 0.0, 0.0)) == (Cause.BACK, Cause.WEIGHT)
    for angle, fits in ((1.0, True), (1.2, False)):
        moment = (0.5 * np.sin(angle), 0.5 * np.cos(angle), 0.0)
        assert (Cause.WEIGHT in both((0.0, 0.0, 0.0, *moment))) is fits
    for lever_m, fits in ((1.1e-3, True), (0.9e-3, False)):
        assert (Cause.WEIGHT in both((0.0, 0.0, 0.0, 0.0, 0.5, 0.0), beyond=(0.0, 9.81 * lever_m, 0.0))) is fits


@pytest.mark.parametrize(
    ("down_N", "moment_Nm", "expected"),
    [
        (0.185, 0.1, (Cause.BACK, Cause.WEIGHT)),
        (0.175, 0.1, (Cause.BACK,)),
        (0.185, -0.1, (Cause.BACK,)),
        (0.185, 0.0, (Cause.BACK,)),
        (-0.185, 0.1, (Cause.BACK,)),
        (3.0, 0.1, (Cause.WEIGHT, Cause.BACK)),
    ],
)
def test_a_force_slightly_down_that_also_turns_the_object_down_on_the_far_side_may_be_a_weight(
    down_N: float, moment_Nm: float, expected: tuple[Cause, ...]
) -> None:
    first = (-3.0, 0.0, -down_N, 0.0, moment_Nm, 0.0)
    assert both(first) == expected
    assert both(first, beyond=(0.0, 0.5 * 0.15, 0.0), g=0.5) == expected, "where gravity is weak, too"


@pytest.mark.parametrize(
    ("first", "expected"),
    [
        ((1.9, 0.0, 0.0, 0.0, 0.5, 0.0), (Cause.PUSH, Cause.WEIGHT)),
        ((1.9, 0.0, 0.0, 0.7, 1.2, 0.0), (Cause.PUSH, Cause.WEIGHT)),
        ((2.1, 0.0, 0.0, 0.0, 0.5, 0.0), (Cause.PUSH,)),
        ((1.9, 0.0, 0.8, 0.0, 0.5, 0.0), (Cause.PUSH,)),
        ((0.0, 0.0, 1.9, 0.0, 0.5, 0.0), (Cause.LIFT,)),
    ],
)
def test_where_only_the_moment_is_above_its_limit_it_names_a_weight_beside_what_fits_the_force(
    first: tuple[float, ...], expected: tuple[Cause, ...]
) -> None:
    """The words of a lift name a limp neighbour by themselves."""
    assert both(first) == expected


def test_all_that_a_neighbour_can_do_names_it() -> None:
    """A neighbour that opened its gripper or went limp also lifts, twists or pushes the object at this arm."""
    assert [cause for cause in Cause if "a neighbour" not in cause] == [Cause.BEGIN]
    assert "a neighbour is limp or let go of it" in Cause.LIFT


def test_what_pulls_down_is_a_weight_first_and_what_pulls_back_a_neighbour_that_holds() -> None:
    """The sense of arms of three and more says which; the direction of the force says what else it may be."""

    def found(*f: float, weighs: bool) -> tuple[Cause, ...]:
        return behind(np.array(f), FORWARD, GRAVITY, weighs=weighs, drags=not weighs)

    def struck(*f: float) -> tuple[Cause, ...]:
        return behind(np.array(f), FORWARD, GRAVITY, weighs=False, drags=False)

    assert found(0.0, 0.0, -0.1, weighs=True) == (Cause.WEIGHT,)
    assert found(-0.1, 0.0, -0.05, weighs=True) == (Cause.WEIGHT, Cause.BACK)
    assert found(0.1, 0.0, 0.0, weighs=True) == (Cause.WEIGHT,), "a push is none"
    assert found(-0.1, 0.0, 0.0, weighs=False) == (Cause.BACK,)
    assert found(0.0, 0.0, -0.1, weighs=False) == (Cause.WEIGHT, Cause.BACK)
    assert found(0.0, 0.0, 0.1, weighs=False) == (Cause.LIFT, Cause.BACK)
    assert found(0.1, 0.0, 0.0, weighs=False) == (Cause.BACK,)
    assert found(0.0, 0.0, 0.0, weighs=False) == (Cause.BACK,), "no force is no twist"
    assert struck(0.1, 0.0, 0.0) == (Cause.PUSH,)
    assert struck(0.0, 0.0, 0.1) == (Cause.LIFT,)


def test_the_words_have_all_that_fits_and_the_sizes() -> None:
    text = described((Cause.BACK, Cause.WEIGHT), Channels(2.5, 0.31, 0.24, 0.02))
    assert text == f"{Cause.BACK}; or {Cause.WEIGHT} (2.5 N, 0.31 N·m at once; 0.24 N, 0.02 N·m that stay)"


@pytest.fixture(scope="module")
def lab() -> Laboratory:
    return Laboratory(load_cell(Path("two_wx200"), ["simulation.ready_s=1.0", "trajectory.ramp_s=0.5"]))


@pytest.fixture(scope="module")
def until(lab: Laboratory) -> Callable[[float], Run]:
    return ways(lab)


@pytest.mark.parametrize("at_s", [0.7, pytest.param(1.1, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("kind", "cause", "within_s"),
    [
        (FaultKind.LIMP, Cause.WEIGHT, 0.11),
        (FaultKind.HOLD, Cause.BACK, 0.1),
        (FaultKind.LOCKED, Cause.BACK, 0.09),
    ],
)
@pytest.mark.fault("F1", "F2")
def test_the_neighbour_of_a_fault_names_it(
    lab: Laboratory, until: Callable[[float], Run], kind: FaultKind, cause: Cause, within_s: float, at_s: float
) -> None:
    run = branched(until(at_s), lab, Fault(kind=kind, arm="left", at_s=at_s))
    while run.t < at_s + 0.15 and run.places[1].mode is not Mode.HOLD:
        run.advance()
    (trip,) = (t for t in run.trips if t.arm == "right")
    assert trip.flags & Flag.UNEXPECTED
    assert trip.t - at_s <= within_s
    assert cause in trip.why


@pytest.mark.parametrize(
    ("cell", "arm", "at_s"),
    [
        ("paper_real", "left", -0.35),
        ("paper_adaptive", "left", -0.2),
        pytest.param("paper_real", "right", -0.35, marks=pytest.mark.long),
        pytest.param("paper_adaptive", "right", -0.35, marks=pytest.mark.long),
        pytest.param("paper_adaptive", "right", -0.2, marks=pytest.mark.long),
    ],
)
@pytest.mark.fault("F1")
def test_a_neighbour_that_went_limp_just_before_the_start_is_named_although_a_moment_tells_first(
    cell: str, arm: str, at_s: float
) -> None:
    run = Run(Laboratory(load_cell(Path(cell), ["simulation.ready_s=2.0"])), None)
    while run.t < 0.3 and not run.trips:
        if run.t >= at_s:
            next(place for place in run.places if place.agent.name == arm).limp = True
        run.advance()
    (trip,) = run.trips
    assert trip.why.startswith(Cause.WEIGHT)


@pytest.mark.parametrize(("force_N", "noticed"), [(10.0, True), (2.0, False)])
@pytest.mark.fault("F5")
def test_a_push_is_noticed_and_a_touch_is_not(
    lab: Laboratory, until: Callable[[float], Run], force_N: float, noticed: bool
) -> None:
    run = branched(until(0.7), lab)
    assert not run.trips
    run.plant.push(np.array([0.0, 0.0, -force_N, 0.0, 0.0, 0.0]))
    while run.t < 0.75 if noticed else run.t < 1.2:
        run.advance()
    assert bool(run.trips) is noticed
    if noticed:
        assert Cause.WEIGHT in run.trips[0].why


OFF_BY = Reality(arms={"left": ArmReality(base_m=(-1e-3, 0.0, 1.5e-3))})
BEFORE, UNALIGNED = "simulation.ready_s=1.0", "controller.alignment.enabled=false"


def first_trips(reality: Reality | None, *changes: str) -> dict[str, str]:
    """Why arms of two_wx200 hold within 0.1 s of the start, by arm."""
    run = Run(Laboratory(load_cell(Path("two_wx200"), [BEFORE, *changes])), reality)
    while run.t < 0.1:
        run.advance()
    return {trip.arm: trip.why for trip in run.trips}


def test_an_arm_that_strikes_itself_as_the_motion_begins_blames_nobody_else() -> None:
    assert first_trips(OFF_BY) == {}, "it aligns itself"
    assert first_trips(OFF_BY, UNALIGNED)["left"].startswith(f"{Cause.BEGIN} (")
    moving = first_trips(None, "trajectory.ramp_s=0.0", "trajectory.period_s=3.0")
    assert moving
    assert all(why.startswith(f"{Cause.BEGIN} (") for why in moving.values())


def test_a_push_as_the_motion_begins_is_one() -> None:
    push = "simulation.push=[{at_s=0.0, force_N=[0.0, 0.0, -15.0], duration_s=1.0}]"
    for changes in ([push], [push, UNALIGNED]):
        pushed = first_trips(None, *changes)
        assert pushed
        assert all(why.startswith(Cause.WEIGHT) for why in pushed.values())


def first_terms() -> Terms:
    """Of the first tick of an arm of two_wx200."""
    run = Run(Laboratory(load_cell(Path("two_wx200"), [BEFORE])), None)
    run.advance()
    assert run.places[0].outcome is not None
    terms = run.places[0].outcome.terms
    assert terms is not None
    return terms


BEARING = Bearing(5e-3, 1.0, 3.0, Friction((), 0.1), (0.0, 0.0, -1.0))


@pytest.mark.parametrize(
    ("back_N", "down_N", "level_N", "borne", "fits", "felt"),
    [
        (0.3, 1.2, 0.3, NOT_BORNE, (Cause.WEIGHT,), "0.3 N against the motion, 1.2 N down"),
        (0.3, 0.9, 1.2, NOT_BORNE, (Cause.WEIGHT, Cause.BACK), "1.2 N against the motion, 0.9 N down"),
        (
            0.4,
            0.1,
            0.4,
            Borne(load_N=1.5, stuck_N=2.5),
            (Cause.WEIGHT, Cause.BACK),
            "0.4 N against the motion, 0.1 N down (1.5 N with what friction bears, 2.5 N of joints that stick)",
        ),
    ],
)
def test_where_no_channel_is_above_its_limit_the_sense_of_three_and_more_arms_tells_what_it_is(
    back_N: float, down_N: float, level_N: float, borne: Borne, fits: tuple[Cause, ...], felt: str
) -> None:
    """Beside the direction of the sudden force, which is what the wrench has beyond its slow part."""
    against, knock, terms = Against(5e-3, 1.0, 0.5, (0.0, 0.0, -1.0)), Knock(5e-3, 5.0), first_terms()
    residual = Residual(5e-3, 1.0, LIMITS, against=against, knock=knock, bearing=BEARING)
    base = np.array([2.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    pull, struck = Pull(level_N, weight_N=down_N), Struck(knock_N=0.6, slip=1.0)
    sense = nothing_sensed(3)._replace(base=base, pull=pull, struck=struck, borne=borne)
    wrench = base - np.array([back_N, 0.0, down_N, 0.0, 0.0, 0.0])
    found = residual.channels(sense, wrench)
    assert not residual.tripped(found, sense, wrench)
    moving = terms._replace(desired=terms.desired._replace(v=FORWARD))
    said = cause.told(residual, sense, [*wrench.tolist(), *found], moving, GRAVITY, 1.0)
    assert said == f"{described(fits, found)}, {felt}, 0.6 N of a blow"


@pytest.mark.parametrize(
    ("times", "t", "begin"),
    [
        (1.0, 0.0, True),
        (1.9, 0.0, True),
        (2.1, 0.0, False),
        (0.7, 0.0, True),
        (0.6, 0.0, False),
        (-1.0, 0.0, False),
        (1.0, 0.019, True),
        (1.0, 0.021, False),
        (1.0, -0.001, False),
    ],
)
def test_a_wrench_that_is_mostly_that_of_the_jump_is_put_down_to_it_at_once_alone(
    times: float, t: float, begin: bool
) -> None:
    residual, terms = Residual(5e-3, 1.0, LIMITS), first_terms()
    assert terms.J_inv_P is not None
    joints = terms.joints.copy()
    joints[DQ_REF] = [0.3, -0.2, 0.1]
    own = -30.0 * terms.J_inv_P.T @ terms.kinematics.B @ joints[DQ_REF]
    sensed = [*(times * own).tolist(), 9.0, 9.0, 0.0, 0.0]
    sense = nothing_sensed(3)._replace(base=np.array([1.0, 0.0, 1.0, 0.0, 0.1, 0.0]))
    sensed[:6] = (np.array(sensed[:6]) + sense.base).tolist()
    said = cause.told(residual, sense, sensed, terms._replace(joints=joints), GRAVITY, t)
    assert said.startswith(Cause.BEGIN) is begin
    assert not cause.told(residual, sense, sensed, terms._replace(J_inv_P=None), GRAVITY, t).startswith(Cause.BEGIN)
