"""EEPROM saved to a file and brought back: every register, no other write, nothing at all where it cannot be whole."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.motors import dump, eeprom
from agent.motors.eeprom import EepromError
from agent.motors.find import ALL_BAUDS, survey
from drivers.dynamixel.errors import NoReplyError
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    ID,
    MOVING_THRESHOLD,
    OPERATING_MODE,
    RETURN_DELAY_TIME,
    TORQUE_ENABLE,
    Register,
)
from sim_backend.wire.faults import FaultKind
from tests.support.control.strategies import examples
from tests.support.servos.dxl_rig import XL, XM, Rig
from tests.support.servos.tool_rig import (
    LOOKING,
    bus_of,
    codes,
    fresh,
    instructions,
    servo_rig,
    torque_is_off,
)
from tests.support.servos.tool_rig import eeprom as eeprom_of


def tell(_: str) -> None:
    pass


# --- dump and restore ------------------------------------------------------------------------------------------------

CHANGEABLE = [
    r for r in eeprom.writable(SERVOS[XL]) if r not in (ID, BAUD_RATE, OPERATING_MODE) and r.name != "Drive Mode"
]


def value_of(register: Register) -> st.SearchStrategy[int]:
    assert register.minimum is not None
    assert register.maximum is not None
    if register.name == OPERATING_MODE.name:
        return st.sampled_from([int(mode) for mode in SERVOS[XL].modes])
    return (
        st.sampled_from([0, 1, 4, 5, 8, 9])
        if register.name == "Drive Mode"
        else st.integers(register.minimum, register.maximum)
    )


def saved(rig: Rig) -> dump.Dump:
    bus = bus_of(rig)
    return dump.take(bus, "left", survey(bus, "left", [57_600, 1_000_000], tell), "2026-01-01T00:00:00+00:00")


def restore(rig: Rig, file: dump.Dump, *, mark: bool = False) -> list[dump.ServoPlan]:
    bus = bus_of(rig)
    plans = dump.plan_restore(bus, file, ALL_BAUDS, mark=mark)
    dump.apply_restore(bus, plans)
    return plans


@examples(20)
@given(st.data())
def test_restoring_brings_back_every_register_and_writes_no_other(data: st.DataObject) -> None:
    rig = servo_rig(fresh(XL, 1), fresh(XL, 2, Baud_Rate=3))
    file = dump.parse(saved(rig).toml(), "dump.toml")
    before = eeprom_of(rig)
    changed = set()
    for servo_id in (1, 2):
        for register in data.draw(st.lists(st.sampled_from(CHANGEABLE), unique=True, max_size=5)):
            value = data.draw(value_of(register))
            if value != rig.get(servo_id, register):
                changed.add((servo_id, register.address))
                rig.put(servo_id, register, value)
    rig.port.writes.clear()
    restore(rig, file, mark=True)
    assert eeprom_of(rig) == before
    assert torque_is_off(rig)
    written = [(packet[0], packet[4]) for packet in instructions(rig) if packet[3] not in LOOKING]
    assert sorted(written) == sorted(changed)


def test_the_mark_of_an_arm_is_left_and_told_unless_it_is_asked_for() -> None:
    rig = servo_rig(fresh(XM, 4))
    file = saved(rig)
    rig.put(4, MOVING_THRESHOLD, 2)
    rig.put(4, RETURN_DELAY_TIME, 3)
    (plan,) = restore(rig, file)
    assert [c.line for c in plan.left] == ["servo 4: Moving Threshold: found 2, wanted 10"]
    assert [rig.get(4, r) for r in (MOVING_THRESHOLD, RETURN_DELAY_TIME)] == [2, 250]
    (plan,) = restore(rig, file, mark=True)
    assert plan.left == ()
    assert rig.get(4, MOVING_THRESHOLD) == 10


def test_a_servo_set_to_another_speed_is_found_and_brought_back() -> None:
    rig = servo_rig(fresh(XM, 4, Baud_Rate=3))
    file = saved(rig)
    rig.put(4, BAUD_RATE, 5)
    (plan,) = restore(rig, file)
    assert plan.baud == 3_000_000
    assert rig.get(4, BAUD_RATE) == 3


def test_the_dry_run_writes_nothing() -> None:
    rig = servo_rig(fresh(XM, 4))
    file = saved(rig)
    rig.put(4, RETURN_DELAY_TIME, 3)
    rig.port.writes.clear()
    (plan,) = dump.plan_restore(bus_of(rig), file, ALL_BAUDS)
    assert [c.line for c in plan.changes] == ["servo 4: Return Delay Time: found 3, wanted 250"]
    assert codes(rig) <= LOOKING


def test_a_missing_servo_is_told_and_the_others_are_restored() -> None:
    rig = servo_rig(fresh(XM, 4), fresh(XM, 5))
    file = saved(rig)
    rig.put(5, RETURN_DELAY_TIME, 3)
    rig.fault(FaultKind.SILENT, 4)
    plans = restore(rig, file)
    assert [(p.servo.id, p.baud) for p in plans] == [(4, None), (5, 57_600)]
    assert rig.get(5, RETURN_DELAY_TIME) == 250


def test_another_model_is_refused_before_any_servo_is_written_to() -> None:
    file = saved(servo_rig(fresh(XM, 4), fresh(XM, 5)))
    rig = servo_rig(fresh(XM, 4, Return_Delay_Time=9), fresh(XL, 5))
    with pytest.raises(dump.RestoreError, match="servo 5: model: found XL430-W250, expected XM430-W350 as in the file"):
        restore(rig, file)
    assert codes(rig) <= LOOKING


def test_torque_on_anywhere_refuses_the_whole_restore() -> None:
    rig = servo_rig(fresh(XM, 4), fresh(XM, 5))
    file = saved(rig)
    rig.put(4, RETURN_DELAY_TIME, 3)
    rig.put(5, TORQUE_ENABLE, 1)
    rig.port.writes.clear()
    with pytest.raises(EepromError, match="servo 5: torque: found on, expected off"):
        restore(rig, file)
    assert codes(rig) <= LOOKING
    assert rig.get(4, RETURN_DELAY_TIME) == 3


def test_registers_that_an_older_firmware_lacks_are_left_out_and_named() -> None:
    file = saved(servo_rig(fresh(XM, 4)))
    rig = servo_rig(fresh(XM, 4, firmware=44, Return_Delay_Time=9))
    (plan,) = restore(rig, file)
    assert plan.absent == ("Startup Configuration",)
    assert rig.get(4, RETURN_DELAY_TIME) == 250
    assert "Startup Configuration" not in saved(rig).servos[0].registers


def test_a_shared_id_can_be_neither_saved_nor_restored() -> None:
    file = saved(servo_rig(fresh(XM, 4)))
    rig = servo_rig(fresh(XM, 4), fresh(XM, 4))
    with pytest.raises(dump.RestoreError, match="more than one servo has this ID"):
        saved(rig)
    with pytest.raises(NoReplyError, match="damaged packets"):
        restore(rig, file)


def test_an_empty_line_has_nothing_to_save() -> None:
    with pytest.raises(dump.RestoreError, match="servos on left: found none"):
        saved(servo_rig())


SAMPLE = saved(servo_rig(fresh(XM, 4))).toml().decode()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("format = 1", "format = 2", r"format in dump.toml: found 2, expected 1"),
        ('model = "XM430-W350"', 'model = "XM430"', r"expected a known model with its own number"),
        ("model_number = 1020", "model_number = 1060", r"expected a known model with its own number"),
        ("baud = 57600", "baud = 57601", r"expected a baud rate that servos know \(servo 4: 57601\)"),
        ("baud = 57600", "baud = 1000000", r"expected ID and Baud Rate registers that agree"),
        (
            '"Homing Offset" = 0',
            '"Homing Offse" = 0',
            r"EEPROM registers of a XM430-W350 only \(servo 4: Homing Offse\)",
        ),
        ('"Homing Offset" = 0', '"Torque Enable" = 1', r"EEPROM registers of a XM430-W350 only"),
        ('"Return Delay Time" = 250', '"Return Delay Time" = 256', r"Return Delay Time from 0 to 255"),
        ("firmware = 46", "firmware = 46\nextra = 1", r"servos.0.extra in dump.toml"),
        ("format = 1", "format = ", r"expected TOML"),
        ("format = 1", "format = " + "9" * 5000, r"expected TOML"),
        ("format = 1", "format = " + "[" * 5000, r"expected TOML"),
    ],
)
def test_a_file_that_no_servo_can_hold_is_refused_naming_the_place(old: str, new: str, match: str) -> None:
    assert SAMPLE.count(old) == 1
    with pytest.raises(dump.DumpFileError, match=match):
        dump.parse(SAMPLE.replace(old, new).encode(), "dump.toml")


def test_a_pipe_in_the_place_of_a_dump_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(dump.DumpFileError, match="found no regular file, expected a dump; "):
        dump.load(tmp_path / "pipe")


def test_a_value_that_only_the_servo_would_refuse_is_refused_before_anything_is_written() -> None:
    rig = servo_rig(fresh(XM, 4, Return_Delay_Time=9))
    file = dump.parse(SAMPLE.replace('"Min Voltage Limit" = 95', '"Min Voltage Limit" = 20').encode(), "dump.toml")
    with pytest.raises(dump.RestoreError, match="Min Voltage Limit in the file: found 20, expected 95 to 160"):
        restore(rig, file)
    assert codes(rig) <= LOOKING


def test_a_value_the_manual_does_not_know_can_be_saved() -> None:
    rig = servo_rig(fresh(XM, 4))
    rig.servo(4).firmware.memory.put(SERVOS[XM].registers["Min Voltage Limit"], 20)
    file = dump.parse(saved(rig).toml(), "dump.toml")
    assert file.servos[0].registers["Min Voltage Limit"] == 20
    assert restore(rig, file)[0].changes == ()


def test_operating_mode_is_part_of_a_dump() -> None:
    rig = servo_rig(fresh(XM, 4))
    file = saved(rig)
    rig.put(4, OPERATING_MODE, int(OperatingMode.CURRENT))
    restore(rig, file)
    assert rig.get(4, OPERATING_MODE) == OperatingMode.POSITION
