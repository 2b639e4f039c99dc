"""A servo that boots: what reboot and power loss take, what its backup brings back, when torque comes by itself."""

from __future__ import annotations

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import Instruction, OperatingMode
from drivers.dynamixel.servo.counts import TICK_RAD
from tests.support.servos.wire_bench import MS, Bench, horn, xm430

OK, FAIL, INSTRUCTION = 0, 1, 2
KEPT = {
    table.VELOCITY_P_GAIN: 11, table.VELOCITY_I_GAIN: 12, table.POSITION_P_GAIN: 13, table.POSITION_I_GAIN: 14,
    table.POSITION_D_GAIN: 15, table.FEEDFORWARD_1ST_GAIN: 16, table.FEEDFORWARD_2ND_GAIN: 17,
    table.PROFILE_VELOCITY: 18, table.PROFILE_ACCELERATION: 19, table.INDIRECT_ADDRESSES[0]: 146,
    table.INDIRECT_ADDRESSES[55]: 132,
}  # fmt: skip
LOST = {table.LED: 1, table.BUS_WATCHDOG: 9, table.GOAL_PWM: 33, table.GOAL_CURRENT: 44}


def test_reboot_loses_ram_keeps_eeprom_and_is_silent_meanwhile() -> None:
    bench = Bench(xm430())
    bench.write(1, table.RETURN_DELAY_TIME, 3)
    bench.write(1, table.LED, 1)
    bench.write(1, table.TORQUE_ENABLE, 1)
    assert bench.one(1, Instruction.REBOOT).error == OK
    assert bench.send(1, Instruction.PING) == []
    bench.now_ns += 301 * MS
    assert bench.read(1, table.RETURN_DELAY_TIME) == 3
    assert bench.read(1, table.LED) == 0
    assert bench.read(1, table.TORQUE_ENABLE) == 0


def test_backup_restores_eeprom_with_torque_off() -> None:
    bench = Bench(xm430())
    key = b"CTRL"
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x02" + key).error == FAIL
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x01" + key).error == OK
    assert bench.read(1, table.BACKUP_READY) == 1
    bench.write(1, table.CURRENT_LIMIT, 100)
    bench.write(1, table.TORQUE_ENABLE, 1)
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x02" + key).error == FAIL
    bench.write(1, table.TORQUE_ENABLE, 0)
    bench.write(1, table.LED, 1)
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x02" + key).error == OK
    assert bench.send(1, Instruction.PING) == [], "it restarts after its answer"
    bench.now_ns += 301 * MS
    assert bench.read(1, table.CURRENT_LIMIT) == 1193
    assert bench.read(1, table.LED) == 0
    assert bench.read(1, table.BACKUP_READY) == 1, "a restart does not lose the backup"


def test_a_restore_brings_back_id_and_speed_too() -> None:
    bench = Bench(xm430(7, baud_rate=1))
    assert bench.one(7, Instruction.CONTROL_TABLE_BACKUP, b"\x01CTRL").error == OK
    assert bench.write(7, table.ID, 9) == OK
    assert bench.one(9, Instruction.CONTROL_TABLE_BACKUP, b"\x02CTRL").error == OK
    bench.now_ns += 301 * MS
    assert bench.one(7, Instruction.PING).error == OK


@pytest.mark.parametrize("how", ["reboot", "power"])
@pytest.mark.parametrize("startup", [0, 1, 2])
def test_ram_comes_back_from_the_backup_where_the_startup_configuration_says_so(startup: int, how: str) -> None:
    """The e-manual names gains, profile and indirect addresses; goals, LED and watchdog are not kept, EEPROM stays."""
    servo, restores = xm430(startup_configuration=startup), startup == 2
    bench = Bench(servo)
    for register, value in (KEPT | LOST).items():
        assert bench.write(1, register, value) == OK
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x01CTRL").error == OK
    assert bench.write(1, table.POSITION_P_GAIN, 555) == OK, "what is written after the backup is not in it"
    assert bench.write(1, table.RETURN_DELAY_TIME, 77) == OK
    if how == "reboot":
        bench.one(1, Instruction.REBOOT)
    else:
        servo.firmware.power(False, bench.now_ns)
        servo.firmware.power(True, bench.now_ns)
    bench.now_ns += 301 * MS
    for register, value in KEPT.items():
        assert bench.read(1, register) == (value if restores else register.default), register.name
    assert bench.read(1, table.LED) == bench.read(1, table.BUS_WATCHDOG) == bench.read(1, table.TORQUE_ENABLE) == 0
    assert (bench.read(1, table.GOAL_PWM), bench.read(1, table.GOAL_CURRENT)) == (885, 1193)
    assert servo.firmware.body.drive.goals.position_p == (13 if restores else 800), "the controllers have it too"
    assert bench.read(1, table.RETURN_DELAY_TIME) == 77


