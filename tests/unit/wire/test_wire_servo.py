"""Rules of the control table of one servo, each as the e-manual states it."""

from __future__ import annotations

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import BAUD_RATES, HardwareError, Instruction, OperatingMode
from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.options import GoalAtTorqueOn, ServoOptions
from sim_backend.wire.servo import Servo
from tests.support.servos.wire_bench import MS, Bench, word, xl430, xm430

OK, FAIL, INSTRUCTION, RANGE, LENGTH, LIMIT, ACCESS = 0, 1, 2, 4, 5, 6, 7
ALERT = 0x80


def horn(servo: Servo, position_rad: float = 0.0, velocity_rad_per_s: float = 0.0) -> None:
    body = servo.firmware.body
    body.horn.position_rad, body.horn.velocity_rad_per_s = position_rad, velocity_rad_per_s


def in_mode(mode: OperatingMode, servo: Servo | None = None) -> Bench:
    bench = Bench(servo or xm430())
    assert bench.write(1, table.OPERATING_MODE, mode) == OK
    return bench


def test_ping_tells_model_and_firmware() -> None:
    answer = Bench(xm430(firmware=44)).one(1, Instruction.PING)
    assert (int.from_bytes(answer.data[:2], "little"), answer.data[2]) == (1020, 44)


def test_factory_values_are_those_of_the_table() -> None:
    bench = Bench(xm430())
    for register in SERVOS["XM430-W350"].registers.values():
        if register.default is not None and register.address < 64:
            assert bench.read(1, register) == register.default, register.name


def test_eeprom_is_locked_while_torque_is_on() -> None:
    bench = Bench(xm430())
    assert bench.write(1, table.RETURN_DELAY_TIME, 0) == OK
    assert bench.write(1, table.TORQUE_ENABLE, 1) == OK
    assert bench.write(1, table.RETURN_DELAY_TIME, 10) == ACCESS
    assert bench.read(1, table.RETURN_DELAY_TIME) == 0
    assert bench.write(1, table.LED, 1) == OK


@pytest.mark.parametrize("register", [table.MODEL_NUMBER, table.PRESENT_POSITION, table.HARDWARE_ERROR_STATUS])
def test_read_only_registers_refuse_writes(register: table.Register) -> None:
    assert Bench(xm430()).write(1, register, 1) == ACCESS


def test_undefined_addresses_refuse_reads_and_writes() -> None:
    bench = Bench(xl430())
    assert bench.one(1, Instruction.READ, word(102) + word(2)).error == ACCESS
    assert bench.one(1, Instruction.WRITE, word(102) + b"\0\0").error == ACCESS
    assert bench.one(1, Instruction.READ, word(660) + word(2)).error == OK
    assert bench.one(1, Instruction.READ, word(660) + word(3)).error == ACCESS
    assert bench.one(1, Instruction.WRITE, word(100) + bytes(4)).error == ACCESS, "100 to 103 in one write"


def test_part_of_a_register_cannot_be_written() -> None:
    bench = Bench(xm430())
    assert bench.one(1, Instruction.WRITE, word(116) + b"\0\0").error == LENGTH
    assert bench.one(1, Instruction.WRITE, word(118) + b"\0\0").error == LENGTH


def test_adjoining_registers_are_written_together_or_not_at_all() -> None:
    bench = in_mode(OperatingMode.CURRENT)
    assert bench.one(1, Instruction.WRITE, word(100) + word(100) + word(50)).error == OK
    assert (bench.read(1, table.GOAL_PWM), bench.read(1, table.GOAL_CURRENT)) == (100, 50)
    assert bench.one(1, Instruction.WRITE, word(100) + word(7) + word(2000)).error == RANGE
    assert bench.read(1, table.GOAL_PWM) == 100


def test_values_outside_the_range_are_refused() -> None:
    bench = Bench(xm430())
    assert bench.write(1, table.ID, 253) == RANGE
    assert bench.write(1, table.TORQUE_ENABLE, 2) == RANGE
    assert bench.write(1, table.SHUTDOWN, 0x02) == RANGE
    assert bench.write(1, table.OPERATING_MODE, 2) == RANGE


def test_goals_beyond_the_limits_in_eeprom_are_refused() -> None:
    bench = Bench(xm430(current_limit=500, pwm_limit=400, velocity_limit=131, max_position_limit=3000))
    assert bench.write(1, table.GOAL_CURRENT, 501) == LIMIT
    assert bench.write(1, table.GOAL_CURRENT, -501) == LIMIT
    assert bench.write(1, table.GOAL_PWM, 401) == LIMIT
    assert bench.write(1, table.GOAL_VELOCITY, 132) == LIMIT
    assert bench.write(1, table.GOAL_POSITION, 3001) == LIMIT
    assert bench.write(1, table.GOAL_CURRENT, -500) == OK


