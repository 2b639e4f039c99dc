"""The bounds of each rule about a servo, on values that no bus brought."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dynamixel.arm_map import JointRole
from drivers.dynamixel.servo import judge, table
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.found import Rule, ServoFound
from drivers.dynamixel.servo.table import Register
from drivers.dynamixel.servo.torque import CurrentDrive
from drivers.dynamixel.servo.wanted import run_values, setup_values
from tests.support.servos.dxl_rig import WX200

WAIST, SHOULDER, SHADOW, ELBOW, WRIST, ROTATE, GRIPPER = WX200.slots
HERE = {"waist": 2048, "shoulder": 2048 - 391, "elbow": 2048 + 456, "wrist_angle": 2048 + 261, "wrist_rotate": 2048}


def servo(slot=ELBOW, *, firmware: int = 46, model_number: int | None = None, **values: int) -> ServoFound:
    """A healthy servo, but for these registers (names with _ for spaces)."""
    factory = {r.name: r.default or 0 for r in judge.registers(slot.model)}
    healthy = {
        **factory,
        **{r.name: value for r, value in {**setup_values(slot), **run_values(slot)}.items() if r.name in factory},
        table.PRESENT_INPUT_VOLTAGE.name: 120,
        table.PRESENT_TEMPERATURE.name: 30,
        table.PRESENT_POSITION.name: HERE.get(slot.joint.name, 0),
    }
    changed = {name.replace("_", " "): value for name, value in values.items()}
    assert changed.keys() <= healthy.keys()
    healthy[table.GOAL_PWM.name] = (healthy | changed)[table.PWM_LIMIT.name]
    return ServoFound(
        slot, slot.model.model_number if model_number is None else model_number, firmware, healthy | changed
    )


def broken(found: ServoFound) -> list[Rule]:
    return [misfit.rule for misfit in judge.judge(found)]


@pytest.mark.parametrize("slot", WX200.slots, ids=lambda slot: slot.title)
def test_a_servo_as_it_should_be_breaks_no_rule(slot) -> None:
    assert broken(servo(slot)) == []


def test_of_another_model_nothing_else_is_said() -> None:
    assert broken(servo(firmware=30, model_number=1060, Homing_Offset=9)) == [judge.MODEL]
    (misfit,) = judge.judge(servo(model_number=4711))
    assert misfit.said.found == "servo of model number 4711"


@pytest.mark.parametrize(
    ("firmware", "rules"),
    [(37, [judge.FIRMWARE, judge.FAST_READ]), (38, [judge.FAST_READ]), (44, [judge.FAST_READ]), (45, [])],
)
def test_firmware(firmware: int, rules: list[Rule]) -> None:
    assert broken(servo(firmware=firmware)) == rules


@pytest.mark.parametrize(
    ("volts", "rules"),
    [
        (9.4, [judge.SUPPLY]), (9.5, [judge.RATED_SUPPLY]), (11.0, [judge.RATED_SUPPLY]), (11.1, []), (12.9, []),
        (13.0, [judge.RATED_SUPPLY]), (16.0, [judge.RATED_SUPPLY]), (16.1, [judge.SUPPLY]),
    ],
)  # fmt: skip
def test_supply(volts: float, rules: list[Rule]) -> None:
    assert broken(servo(Present_Input_Voltage=round(10 * volts))) == rules


@pytest.mark.parametrize(
    ("slot", "celsius", "rules"),
    [
        (ELBOW, 74, []), (ELBOW, 75, [judge.WARMTH]), (ELBOW, 79, [judge.WARMTH]), (ELBOW, 80, [judge.HEAT]),
        (ELBOW, 95, [judge.HEAT]), (ROTATE, 66, []), (ROTATE, 67, [judge.WARMTH]), (ROTATE, 72, [judge.HEAT]),
    ],
)  # fmt: skip
def test_temperature_against_the_servo_s_own_limit(slot, celsius: int, rules: list[Rule]) -> None:
    assert broken(servo(slot, Present_Temperature=celsius)) == rules


@pytest.mark.parametrize("slot", [ELBOW, SHADOW], ids=["single", "shadow"])
@pytest.mark.parametrize("secondary", [2, 4, 252, 253, 254, 255])
def test_secondary_id(slot, secondary: int) -> None:
    found = replace(servo(slot), values={**servo(slot).values, table.SECONDARY_ID.name: secondary})
    fits = secondary == 2 if slot is SHADOW else secondary >= 253
    assert broken(found) == ([] if fits else [judge.SECONDARY])


@pytest.mark.parametrize(
    ("slot", "ticks", "fits"),
    [
        (ELBOW, 97, True), (ELBOW, 99, False), (ELBOW, -97, True), (ELBOW, -99, False),  # 0.15 rad is 97.8 ticks
        (SHADOW, 300, True), (GRIPPER, 1000, True), (ELBOW, 4096, True),
    ],
    ids=str,
)  # fmt: skip
def test_start_pose_within_its_tolerance_of_joints_that_have_one(slot, ticks: int, fits: bool) -> None:
    found = servo(slot, Present_Position=HERE.get(slot.joint.name, 0) + ticks)
    assert broken(found) == ([] if fits else [judge.POSE])


def test_a_gripper_may_stand_anywhere() -> None:
    narrow = replace(GRIPPER, joint=replace(GRIPPER.joint, position_limit_ticks=(1802, 2875)))
    assert broken(servo(narrow, Present_Position=1000)) == []


@pytest.mark.parametrize(("role", "beyond"), [(JointRole.CONTROLLED, 19), (JointRole.HELD, 0)])  # 0.03 rad: 19.6 ticks
def test_start_pose_is_bounded_by_the_joint_s_own_limits_too_and_an_end_stop_may_be_beyond_them(
    role: JointRole, beyond: int
) -> None:
    joint = replace(ELBOW.joint, start_rad=None, role=role)
    low, high = (limit + sign * beyond for limit, sign in zip(joint.position_limit_ticks, (-1, 1), strict=True))
    for tick, fits in ((low - 1, False), (low, True), (high, True), (high + 1, False)):
        assert broken(servo(replace(ELBOW, joint=joint), Present_Position=tick)) == ([] if fits else [judge.POSE])


@pytest.mark.parametrize("slot", [SHOULDER, SHADOW, ELBOW, WAIST], ids=lambda slot: slot.title)
def test_current_limit_of_every_servo_that_takes_torque_or_holds_by_it(slot) -> None:
    needed = 342 if slot is WAIST else CurrentDrive(slot.joint).needed_count  # 0.4 of 2.3 A hold the waist
    assert broken(servo(slot, Current_Limit=needed)) == []
    assert broken(servo(slot, Current_Limit=needed - 1)) == [judge.CURRENT_LIMIT]


@pytest.mark.parametrize(
    ("slot", "needed"), [(SHOULDER, 432), (SHADOW, 432), (ELBOW, 432), (ROTATE, 295), (WAIST, 354), (GRIPPER, 354)]
)  # of 885 counts: 4 N·m of two servos with 4.1 N·m each, 0.5 N·m of one with 1.5; 0.4 of them hold
def test_pwm_limit_of_every_servo_which_bounds_its_voltage_in_every_mode(slot, needed: int) -> None:
    assert broken(servo(slot, PWM_Limit=885)) == []
    assert broken(servo(slot, PWM_Limit=needed)) == [judge.PWM_LIMIT]
    assert broken(servo(slot, PWM_Limit=needed - 1)) == [judge.PWM_NEEDED]


@pytest.mark.parametrize(("hold", "grip", "needed"), [(0.4, 0.25, 354), (0.2, 0.5, 442), (1.0, 0.0, 885)])
def test_of_holding_and_gripping_the_harder_says_what_a_limit_must_leave(hold: float, grip: float, needed: int) -> None:
    slot = replace(GRIPPER, joint=replace(GRIPPER.joint, hold_effort=hold, grip_effort=grip))
    assert judge.PWM_NEEDED not in broken(servo(slot, PWM_Limit=needed))
    assert judge.PWM_NEEDED in broken(servo(slot, PWM_Limit=needed - 1))


@pytest.mark.parametrize(("slot", "takes_torque"), [(ELBOW, True), (WAIST, False)])
@pytest.mark.parametrize("limit", ["Current_Limit", "PWM_Limit"])
def test_a_lower_torque_is_a_remedy_for_who_takes_torque(slot, takes_torque: bool, limit: str) -> None:
    (misfit,) = judge.judge(servo(slot, **{limit: 0}))
    assert ("or lower safety.tau_max_fraction_of_stall" in misfit.said.remedy) == takes_torque


def test_direction_and_the_other_bits_of_drive_mode_are_two_rules() -> None:
    assert broken(servo(Drive_Mode=0)) == [judge.DIRECTION]
    assert broken(servo(Drive_Mode=5)) == [judge.DRIVE_BITS]
    assert broken(servo(Drive_Mode=4)) == [judge.DIRECTION, judge.DRIVE_BITS]


def test_a_shadow_may_have_a_homing_offset() -> None:
    assert broken(servo(SHADOW, Homing_Offset=-3)) == []
    assert broken(servo(Homing_Offset=-3)) == [judge.HOMING]


@pytest.mark.parametrize("register", [table.STARTUP_CONFIGURATION, table.BUS_WATCHDOG])
def test_what_a_servo_does_not_have_is_not_judged(register: Register) -> None:
    values = {name: value for name, value in servo().values.items() if name != register.name}
    assert broken(replace(servo(), values=values)) == []


def test_what_must_be_read_is_what_the_rules_ask_for_as_far_as_the_model_has_it() -> None:
    for slot in WX200.slots:
        read = {register.name for register in judge.registers(slot.model)}
        asked = {register.name for rule in judge.RULES for register in rule.registers}
        assert read == asked & slot.model.registers.keys()
        assert (table.CURRENT_LIMIT.name in read) == slot.model.has_current_mode


@pytest.mark.parametrize(
    ("slot", "register", "matters"),
    [
        (ELBOW, "Goal PWM", True), (SHADOW, "Goal PWM", True), (WAIST, "Goal PWM", True),
        (ROTATE, "Goal PWM", False), (GRIPPER, "Goal PWM", False),  # there it is a goal
        (ELBOW, "Position P Gain", False), (WAIST, "Position P Gain", True), (GRIPPER, "Position P Gain", True),
        (WAIST, "Profile Velocity", True), (GRIPPER, "Feedforward 1st Gain", True),
    ],
)  # fmt: skip
def test_what_another_program_left_in_ram_is_named_where_the_servo_s_mode_goes_by_it(
    slot, register: str, matters: bool
) -> None:
    left = {register.replace(" ", "_"): 60}
    assert [rule.name for rule in broken(servo(slot, **left))] == ([register] if matters else [])
    other = OperatingMode.VELOCITY
    assert broken(servo(slot, Operating_Mode=other, **left)) == [judge.MODE], "a change of mode sets it"
