"""Where the checks of one cycle's rows draw their lines: silence, jumps, no effect, servos of one joint at odds."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.budget import FAULT_WITHIN_S
from drivers.dynamixel.checks import (
    JUMP_RAD,
    NOISE_BYTES,
    NOISE_LIMIT_CYCLES,
    SILENT_LIMIT_CYCLES,
    EffectCheck,
    JumpCheck,
    NoiseCheck,
    PairCheck,
    PartCheck,
    SilenceCheck,
    effect_checks,
)
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import DriverEvent, OncePerServo
from drivers.dynamixel.line.group import Row
from tests.support.servos.dxl_rig import WX200, XL, at

WAIST, SHOULDER, SHADOW, ELBOW = WX200.slots[:4]
RATE_HZ = 200.0
TICK_RAD = 2.0 * 3.141592653589793 / 4096


def row(current: int = 0, velocity: int = 0, position: int = 2048) -> Row:
    return (0, current, velocity, position)


# --- silence ---------------------------------------------------------------------------------------------------------


def silent(check: SilenceCheck, *gone: bool, damaged: bool = False, late: bool = False) -> list[DxlServoFault]:
    return check.check([None if missing else row() for missing in gone], damaged=damaged, late=late)


def test_eight_cycles_without_an_answer_are_a_fault_and_every_one_after() -> None:
    check = SilenceCheck((WAIST, SHOULDER))
    for _ in range(7):
        assert silent(check, False, True) == []
    for count in (8, 9, 10):
        (fault,) = silent(check, False, True)
        assert (fault.cause, fault.servo_id) == (FaultCause.SILENT, SHOULDER.servo_id)
        assert fault.found == f"{count} cycles without an answer"


def test_silence_is_a_fault_within_fifty_milliseconds_at_200_Hz() -> None:
    assert FAULT_WITHIN_S == 0.05
    assert SILENT_LIMIT_CYCLES / RATE_HZ <= FAULT_WITHIN_S


def test_one_answer_begins_the_count_anew_whether_others_are_silent_or_not() -> None:
    for others in (False, True):
        check = SilenceCheck((WAIST, SHOULDER))
        for _ in range(2):
            for _ in range(7):
                assert silent(check, False, True) == []
            assert silent(check, others, False) == []


def test_a_line_that_stalls_as_a_whole_is_borne_where_that_is_asked_for_and_one_servo_is_not() -> None:
    check = SilenceCheck((WAIST, SHOULDER), line_patience=20)
    for _ in range(3):
        assert all(silent(check, True, True) == [] for _ in range(20))
        assert silent(check, False, False) == []
    assert all(silent(check, True, True) == [] for _ in range(27))
    assert len(silent(check, True, True)) == 2
    for stalled in (20, 0):
        check = SilenceCheck((WAIST, SHOULDER), line_patience=20)
        assert all(silent(check, True, True) == [] for _ in range(stalled))
        assert all(silent(check, False, True) == [] for _ in range(7))
        assert len(silent(check, False, True)) == 1


def test_an_arm_that_answers_has_no_fault() -> None:
    check = SilenceCheck((WAIST, SHOULDER))
    assert all(silent(check, False, False) == [] for _ in range(30))


def test_damage_goes_before_late_answers_and_must_have_come_in_each_of_the_cycles() -> None:
    check = SilenceCheck((WAIST,))
    causes = [fault.cause for _ in range(8) for fault in silent(check, True, damaged=True, late=True)]
    assert causes == [FaultCause.GARBLED]
    check = SilenceCheck((WAIST,))
    assert all(silent(check, True, damaged=cycle > 1) == [] for cycle in range(1, 8))
    assert [fault.cause for fault in silent(check, True, damaged=True)] == [FaultCause.SILENT]
    assert [fault.cause for fault in silent(check, True, damaged=True)] == [FaultCause.GARBLED]
    assert [fault.cause for fault in silent(check, True)] == [FaultCause.SILENT]
    assert [fault.cause for _ in range(7) for fault in silent(check, True, damaged=True)] == [FaultCause.SILENT] * 7


@pytest.mark.parametrize(
    ("first", "cause"), [(0, FaultCause.OUTDATED), (5, FaultCause.OUTDATED), (6, FaultCause.SILENT)]
)
def test_late_answers_are_the_cause_where_they_came_in_the_last_three_cycles(first: int, cause: FaultCause) -> None:
    """An answer that is five cycles late comes for the first time in the sixth."""
    check = SilenceCheck((WAIST,))
    assert all(silent(check, True, late=cycle >= first) == [] for cycle in range(7))
    (fault,) = silent(check, True, late=True)
    assert fault.cause is cause
    assert ("old answers in the last" in str(fault.found)) is (cause is FaultCause.OUTDATED)
    assert [fault.cause for fault in silent(check, True)] == [FaultCause.SILENT]


# --- noise -----------------------------------------------------------------------------------------------------------


def test_a_line_that_carries_too_much_in_each_of_five_cycles_is_told_of_its_first_servo() -> None:
    check = NoiseCheck(WAIST, 100)
    heard = [229, 229, 229, 229, 228, 229, 229, 229, 229, 300, 400, 0, 500]
    found = [check.check(count) for count in heard]
    assert [cycle for cycle, faults in enumerate(found) if faults] == [9, 10]
    (fault,), (again,) = found[9:11]
    assert (fault.cause, fault.servo_id, fault.joint) == (FaultCause.NOISE, 1, "waist")
    assert (fault.found, fault.expected) == ("300 bytes, too many in each of 5 cycles", "at most 228 a cycle")
    assert "that nobody else talks on this bus" in str(fault)
    assert again.found == "400 bytes, too many in each of 6 cycles"
    assert (NOISE_BYTES, NOISE_LIMIT_CYCLES) == (128, 5)


# --- jumps -----------------------------------------------------------------------------------------------------------

SPEED = 1.25 * SHOULDER.model.no_load_rad_per_s
NOW_NS, CYCLE_NS = 7_000_000_000, 5_000_000
REACH = SPEED * 0.005 + 4 * TICK_RAD
MARGIN = 1e-9


def test_as_far_as_it_can_go_is_no_jump() -> None:
    check = JumpCheck(SHOULDER)
    check.is_jump(0, 0.0)
    reach = check._speed * CYCLE_NS * 1e-9 + JUMP_RAD
    assert reach == pytest.approx(REACH)
    assert not check.is_jump(CYCLE_NS, reach)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_may_go_as_far_as_its_speed_allows_and_four_ticks(sign: float) -> None:
    for step, jumps in ((REACH - MARGIN, False), (REACH + MARGIN, True)):
        check = JumpCheck(SHOULDER)
        assert not check.is_jump(NOW_NS, 0.3)
        assert check.is_jump(NOW_NS + CYCLE_NS, 0.3 + sign * step) == jumps
        assert check.in_a_row == jumps


def test_the_first_angle_is_believed_whatever_it_is() -> None:
    assert not JumpCheck(SHOULDER).is_jump(0, 100.0)


def test_time_without_a_believed_angle_allows_more_way() -> None:
    check = JumpCheck(SHOULDER)
    check.is_jump(0, 0.0)
    assert check.is_jump(CYCLE_NS, 3.0 * SPEED * 0.005)
    assert not check.is_jump(3 * CYCLE_NS, 1.4 * SPEED * 0.005)


@pytest.mark.parametrize(
    ("then", "jumps"),
    [(0.0, False), (0.49, False), (0.5, True), (0.51, True), (1.0, True), (1.49, True), (-0.51, False)],
)
def test_after_a_jump_an_angle_is_believed_only_nearer_to_where_the_joint_was(then: float, jumps: bool) -> None:
    """Even where the speed would allow it by then; the jump went to 1 rad."""
    for sign in (1.0, -1.0):
        check = JumpCheck(SHOULDER)
        check.is_jump(0, 0.0)
        assert check.is_jump(CYCLE_NS, sign * 1.0)
        assert check.is_jump(1_000_000_000, sign * then) == jumps
        assert check.in_a_row == (2 if jumps else 0)


def test_after_a_jump_back_the_next_one_is_the_first_again() -> None:
    check = JumpCheck(SHOULDER)
    check.is_jump(0, 0.0)
    check.is_jump(CYCLE_NS, 1.0)
    assert not check.is_jump(2 * CYCLE_NS, 0.001)
    assert not check.is_jump(1_000_000_000, 0.9), "nothing is remembered of where the jump went"
    assert check.is_jump(1_000_000_000 + CYCLE_NS, 2.0)
    assert check.in_a_row == 1


def test_a_jump_that_is_repeated_names_the_place_and_the_speed() -> None:
    check = JumpCheck(SHOULDER)
    for k, angle in enumerate((0.0, 1.0, 1.25)):
        check.is_jump(k * CYCLE_NS, angle)
    fault = check.fault()
    assert (fault.cause, fault.servo_id) == (FaultCause.POSITION_JUMP, SHOULDER.servo_id)
    assert fault.found == "a step to 1.250 rad, 2 times in a row"
    assert fault.expected == "at most 6.0 rad/s"


# --- no effect -------------------------------------------------------------------------------------------------------

WORTH, NONE, SLOW = 56, 3, 80  # counts of 2.69 mA and of 0.229 rpm


def ineffective(
    goal: int, answer: Row, cycles: int = 8, slot: ServoSlot = ELBOW, rate_hz: float = RATE_HZ
) -> list[bool]:
    check = EffectCheck(slot, rate_hz)
    return [check.check(goal, answer) is not None for _ in range(cycles)]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("goal", "current", "velocity", "faulty"),
    [
        (WORTH, NONE, SLOW, True),
        (WORTH - 1, 0, 0, False),
        (300, NONE + 1, 0, False),
        (300, -NONE - 1, 0, False),
        (300, -NONE, 0, True),
        (300, 0, SLOW + 1, False),
        (300, 0, -SLOW - 1, False),
        (300, 0, -SLOW, True),
    ],
)
def test_a_goal_worth_it_without_current_of_a_slow_joint_is_no_effect(
    sign: int, goal: int, current: int, velocity: int, faulty: bool
) -> None:
    assert ineffective(sign * goal, row(sign * current, sign * velocity)) == [False] * 7 + [faulty]


@pytest.mark.parametrize(("rate_hz", "cycles"), [(200.0, 8), (201.0, 9), (60.0, 3), (50.0, 2), (20.0, 2), (10.0, 2)])
def test_no_effect_is_a_fault_after_forty_milliseconds_and_two_cycles(rate_hz: float, cycles: int) -> None:
    assert ineffective(300, row(), cycles + 1, rate_hz=rate_hz) == [False] * (cycles - 1) + [True] * 2


def test_one_cycle_with_current_begins_the_count_anew() -> None:
    check = EffectCheck(ELBOW, RATE_HZ)
    for _ in range(2):
        assert all(check.check(300, row()) is None for _ in range(7))
        assert check.check(300, row(100)) is None


def test_what_had_no_effect_is_told_in_amperes() -> None:
    check = EffectCheck(ELBOW, RATE_HZ)
    fault = [check.check(-300, row(-2)) for _ in range(8)][-1]
    assert fault is not None
    assert (fault.cause, fault.servo_id) == (FaultCause.NO_EFFECT, ELBOW.servo_id)
    assert (fault.found, fault.expected) == ("-0.005 A for 8 cycles", "-0.807 A")


def test_only_servos_whose_current_is_commanded_are_checked_for_effect() -> None:
    assert [WX200.slots[place].servo_id for place in effect_checks(WX200)] == [2, 3, 4, 5]


# --- a part of the current -------------------------------------------------------------------------------------------

PART_FROM, STALL, CALM = 112, 855, 20  # counts of 2.69 mA and of 0.229 rpm


class Parts:
    """What was told of a servo that gives a part of what it is told."""

    def __init__(self, rate_hz: float = RATE_HZ) -> None:
        self.events: list[DriverEvent] = []
        self._tell = OncePerServo(self.events.append)
        self._check = PartCheck(ELBOW, rate_hz)

    def __call__(self, goal: int, answer: Row, cycles: int = 1) -> int:
        for _ in range(cycles):
            self._check.check(goal, answer, self._tell)
        return len(self.events)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("goal", "current", "velocity", "told"),
    [
        (PART_FROM, 55, CALM, True),
        (PART_FROM, 55, -CALM, True),
        (PART_FROM, 56, 0, False),
        (PART_FROM, -300, 0, True),
        (PART_FROM - 1, 0, 0, False),
        (300, 0, CALM + 1, False),
        (300, 0, -CALM - 1, False),
        (1193, 427, 0, True),
        (1193, STALL // 2 + 1, 0, False),  # more than it stalls with nobody can ask of it
    ],
)
def test_a_slow_servo_that_gives_less_than_half_of_a_current_that_it_can_give_is_told(
    sign: int, goal: int, current: int, velocity: int, told: bool
) -> None:
    parts, answer = Parts(), row(sign * current, sign * velocity)
    assert parts(sign * goal, answer, 99) == 0
    assert parts(sign * goal, answer, 20) == told


@pytest.mark.parametrize(("rate_hz", "cycles"), [(200.0, 100), (201.0, 101), (4.0, 2), (1.0, 2)])
def test_a_part_of_the_current_is_told_after_half_a_second_and_two_cycles(rate_hz: float, cycles: int) -> None:
    parts = Parts(rate_hz)
    assert parts(300, row(30), cycles - 1) == 0
    assert parts(300, row(30)) == 1


def test_one_cycle_with_its_current_begins_the_count_anew_and_one_that_says_nothing_does_not() -> None:
    parts = Parts()
    for _ in range(2):
        assert parts(300, row(30), 99) == 0
        assert parts(300, row(150)) == 0
    assert parts(300, row(30), 99) == 0
    assert parts(0, row()) == 0
    assert parts(300, row(30, 200)) == 0
    assert parts(300, row(30)) == 1


def test_a_part_of_the_current_is_told_in_amperes_once_until_it_has_ended() -> None:
    parts = Parts()
    assert parts(-300, row(-58), 300) == 1
    assert parts(-300, row(-300)) == 1
    assert parts(-300, row(-58), 100) == 2
    event = parts.events[0]
    assert (event.kind.name, event.servo_id, event.joint) == ("PART_OF_CURRENT", 4, "elbow")
    assert event.text == "-0.156 A of -0.807 A, in 100 slow cycles"


# --- servos of one joint ---------------------------------------------------------------------------------------------

FIGHT = 75  # counts


class Told:
    """What was told, and the pair that tells it."""

    def __init__(self, followed: ServoSlot = SHOULDER, shadow: ServoSlot = SHADOW, rate_hz: float = RATE_HZ) -> None:
        self.events: list[DriverEvent] = []
        self._tell = OncePerServo(self.events.append)
        self._check = PairCheck(followed, shadow, rate_hz)

    def __call__(self, followed: Row, shadow: Row, cycles: int = 1) -> list[str]:
        for _ in range(cycles):
            self._check.check(followed, shadow, self._tell)
        return [event.kind.name for event in self.events]


@pytest.mark.parametrize(
    ("followed", "shadow", "fights"),
    [
        (FIGHT, -FIGHT, True),
        (-FIGHT, FIGHT, True),
        (FIGHT - 1, -300, False),
        (300, 1 - FIGHT, False),
        (300, 300, False),
        (-300, -300, False),
        (0, -300, False),
    ],
)
def test_servos_of_a_joint_that_push_against_each_other_for_a_tenth_of_a_second_are_told(
    followed: int, shadow: int, fights: bool
) -> None:
    told = Told()
    assert told(row(followed), row(shadow), 19) == []
    assert told(row(followed), row(shadow), 20) == ["PAIR_FIGHTING"] * fights
    if fights:
        (event,) = told.events
        assert (event.servo_id, event.joint, event.text) == (
            3,
            "shoulder",
            f"{followed} against {shadow} counts of current",
        )


@pytest.mark.parametrize(("rate_hz", "cycles"), [(200.0, 20), (201.0, 21), (20.0, 2), (10.0, 2)])
def test_a_fight_is_told_after_a_tenth_of_a_second_and_two_cycles(rate_hz: float, cycles: int) -> None:
    told = Told(rate_hz=rate_hz)
    assert told(row(300), row(-300), cycles - 1) == []
    assert told(row(300), row(-300)) == ["PAIR_FIGHTING"]


def test_a_fight_that_stops_in_between_is_counted_anew_and_told_again_when_it_comes_back() -> None:
    told = Told()
    for _ in range(3):
        assert told(row(300), row(-300), 19) == []
        assert told(row(300), row(300)) == []
    assert told(row(300), row(-300), 25) == ["PAIR_FIGHTING"]
    told(row(300), row(300))
    assert told(row(300), row(-300), 20) == ["PAIR_FIGHTING"] * 2


def test_servos_without_a_current_sensor_cannot_be_seen_to_fight() -> None:
    joint = replace(SHOULDER.joint, servo=XL)
    assert Told(replace(SHOULDER, joint=joint), replace(SHADOW, joint=joint))(row(300), row(-300), 50) == []


def apart(ticks: int, offset: int = 0) -> list[str]:
    told = Told()
    told(row(position=2048), row(position=2048 + offset))
    return told(row(position=2148), row(position=2148 + offset + ticks))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("ticks", "told"), [(0, False), (39, False), (41, True), (2000, True), (3911, True), (3912, False), (4096, False)]
)
def test_servos_of_a_joint_that_move_apart_by_more_than_forty_ticks_are_told(sign: int, ticks: int, told: bool) -> None:
    """A whole turn is the seam of an encoder; counts come back into the turn, so larger gaps are made by hand."""
    check = Told()
    check._check._scale.angle_rad = lambda tick: tick * TICK_RAD  # type: ignore[method-assign]
    check(row(position=1000), row(position=1200))
    assert check(row(position=1100), row(position=1300 + sign * ticks)) == ["PAIR_APART"] * told


def test_how_far_servos_were_apart_at_first_does_not_matter() -> None:
    assert apart(0, offset=300) == []
    assert apart(41, offset=300) == ["PAIR_APART"]
    assert apart(-41, offset=-300) == ["PAIR_APART"]


def test_servos_apart_are_told_once_and_again_after_they_were_together() -> None:
    told = Told()
    told(row(), row())
    assert told(row(), row(position=2148), 5) == ["PAIR_APART"]
    (event,) = told.events
    assert (event.servo_id, event.joint, event.text) == (3, "shoulder", "0.153 rad since the first reading")
    told(row(), row())
    assert told(row(), row(position=2148)) == ["PAIR_APART"] * 2


def test_the_arm_of_another_rate_is_checked_at_its_rate() -> None:
    checks = effect_checks(at(WX200, rate_hz=50.0))
    for effect, _ in checks.values():
        assert [effect.check(300, row()) is not None for _ in range(2)] == [False, True]
    events: list[DriverEvent] = []
    for _, part in checks.values():
        for _ in range(25):
            assert events == []
            part.check(300, row(30), OncePerServo(events.append))
        assert events.pop().kind.name == "PART_OF_CURRENT"