def test_position_limits_bind_in_position_mode_only() -> None:
    bench = in_mode(OperatingMode.EXTENDED_POSITION, xm430(max_position_limit=3000))
    assert bench.write(1, table.GOAL_POSITION, 100_000) == OK
    assert bench.write(1, table.GOAL_POSITION, 1_048_576) == RANGE


@pytest.mark.parametrize("mode", [OperatingMode.CURRENT, OperatingMode.CURRENT_BASED_POSITION])
def test_servo_without_current_sensor_refuses_current_modes(mode: OperatingMode) -> None:
    assert Bench(xl430()).write(1, table.OPERATING_MODE, mode) == RANGE


def test_mode_change_sets_goals_to_their_limits() -> None:
    bench = Bench(xm430(current_limit=700, pwm_limit=600))
    for register, value in ((table.GOAL_CURRENT, 0), (table.GOAL_PWM, 0), (table.PROFILE_VELOCITY, 50)):
        assert bench.write(1, register, value) == OK
    assert bench.write(1, table.POSITION_P_GAIN, 100) == OK
    assert bench.write(1, table.OPERATING_MODE, OperatingMode.CURRENT) == OK
    assert bench.read(1, table.GOAL_CURRENT) == 700
    assert bench.read(1, table.GOAL_PWM) == 600
    assert bench.read(1, table.PROFILE_VELOCITY) == 0
    assert bench.read(1, table.POSITION_P_GAIN) == 800


def test_torque_on_in_current_mode_without_zeroing_the_goal_gives_full_current() -> None:
    servo = xm430()
    bench = in_mode(OperatingMode.CURRENT, servo)
    bench.write(1, table.TORQUE_ENABLE, 1)
    servo.firmware.body.horn.supply_V = 14.0
    assert servo.firmware.body.step(1e-3, alive=True) > 4.0


def test_position_is_centred_and_quantised() -> None:
    servo = xm430()
    bench = Bench(servo)
    assert bench.read(1, table.PRESENT_POSITION) == 2048
    horn(servo, 100.4 * TICK_RAD, 10.4 * VELOCITY_UNIT_RAD_PER_S)
    assert bench.read(1, table.PRESENT_POSITION) == 2148
    assert bench.read(1, table.PRESENT_VELOCITY) == 10


def test_reverse_mode_mirrors_position_velocity_and_torque() -> None:
    servo = xm430(drive_mode=1)
    bench = in_mode(OperatingMode.CURRENT, servo)
    horn(servo, 100 * TICK_RAD, 10 * VELOCITY_UNIT_RAD_PER_S)
    assert bench.read(1, table.PRESENT_POSITION) == 1948
    assert bench.read(1, table.PRESENT_VELOCITY) == -10
    bench.write(1, table.GOAL_CURRENT, 100)
    bench.write(1, table.TORQUE_ENABLE, 1)
    assert servo.firmware.body.step(1e-3, alive=True) < -0.4
    assert bench.read(1, table.PRESENT_CURRENT) == 100


def test_homing_offset_is_added_and_not_mirrored_by_reverse_mode() -> None:
    bench = Bench(xm430(drive_mode=1, homing_offset=300))
    assert bench.read(1, table.PRESENT_POSITION) == 2048 + 300


def test_homing_offset_beyond_1024_counts_in_extended_mode_only() -> None:
    bench = Bench(xm430(homing_offset=5000))
    assert bench.read(1, table.PRESENT_POSITION) == 2048
    bench.write(1, table.OPERATING_MODE, OperatingMode.EXTENDED_POSITION)
    assert bench.read(1, table.PRESENT_POSITION) == 2048 + 5000


def test_position_counts_turns_until_torque_comes_on_in_position_mode() -> None:
    servo = xm430()
    bench = Bench(servo)
    horn(servo, 5000 * TICK_RAD)
    assert bench.read(1, table.PRESENT_POSITION) == 7048
    bench.write(1, table.TORQUE_ENABLE, 1)
    assert bench.read(1, table.PRESENT_POSITION) == 7048 - 4096
    bench.write(1, table.TORQUE_ENABLE, 0)
    bench.write(1, table.OPERATING_MODE, OperatingMode.CURRENT)
    horn(servo, -5000 * TICK_RAD)
    bench.write(1, table.TORQUE_ENABLE, 1)
    assert bench.read(1, table.PRESENT_POSITION) == 7048 - 4096 - 10_000


def test_status_return_level_silences_in_steps() -> None:
    bench = Bench(xm430())
    assert bench.write(1, table.STATUS_RETURN_LEVEL, 1) == OK
    assert bench.send(1, Instruction.WRITE, word(65) + b"\1") == []
    assert bench.read(1, table.LED) == 1
    assert bench.send(1, Instruction.WRITE, word(68) + b"\0") == []
    assert bench.send(1, Instruction.READ, word(65) + word(1)) == []
    assert bench.one(1, Instruction.PING).error == OK


