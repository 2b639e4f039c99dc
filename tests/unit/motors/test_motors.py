"""Servos found, set up, saved, restored: only what differs is written, in an order that survives a cut, torque off."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import configs
from agent.config.cell import load_cell
from agent.config.files import load_arm_file
from agent.config.servo_map import arm_map, resting_joints
from agent.motors import eeprom
from agent.motors.eeprom import EepromError
from agent.motors.find import ALL_BAUDS, BaudError, refuse_unknown_bauds, survey
from agent.motors.setup import JointError, SetupError, apply_setup, plan_setup, servo_of
from agent.verify.check import start_configurations
from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.errors import PortLostError
from drivers.dynamixel.servo.codes import BAUD_RATES
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.judge import MODE, judge
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    HARDWARE_ERROR_STATUS,
    HOMING_OFFSET,
    ID,
    MAX_POSITION_LIMIT,
    MIN_POSITION_LIMIT,
    PRESENT_POSITION,
    TORQUE_ENABLE,
)
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring
from tests.support.control.strategies import examples
from tests.support.servos.dxl_rig import WX200, XL, XM, Rig
from tests.support.servos.tool_rig import (
    LOOKING,
    arm_rig,
    bus_of,
    codes,
    examined,
    fresh,
    lines,
    servo_rig,
    torque_is_off,
    written_registers,
)
from tests.support.servos.tool_rig import eeprom as eeprom_of

MODELS = sorted(path.stem for path in configs.ARMS_DIR.glob("*.toml"))
QUICK = ("widowx_mk2",)  # the other make of servos; `make long` has all
WX200_FILE, _ = load_arm_file("wx200", "test")


def tell(_: str) -> None:
    pass


def places(model: str) -> list[tuple[str, bool]]:
    """Every servo of an arm: (joint, is the shadow)."""
    file, _ = load_arm_file(model, "test")
    return [(joint.name, bool(place)) for joint in resting_joints(file) for place in range(len(joint.ids))]


def set_up(rig: Rig, model: str, joint: str, shadow: bool):
    file, _ = load_arm_file(model, "test")
    bus = bus_of(rig)
    plan = plan_setup(bus, servo_of(file, joint, shadow=shadow), file.baud, tell)
    apply_setup(bus, plan, file.baud)
    return plan


def broken_rules(slot: ServoSlot, values: dict[str, int]) -> set[str]:
    """Rules about its EEPROM that a servo breaks; the mode is the driver's to set."""
    servo = ServoFound(slot, slot.model.model_number, 46, values)
    return {misfit.rule.name for misfit in judge(servo)}


# --- scan ------------------------------------------------------------------------------------------------------------


def test_servos_are_found_at_their_speeds_with_how_they_are() -> None:
    rig = servo_rig(fresh(XM, 7, Baud_Rate=3), fresh(XL, 1), fresh(XM, 252, firmware=44, Baud_Rate=5))
    rig.put(7, HARDWARE_ERROR_STATUS, 0x20)
    seen = survey(bus_of(rig), "left", ALL_BAUDS, tell)
    assert [(s.baud, s.servo_id, s.model_name, s.firmware) for s in seen] == [
        (57_600, 1, XL, 46), (1_000_000, 7, XM, 46), (3_000_000, 252, XM, 44),
    ]  # fmt: skip
    assert [s.hardware_text for s in seen] == ["none", "OVERLOAD", "none"]
    assert all(s.voltage_V == pytest.approx(12.0) and s.temperature_C == 25 and s.torque_on is False for s in seen)
    assert all(s.position_tick is not None for s in seen)
    assert seen[1].position_tick == rig.get(7, PRESENT_POSITION)
    assert codes(rig) <= LOOKING


def test_a_shared_id_is_named_and_the_others_are_still_found() -> None:
    rig = servo_rig(fresh(XM, 3), fresh(XM, 5), fresh(XL, 5), fresh(XM, 6))
    seen = survey(bus_of(rig), "left", [57_600], tell)
    assert [s.servo_id for s in seen] == [3, 5, 6]
    assert [s.note for s in seen] == ["", "more than one servo has this ID", ""]


def test_only_the_speeds_asked_for_are_looked_at() -> None:
    rig = servo_rig(fresh(XM, 7, Baud_Rate=3), fresh(XL, 1))
    assert [s.servo_id for s in survey(bus_of(rig), "left", [1_000_000], tell)] == [7]
    assert survey(bus_of(rig), "left", [9_600], tell) == []