def test_ram_restore_without_a_backup_is_a_plain_boot() -> None:
    bench = Bench(xm430(startup_configuration=2))
    bench.write(1, table.POSITION_P_GAIN, 5)
    bench.one(1, Instruction.REBOOT)
    bench.now_ns += 301 * MS
    assert bench.read(1, table.POSITION_P_GAIN) == 800
    assert bench.read(1, table.BACKUP_READY) == 0


@pytest.mark.parametrize("startup", [0, 1, 2, 3])
def test_torque_comes_on_by_itself_where_the_startup_configuration_says_so(startup: int) -> None:
    """In current mode with the goal that a boot leaves: the whole Current Limit."""
    servo = xm430(startup_configuration=startup, operating_mode=OperatingMode.CURRENT)
    bench = Bench(servo)
    servo.firmware.power(False, bench.now_ns)
    servo.firmware.power(True, bench.now_ns)
    bench.pass_time(299)
    assert servo.firmware.body.step(1e-3, alive=servo.firmware.alive(bench.now_ns)) == 0.0
    bench.pass_time(3)
    assert bench.read(1, table.TORQUE_ENABLE) == startup & 1
    torque_Nm = servo.firmware.body.step(1e-3, alive=True)
    assert torque_Nm > 4.0 if startup & 1 else torque_Nm == 0.0
    bench.write(1, table.TORQUE_ENABLE, 0)
    bench.pass_time(20)
    assert bench.read(1, table.TORQUE_ENABLE) == 0, "it comes on once"


def test_a_servo_that_starts_in_position_mode_holds_where_its_boot_ends() -> None:
    servo = xm430(startup_configuration=1)
    bench = Bench(servo)
    bench.one(1, Instruction.REBOOT)
    bench.pass_time(200)
    horn(servo, 100 * TICK_RAD)  # it sags while it boots
    bench.pass_time(102)
    assert bench.read(1, table.TORQUE_ENABLE) == 1
    assert bench.read(1, table.GOAL_POSITION) == 2148
    assert servo.firmware.body.step(1e-3, alive=True) == 0.0


def test_second_backup_replaces_the_first() -> None:
    bench = Bench(xm430())
    for limit in (100, 200):
        bench.write(1, table.CURRENT_LIMIT, limit)
        assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x01CTRL").error == OK
    bench.write(1, table.CURRENT_LIMIT, 300)
    bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x02CTRL")
    bench.now_ns += 301 * MS
    assert bench.read(1, table.CURRENT_LIMIT) == 200


def test_older_firmware_knows_neither_backup_nor_clear() -> None:
    bench = Bench(xm430(firmware=41))
    assert bench.one(1, Instruction.CONTROL_TABLE_BACKUP, b"\x01CTRL").error == INSTRUCTION
    assert bench.one(1, Instruction.CLEAR, b"\x01\x44\x58\x4c\x22").error == INSTRUCTION


def test_power_loss_is_silence_and_a_boot() -> None:
    servo = xm430()
    bench = Bench(servo)
    bench.write(1, table.TORQUE_ENABLE, 1)
    servo.firmware.power(False, bench.now_ns)
    assert bench.send(1, Instruction.PING) == []
    servo.firmware.power(True, bench.now_ns)
    assert bench.send(1, Instruction.PING) == []
    bench.now_ns += 301 * MS
    assert bench.read(1, table.TORQUE_ENABLE) == 0