def test_hardware_error_in_the_shutdown_mask_takes_torque_until_reboot() -> None:
    servo = xm430()
    bench = Bench(servo)
    bench.write(1, table.TORQUE_ENABLE, 1)
    servo.firmware.raise_error(HardwareError.OVERLOAD)
    assert bench.one(1, Instruction.PING).error == ALERT
    assert bench.read(1, table.TORQUE_ENABLE) == 0
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERLOAD
    assert bench.write(1, table.TORQUE_ENABLE, 1) == ALERT
    assert bench.read(1, table.TORQUE_ENABLE) == 0
    bench.one(1, Instruction.REBOOT)
    bench.now_ns += 301 * MS
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == 0
    assert bench.write(1, table.TORQUE_ENABLE, 1) == OK


def test_hardware_error_outside_the_shutdown_mask_only_alerts() -> None:
    servo = xm430()
    bench = Bench(servo)
    bench.write(1, table.TORQUE_ENABLE, 1)
    servo.firmware.body.horn.supply_V = 8.0
    bench.pass_time(2)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.INPUT_VOLTAGE
    assert bench.one(1, Instruction.PING).error == ALERT
    assert bench.read(1, table.TORQUE_ENABLE) == 1


def test_heat_above_the_limit_shuts_down() -> None:
    servo = xm430()
    bench = Bench(servo)
    bench.write(1, table.TORQUE_ENABLE, 1)
    servo.firmware.body.motor.temperature_C = 80.5
    bench.pass_time(1)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERHEATING
    assert bench.read(1, table.TORQUE_ENABLE) == 0


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


def test_reg_write_waits_for_action() -> None:
    bench = Bench(xm430())
    assert bench.one(1, Instruction.REG_WRITE, word(65) + b"\1").error == OK
    assert (bench.read(1, table.LED), bench.read(1, table.REGISTERED_INSTRUCTION)) == (0, 1)
    assert bench.one(1, Instruction.ACTION).error == OK
    assert (bench.read(1, table.LED), bench.read(1, table.REGISTERED_INSTRUCTION)) == (1, 0)
    assert bench.one(1, Instruction.ACTION).error == INSTRUCTION


@pytest.mark.parametrize(
    ("option", "servo_id", "baud_code"), [(0xFF, 1, 1), (0x01, 7, 1), (0x02, 7, 3)], ids=["all", "id", "id+baud"]
)
def test_factory_reset_keeps_what_its_option_says(option: int, servo_id: int, baud_code: int) -> None:
    bench = Bench(xm430(7, baud_rate=3, return_delay_time=0))
    bench.baud = 1_000_000
    assert bench.one(7, Instruction.FACTORY_RESET, bytes((option,))).error == OK
    bench.now_ns += 301 * MS
    bench.baud = BAUD_RATES[baud_code]
    assert bench.read(servo_id, table.RETURN_DELAY_TIME) == 250
    assert bench.read(servo_id, table.BAUD_RATE) == baud_code


def test_broadcast_reset_of_everything_is_ignored_by_newer_firmware() -> None:
    bench = Bench(xm430(7), xm430(8, firmware=41))
    assert bench.send(0xFE, Instruction.FACTORY_RESET, b"\xff") == []
    bench.now_ns += 301 * MS
    assert [servo.id for servo in bench.bus.servos] == [7, 1]


def test_clear_brings_the_position_into_one_turn_only_at_rest() -> None:
    servo = xm430()
    bench = in_mode(OperatingMode.EXTENDED_POSITION, servo)
    horn(servo, 5000 * TICK_RAD, 1.0)
    assert bench.one(1, Instruction.CLEAR, b"\x01\x44\x58\x4c\x22").error == FAIL
    horn(servo, 5000 * TICK_RAD)
    assert bench.one(1, Instruction.CLEAR, b"\x01\x44\x58\x4c\x23").error == RANGE
    assert bench.one(1, Instruction.CLEAR, b"\x01\x44\x58\x4c\x22").error == OK
    assert bench.read(1, table.PRESENT_POSITION) == 7048 - 4096


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


KEPT = {
    table.VELOCITY_P_GAIN: 11, table.VELOCITY_I_GAIN: 12, table.POSITION_P_GAIN: 13, table.POSITION_I_GAIN: 14,
    table.POSITION_D_GAIN: 15, table.FEEDFORWARD_1ST_GAIN: 16, table.FEEDFORWARD_2ND_GAIN: 17,
    table.PROFILE_VELOCITY: 18, table.PROFILE_ACCELERATION: 19, table.INDIRECT_ADDRESSES[0]: 146,
    table.INDIRECT_ADDRESSES[55]: 132,
}  # fmt: skip
LOST = {table.LED: 1, table.BUS_WATCHDOG: 9, table.GOAL_PWM: 33, table.GOAL_CURRENT: 44}


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