def test_a_speed_that_no_servo_knows_is_refused() -> None:
    with pytest.raises(BaudError, match="found 1000, expected 9600, 57600"):
        refuse_unknown_bauds([57_600, 1_000])


def test_a_servo_that_answers_pings_only_is_listed_with_the_reason() -> None:
    rig = servo_rig(fresh(XM, 3))
    rig.servo(3).firmware.memory.bytes[68] = 0  # Status Return Level
    (servo,) = survey(bus_of(rig), "left", [57_600], tell)
    assert servo.note.startswith("reads: nothing")
    assert servo.voltage_V is None


# --- setup -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "model", [*QUICK, *(pytest.param(model, marks=pytest.mark.long) for model in MODELS if model not in QUICK)]
)
def test_every_servo_of_every_arm_can_be_set_up_from_the_factory(model: str) -> None:
    file, _ = load_arm_file(model, "test")
    for joint, shadow in places(model):
        slot = servo_of(file, joint, shadow=shadow)
        rig = servo_rig(fresh(slot.joint.servo))
        plan = set_up(rig, model, joint, shadow)
        assert torque_is_off(rig)
        assert set(written_registers(rig)) == {c.register.address for c in plan.changes}
        (servo_id,) = eeprom_of(rig)
        assert servo_id == slot.servo_id
        assert broken_rules(slot, eeprom_of(rig)[servo_id]) <= {MODE.name}
        assert rig.get(servo_id, BAUD_RATE) == next(code for code, baud in BAUD_RATES.items() if baud == file.baud)


def test_an_arm_set_up_servo_by_servo_is_one_that_the_driver_takes() -> None:
    """The tool's idea of an arm and the driver's are the same."""
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml")
    arm = cell.arms[0]
    q = start_configurations(cell, [cell.model(a) for a in cell.arms])[0]
    servos = arm_map(cell, arm, "virtual", q)
    wired = []
    for joint in resting_joints(arm.file):
        of_joint = []
        for place, reverse in enumerate(joint.reverse):
            rig = servo_rig(fresh(joint.servo))
            set_up(rig, "wx200", joint.name, bool(place))
            ((servo_id, values),) = eeprom_of(rig).items()
            of_joint.append(ServoWiring(servo_id, joint.servo, reverse, joint.zero_tick, eeprom=values))
        start = next(j.start_rad for j in servos.joints if j.name == joint.name) or 0.0
        wired.append(JointWiring(joint.name, tuple(of_joint), None, start))
    rig = arm_rig(servos, ArmWiring(servos.arm, tuple(wired), servos.baud))
    assert list(lines(examined(rig))) == []
    rig.driver.connect()
    rig.driver.enable()
    rig.driver.read()
    rig.driver.disable()


@settings(examples(12), suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_a_setup_that_was_cut_anywhere_is_completed_by_the_next(data: st.DataObject) -> None:
    """Power or cable may go after any packet; nothing but running the same command again is needed."""
    joint, shadow = data.draw(st.sampled_from(places("wx200")))
    slot = servo_of(WX200_FILE, joint, shadow=shadow)
    rig = servo_rig(fresh(slot.joint.servo, data.draw(st.integers(0, 252)), Baud_Rate=data.draw(st.integers(0, 7))))
    bus = bus_of(rig)
    plan = plan_setup(bus, slot, WX200_FILE.baud, tell)
    rig.port.lose_after(data.draw(st.integers(0, 4 * len(plan.changes))))
    try:
        apply_setup(bus, plan, WX200_FILE.baud)
    except PortLostError:
        rig.port.lost = False
    rig.port.lose_after(None)
    set_up(rig, "wx200", joint, shadow)
    (servo_id,) = eeprom_of(rig)
    assert servo_id == slot.servo_id
    assert broken_rules(slot, eeprom_of(rig)[servo_id]) <= {MODE.name}
    assert torque_is_off(rig)


def test_a_servo_that_is_set_up_is_left_alone() -> None:
    rig = servo_rig(fresh(XM))
    set_up(rig, "wx200", "elbow", False)
    rig.port.writes.clear()
    assert set_up(rig, "wx200", "elbow", False).changes == ()
    assert codes(rig) <= LOOKING


def test_a_shadow_keeps_its_homing_offset_and_no_other_servo_does() -> None:
    for shadow, kept in ((True, 11), (False, 0)):
        rig = servo_rig(fresh(XM, Homing_Offset=11))
        set_up(rig, "wx200", "shoulder", shadow)
        assert rig.get(3 if shadow else 2, HOMING_OFFSET) == kept


@pytest.mark.parametrize(
    ("servos", "match"),
    [
        ((), r"found none that answers, at any speed, expected exactly one servo; switch on its 12 V"),
        ((fresh(XM, 1), fresh(XM, 2, Baud_Rate=3)), "found ID 2 at 1000000 bit/s, ID 1 at 57600 bit/s"),
        ((fresh(XM, 1), fresh(XL, 1)), "found replies that destroy each other at 57600 bit/s"),
        ((fresh(XL, 1),), "servo 1 as elbow: model: found XL430-W250, expected XM430-W350"),
        ((fresh(XM, 1, firmware=37),), "servo 1 as elbow: firmware: found 37, expected 38 or newer"),
    ],
    ids=["none", "two", "shared ID", "model", "firmware"],
)
def test_what_cannot_be_set_up_is_refused_and_not_written_to(servos: Sequence[ServoWiring], match: str) -> None:
    rig = servo_rig(*servos)
    before = eeprom_of(rig)
    with pytest.raises(SetupError, match=match):
        set_up(rig, "wx200", "elbow", False)
    assert codes(rig) <= LOOKING
    assert eeprom_of(rig) == before


def test_a_servo_with_torque_on_is_refused_and_keeps_it() -> None:
    rig = servo_rig(fresh(XM))
    rig.put(1, TORQUE_ENABLE, 1)
    with pytest.raises(EepromError, match="servo 1: torque: found on, expected off"):
        set_up(rig, "wx200", "elbow", False)
    assert rig.get(1, TORQUE_ENABLE) == 1
    assert codes(rig) <= LOOKING


def test_a_joint_or_shadow_that_is_not_there_is_refused_naming_those_that_are() -> None:
    with pytest.raises(JointError, match="found 'elbov', expected waist or shoulder or elbow"):
        servo_of(WX200_FILE, "elbov", shadow=False)
    with pytest.raises(JointError, match="found a single servo, expected one with a shadow: shoulder"):
        servo_of(WX200_FILE, "elbow", shadow=True)
    mk2, _ = load_arm_file("widowx_mk2", "test")
    with pytest.raises(
        JointError, match=r"found servo AX-12A of Protocol 1\.0, .* waist or shoulder or elbow or wrist_angle;"
    ):
        servo_of(mk2, "gripper", shadow=False)
    with pytest.raises(JointError, match=r"joint wrist_rotate of .*AX-12A of Protocol 1\.0"):
        servo_of(mk2, "wrist_rotate", shadow=False)
    with pytest.raises(JointError, match="found 'griper', expected waist"):
        servo_of(mk2, "griper", shadow=False)


# --- order of writes -------------------------------------------------------------------------------------------------

TICKS = st.integers(0, 4095)
RANGE = st.tuples(TICKS, TICKS).filter(lambda pair: pair[0] < pair[1])


@given(RANGE, RANGE)
def test_no_lower_limit_is_ever_above_its_upper_one_on_the_way(found: tuple[int, int], wanted: tuple[int, int]) -> None:
    names = (MIN_POSITION_LIMIT.name, MAX_POSITION_LIMIT.name)
    now = dict(zip(names, found, strict=True))
    changes = eeprom.differences(1, SERVOS[XM], now, dict(zip(names, wanted, strict=True)))
    for change in changes:
        now[change.register.name] = change.wanted
        assert now[names[0]] < now[names[1]]
    assert now == dict(zip(names, wanted, strict=True))


def test_id_and_speed_come_last_so_that_the_servo_can_be_found_until_then() -> None:
    model = SERVOS[XM]
    values = {r.name: r.default or 0 for r in eeprom.writable(model)}
    changes = eeprom.differences(1, model, values, {name: value + 1 for name, value in values.items()})
    assert [c.register.name for c in changes[-2:]] == [ID.name, BAUD_RATE.name]
    assert len(changes) == len(values)


def test_every_speed_is_looked_at_once() -> None:
    assert sorted(ALL_BAUDS) == sorted(BAUD_RATES.values())
    assert all(a != b for a, b in itertools.pairwise(ALL_BAUDS))
    assert WX200.baud == ALL_BAUDS[0]  # the most probable first