def test_registers_younger_than_the_firmware_are_undefined() -> None:
    bench = Bench(xm430(firmware=37))
    assert bench.one(1, Instruction.READ, word(98) + word(1)).error == ACCESS
    assert bench.one(1, Instruction.READ, word(10) + word(1)).error == ACCESS
    assert bench.read(1, table.PRESENT_POSITION) == 2048
    assert Bench(xm430(firmware=44)).one(1, Instruction.READ, word(147) + word(1)).error == ACCESS
    assert Bench(xm430(firmware=45)).one(1, Instruction.READ, word(147) + word(1)).error == OK
    assert Bench(xm430(firmware=41)).write(1, table.DRIVE_MODE, 4) == RANGE
    assert Bench(xm430(firmware=42)).write(1, table.DRIVE_MODE, 4) == OK


def test_unknown_instruction_is_refused() -> None:
    assert Bench(xm430()).one(1, 0x0F).error == INSTRUCTION


def test_realtime_tick_counts_milliseconds_and_wraps() -> None:
    bench = Bench(xm430())
    bench.now_ns = 32_767 * MS
    assert bench.read(1, table.REALTIME_TICK) == 32_767
    bench.now_ns += MS
    assert bench.read(1, table.REALTIME_TICK) == 0


def test_moving_is_set_above_the_threshold() -> None:
    servo = xm430()
    bench = Bench(servo)
    horn(servo, 0.0, 9 * VELOCITY_UNIT_RAD_PER_S)
    assert bench.read(1, table.MOVING) == 0
    horn(servo, 0.0, -11 * VELOCITY_UNIT_RAD_PER_S)
    assert bench.read(1, table.MOVING) == 1


def test_goal_at_torque_on_is_a_switch() -> None:
    for choice, expected in ((GoalAtTorqueOn.PRESENT, 2048), (GoalAtTorqueOn.KEPT, 1000)):
        bench = Bench(xm430(options=ServoOptions(goal_at_torque_on=choice)))
        bench.write(1, table.GOAL_POSITION, 1000)
        bench.write(1, table.TORQUE_ENABLE, 1)
        assert bench.read(1, table.GOAL_POSITION) == expected


def test_torque_on_by_goal_update() -> None:
    bench = Bench(xm430(drive_mode=8))
    assert bench.write(1, table.GOAL_POSITION, 1000) == OK
    assert bench.read(1, table.TORQUE_ENABLE) == 1
    assert bench.read(1, table.GOAL_POSITION) == 1000


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


class TestIndirect:
    def test_mapped_led_is_written_and_read_through_indirect_data(self) -> None:
        bench = Bench(xm430())
        assert bench.write(1, table.INDIRECT_ADDRESSES[0], 65) == OK
        assert bench.write(1, table.INDIRECT_DATA[0], 1) == OK
        assert bench.read(1, table.LED) == 1
        assert bench.write(1, table.INDIRECT_DATA[0], 2) == RANGE

    def test_four_byte_register_needs_its_four_addresses(self) -> None:
        bench = Bench(xm430())
        for offset in range(3):
            bench.write(1, table.INDIRECT_ADDRESSES[1 + offset], 116 + offset)
        goal = (1024).to_bytes(4, "little")
        start = word(table.INDIRECT_DATA[1].address)
        assert bench.one(1, Instruction.WRITE, start + goal).error == LENGTH
        bench.write(1, table.INDIRECT_ADDRESSES[4], 119)
        assert bench.one(1, Instruction.WRITE, start + goal).error == OK
        assert bench.read(1, table.GOAL_POSITION) == 1024

    def test_scattered_present_values_are_read_in_one_go(self) -> None:
        servo = xm430()
        bench = Bench(servo)
        for place, address in enumerate((146, 132, 133, 134, 135)):
            bench.write(1, table.INDIRECT_ADDRESSES[28 + place], address)
        horn(servo, 52 * TICK_RAD)
        data = bench.one(1, Instruction.READ, word(634) + word(5)).data
        assert (data[0], int.from_bytes(data[1:], "little")) == (25, 2100)

    def test_read_only_stays_read_only_and_eeprom_cannot_be_mapped(self) -> None:
        bench = Bench(xm430())
        bench.write(1, table.INDIRECT_ADDRESSES[0], 146)
        assert bench.write(1, table.INDIRECT_DATA[0], 1) == ACCESS
        assert bench.write(1, table.INDIRECT_ADDRESSES[0], 63) == RANGE

    def test_unmapped_indirect_data_is_plain_memory(self) -> None:
        bench = Bench(xm430())
        assert bench.write(1, table.INDIRECT_DATA[55], 200) == OK
        assert bench.read(1, table.INDIRECT_DATA[55]) == 200
