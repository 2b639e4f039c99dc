"""Several servos on one line: shadows, groups, silence, collisions, watchdogs."""

from __future__ import annotations

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import HardwareError, Instruction, OperatingMode
from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.drive import Stop
from sim_backend.wire.options import BusOptions, SilentPredecessor, WatchdogFeed
from sim_backend.wire.packet import crc16
from sim_backend.wire.servo import Servo, ServoOptions
from sim_backend.wire.timing import BusTiming, UsbTiming
from tests.support.servos.wire_bench import MS, Bench, answers, build, word, xl430, xm430

READ_BLOCK = word(126) + word(10)  # current, velocity, position


def fast_blocks(stream: bytes, length: int) -> list[tuple[int, int, bytes]]:
    """(ID, error, data) of a merged reply, each cumulative CRC checked."""
    assert stream[:5] == b"\xff\xff\xfd\x00\xfe"
    assert stream[7] == 0x55
    found = []
    at = 8
    while at < len(stream):
        end = at + 2 + length
        assert crc16(stream[:end]) == int.from_bytes(stream[end : end + 2], "little")
        found.append((stream[at + 1], stream[at], stream[at + 2 : end]))
        at = end + 2
    return found


class TestGroups:
    def test_broadcast_ping_is_answered_in_order_of_id(self) -> None:
        bench = Bench(xm430(3), xl430(1), xm430(2))
        assert [a.servo_id for a in bench.send(0xFE, Instruction.PING)] == [1, 2, 3]

    def test_broadcast_write_is_obeyed_by_all_and_answered_by_none(self) -> None:
        bench = Bench(xm430(1), xl430(2))
        assert bench.send(0xFE, Instruction.WRITE, word(65) + b"\1") == []
        assert [bench.read(i, table.LED) for i in (1, 2)] == [1, 1]
        assert bench.send(0xFE, Instruction.READ, word(65) + word(1)) == []

    def test_sync_read_is_answered_in_the_order_asked(self) -> None:
        bench = Bench(xm430(1), xm430(2), xm430(3))
        bench.bus.servos[1].firmware.body.horn.position_rad = 10 * TICK_RAD
        found = bench.send(0xFE, Instruction.SYNC_READ, word(132) + word(4) + bytes((3, 2)))
        assert [(a.servo_id, a.value) for a in found] == [(3, 2048), (2, 2058)]

    @pytest.mark.parametrize(
        ("rule", "expected"), [(SilentPredecessor.WAITED_OUT, [1, 3]), (SilentPredecessor.ENDS_REPLY, [1])]
    )
    def test_missing_servo_in_a_sync_read_is_a_switch(self, rule: SilentPredecessor, expected: list[int]) -> None:
        bench = Bench(xm430(1), xm430(3), options=BusOptions(silent_predecessor=rule))
        found = bench.send(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes((1, 2, 3)))
        assert [a.servo_id for a in found] == expected

    def test_fast_sync_read_is_one_packet_with_cumulative_crcs(self) -> None:
        bench = Bench(xm430(1), xm430(2), xl430(3))
        reply = bench.raw(build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + bytes((2, 1, 3))))
        assert int.from_bytes(reply[5:7], "little") == 1 + 3 * 14
        assert [(i, error) for i, error, _ in fast_blocks(reply, 10)] == [(2, 0), (1, 0), (3, 0)]

    def test_fast_sync_read_ends_at_a_silent_servo(self) -> None:
        bench = Bench(xm430(1), xm430(2), xm430(3))
        bench.bus.servos[1].muted = True
        reply = bench.raw(build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + bytes((1, 2, 3))))
        assert int.from_bytes(reply[5:7], "little") == 1 + 3 * 14
        assert [i for i, _, _ in fast_blocks(reply, 10)] == [1]

    def test_old_firmware_and_mx_do_not_know_fast_reads(self) -> None:
        for servo in (xm430(1, firmware=44), Servo(SERVOS["MX-28"], 1, firmware=46)):
            assert Bench(servo).raw(build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + b"\1")) == b""

    def test_alert_is_in_the_error_byte_of_sync_and_fast_replies(self) -> None:
        bench = Bench(xm430(1), xm430(2))
        bench.bus.servos[1].firmware.raise_error(HardwareError.OVERLOAD)
        sync = bench.send(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes((1, 2)))
        fast = fast_blocks(bench.raw(build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + bytes((1, 2)))), 10)
        assert [a.error for a in sync] == [0, 0x80]
        assert [error for _, error, _ in fast] == [0, 0x80]

    def test_bulk_read_takes_its_own_address_per_servo(self) -> None:
        bench = Bench(xm430(1), xm430(2))
        found = bench.send(0xFE, Instruction.BULK_READ, bytes.fromhex("01 9000 0200 02 9200 0100"))
        assert [(a.servo_id, a.value) for a in found] == [(1, 120), (2, 25)]

    def test_fast_bulk_read_of_the_manual_example(self) -> None:
        bench = Bench(xm430(3), xm430(7), xm430(4))
        request = bytes.fromhex("03 8400 0400 07 7C00 0200 04 9200 0100")
        reply = bench.raw(build(0xFE, Instruction.FAST_BULK_READ, request))
        assert len(reply) == 8 + (4 + 4) + (4 + 2) + (4 + 1)
        assert crc16(reply[:-2]) == int.from_bytes(reply[-2:], "little")

    def test_bulk_write_takes_its_own_address_per_servo(self) -> None:
        bench = Bench(xm430(1), xm430(2))
        bench.send(0xFE, Instruction.BULK_WRITE, bytes.fromhex("01 2000 0200 9600 02 1F00 0100 46"))
        assert bench.read(1, table.MAX_VOLTAGE_LIMIT) == 150
        assert bench.read(2, table.TEMPERATURE_LIMIT) == 70

    def test_bulk_write_that_ends_too_early_does_nothing(self) -> None:
        bench = Bench(xm430(1))
        bench.send(0xFE, Instruction.BULK_WRITE, bytes.fromhex("01 2000 0200 96"))
        assert bench.read(1, table.MAX_VOLTAGE_LIMIT) == 160
        assert bench.bus.responder.malformed == 1

    def test_sync_write_with_a_ragged_length_does_nothing(self) -> None:
        bench = Bench(xm430(1))
        bench.send(0xFE, Instruction.SYNC_WRITE, word(65) + word(1) + b"\1\1\1")
        assert bench.read(1, table.LED) == 0
        assert bench.bus.responder.malformed == 1

    def test_reply_with_a_header_inside_is_stuffed_unless_fast(self) -> None:
        servo = xm430(1)
        bench = Bench(servo)
        # velocity -3 (FD FF FF FF) behind current -1 (FF FF): what a servo near standstill says
        servo.firmware.body.motor.current_A = -2.69e-3
        servo.firmware.body.horn.velocity_rad_per_s = -3 * VELOCITY_UNIT_RAD_PER_S
        sync = bench.raw(build(0xFE, Instruction.SYNC_READ, READ_BLOCK + b"\1"))
        assert b"\xff\xff\xfd\xfd" in sync[8:]
        assert answers(sync)[0].data[:6] == b"\xff\xff\xfd\xff\xff\xff"
        fast = bench.raw(build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + b"\1"))
        assert len(fast) == 8 + 14


class TestShadow:
    def pair(self) -> Bench:
        return Bench(xm430(2), xm430(3, secondary_id=2, drive_mode=1), xm430(4))

    def test_shadow_obeys_in_silence(self) -> None:
        bench = self.pair()
        assert bench.write(2, table.LED, 1) == 0
        assert [bench.read(i, table.LED) for i in (2, 3, 4)] == [1, 1, 0]

    def test_shadow_takes_sync_writes_to_its_leader(self) -> None:
        bench = self.pair()
        bench.sync_write(table.GOAL_PWM, {2: 100, 4: 50})
        assert [bench.read(i, table.GOAL_PWM) for i in (2, 3, 4)] == [100, 100, 50]

    def test_own_id_comes_before_secondary_id(self) -> None:
        bench = self.pair()
        bench.sync_write(table.GOAL_PWM, {2: 100, 3: 70})
        assert bench.read(3, table.GOAL_PWM) == 70

    def test_eeprom_of_a_shadow_is_not_written_through_its_leader(self) -> None:
        bench = self.pair()
        assert bench.write(2, table.OPERATING_MODE, OperatingMode.CURRENT) == 0
        assert bench.read(3, table.OPERATING_MODE) == OperatingMode.POSITION

    def test_secondary_id_that_no_servo_has_is_obeyed_without_answer(self) -> None:
        bench = Bench(xm430(1, secondary_id=100), xm430(2, secondary_id=100))
        assert bench.send(100, Instruction.WRITE, word(65) + b"\1") == []
        assert [bench.read(i, table.LED) for i in (1, 2)] == [1, 1]
        assert bench.send(100, Instruction.PING) == []

    def test_reg_write_and_action_reach_the_shadow(self) -> None:
        bench = self.pair()
        bench.one(2, Instruction.REG_WRITE, word(65) + b"\1")
        bench.one(2, Instruction.ACTION)
        assert bench.read(3, table.LED) == 1


class TestLine:
    def test_servo_at_another_speed_hears_nothing(self) -> None:
        bench = Bench(xm430(1))
        bench.baud = 1_000_000
        assert bench.raw(build(1, Instruction.PING)) == b""
        assert bench.bus.counters.wrong_baud == 1

    def test_servo_hears_at_its_new_speed_after_it_was_changed(self) -> None:
        bench = Bench(xm430(1))
        assert bench.write(1, table.BAUD_RATE, 7) == 0
        assert bench.send(1, Instruction.PING) == []
        bench.baud = 4_571_000
        assert bench.one(1, Instruction.PING).error == 0

    def test_two_servos_with_one_id_garble_each_other(self) -> None:
        bench = Bench(xm430(1), xl430(1))
        reply = bench.raw(build(1, Instruction.PING))
        assert reply
        with pytest.raises(AssertionError):
            answers(reply)

    def test_damaged_instruction_is_answered_by_crc_error_or_not_at_all(self) -> None:
        packet = bytearray(build(1, Instruction.WRITE, word(65) + b"\1"))
        packet[-3] ^= 1
        for says_so in (True, False):
            bench = Bench(xm430(1), options=BusOptions(answers_damaged=says_so))
            assert [a.error for a in answers(bench.raw(bytes(packet)))] == [3] * says_so
            assert bench.read(1, table.LED) == 0

    def test_deaf_servo_keeps_its_torque_and_a_mute_one_obeys(self) -> None:
        deaf, mute = xm430(1), xm430(2)
        bench = Bench(deaf, mute)
        deaf.deaf = mute.muted = True
        assert bench.send(0xFE, Instruction.WRITE, word(65) + b"\1") == []
        assert bench.send(0xFE, Instruction.PING) == []
        deaf.deaf = mute.muted = False
        assert [bench.read(i, table.LED) for i in (1, 2)] == [0, 1]

    def test_status_packet_on_the_line_is_ignored(self) -> None:
        assert Bench(xm430(1)).send(1, Instruction.STATUS, b"\0") == []


class TestTiming:
    """The published arithmetic of facts: sizes, return delay, turnaround, latency timer; on virtual time."""

    def due(self, timing: BusTiming, packet: bytes, *servos: Servo) -> int:
        bench = Bench(*servos, timing=timing)
        bench.baud = 1_000_000
        bench.bus.receive(packet, 0, bench.baud)
        last = 0
        while (due_ns := bench.bus.due_ns()) is not None:
            last = due_ns
            bench.bus.take(due_ns)
        return last

    def fleet(self, count: int, **eeprom: int) -> list[Servo]:
        return [xm430(i + 1, baud_rate=3, **{"return_delay_time": 0, **eeprom}) for i in range(count)]

    def test_sync_read_of_7_takes_its_bytes_and_7_turnarounds(self) -> None:
        packet = build(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes(range(1, 8)))
        timing = BusTiming(turnaround_ns=30_000, usb=None)
        assert self.due(timing, packet, *self.fleet(7)) == (21 + 7 * 21) * 10_000 + 7 * 30_000

    def test_fast_sync_read_of_7_takes_fewer_bytes_and_one_turnaround(self) -> None:
        packet = build(0xFE, Instruction.FAST_SYNC_READ, READ_BLOCK + bytes(range(1, 8)))
        timing = BusTiming(turnaround_ns=30_000, fast_gap_ns=0, usb=None)
        assert self.due(timing, packet, *self.fleet(7)) == (21 + 8 + 7 * 14) * 10_000 + 30_000

    def test_factory_return_delay_costs_half_a_millisecond_per_reply(self) -> None:
        packet = build(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes(range(1, 8)))
        timing = BusTiming(turnaround_ns=0, usb=None)
        slow = self.due(timing, packet, *self.fleet(7, return_delay_time=250))
        assert slow - self.due(timing, packet, *self.fleet(7)) == 7 * 500_000

    @pytest.mark.parametrize("latency_ms", [1, 16])
    def test_latency_timer_rounds_the_reply_up(self, latency_ms: int) -> None:
        packet = build(1, Instruction.PING)
        timing = BusTiming(usb=UsbTiming(latency_ns=latency_ms * MS, drift_ppm=0))
        assert self.due(timing, packet, *self.fleet(1)) == latency_ms * MS

    def test_servo_that_stays_silent_costs_the_time_of_its_reply(self) -> None:
        packet = build(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes((1, 2)))
        timing = BusTiming(turnaround_ns=0, usb=None)
        servos = self.fleet(2)
        servos[0].muted = True
        assert self.due(timing, packet, *servos) == (16 + 2 * 21) * 10_000

    def test_request_during_a_reply_is_lost_and_counted(self) -> None:
        bench = Bench(*self.fleet(3), timing=BusTiming(usb=None))
        bench.baud = 1_000_000
        bench.bus.receive(build(0xFE, Instruction.SYNC_READ, READ_BLOCK + bytes((1, 2, 3))), 0, bench.baud)
        bench.bus.receive(build(0xFE, Instruction.WRITE, word(65) + b"\1"), 300_000, bench.baud)
        assert bench.bus.counters.collisions == 1
        assert [s.firmware.memory.get(table.LED) for s in bench.bus.servos] == [0, 0, 0]

    def test_instructions_that_come_in_one_piece_wait_for_their_turn(self) -> None:
        bench = Bench(*self.fleet(2), timing=BusTiming(turnaround_ns=0, usb=None))
        bench.baud = 1_000_000
        bench.bus.receive(build(1, Instruction.PING) + build(2, Instruction.PING), 0, bench.baud)
        assert bench.bus.counters.collisions == 0
        assert len(answers(bench.bus.take((10 + 14 + 10) * 10_000 + 139_999))) == 1
        assert len(answers(bench.bus.take((10 + 14 + 10 + 14) * 10_000))) == 1


class TestWatchdog:
    def armed(self, mode: OperatingMode, goal: dict[table.Register, int], options: ServoOptions) -> Bench:
        bench = Bench(xm430(1, options=options), xm430(2))
        bench.write(1, table.OPERATING_MODE, mode)
        for register, value in goal.items():
            assert bench.write(1, register, value) == 0
        bench.write(1, table.TORQUE_ENABLE, 1)
        assert bench.write(1, table.BUS_WATCHDOG, 10) == 0
        return bench

    def torque(self, bench: Bench) -> float:
        return bench.bus.servos[0].firmware.body.step(1e-3, alive=True)

    def current(self, options: ServoOptions) -> Bench:
        return self.armed(OperatingMode.CURRENT, {table.GOAL_CURRENT: 200}, options)

    def test_reads_minus_one_after_200_ms_of_silence(self) -> None:
        bench = self.current(ServoOptions())
        bench.pass_time(199)
        assert bench.bus.counters.watchdog_trips == 0
        bench.pass_time(2)
        assert bench.bus.counters.watchdog_trips == 1
        assert bench.read(1, table.BUS_WATCHDOG) == -1

    def test_is_not_armed_without_torque(self) -> None:
        bench = self.current(ServoOptions())
        bench.write(1, table.TORQUE_ENABLE, 0)
        bench.pass_time(500)
        assert bench.read(1, table.BUS_WATCHDOG) == 10

    def test_goals_are_refused_while_it_stands_and_sync_writes_are_lost_in_silence(self) -> None:
        bench = self.current(ServoOptions())
        bench.pass_time(201)
        assert bench.write(1, table.GOAL_CURRENT, 5) == 4
        bench.sync_write(table.GOAL_CURRENT, {1: 5})
        assert bench.read(1, table.GOAL_CURRENT) == 200
        assert bench.write(1, table.BUS_WATCHDOG, 10) == 4
        assert bench.write(1, table.LED, 1) == 0

    def test_cleared_by_zero_it_stays_stopped_until_a_new_goal(self) -> None:
        bench = self.current(ServoOptions())
        bench.pass_time(201)
        assert bench.write(1, table.BUS_WATCHDOG, 0) == 0
        assert self.torque(bench) == 0.0
        assert bench.write(1, table.GOAL_CURRENT, 100) == 0
        assert self.torque(bench) == pytest.approx(100 * 2.69e-3 * 4.1 / 2.3, rel=1e-6)

    @pytest.mark.parametrize(("mode", "register"), [(0, table.GOAL_CURRENT), (16, table.GOAL_PWM)])
    @pytest.mark.parametrize(("stop", "brakes", "holds"), [("limp", 0, 0), ("brake", 1, 0), ("hold", 1, 1)])
    def test_stop_of_current_and_pwm_mode_is_a_switch(
        self, mode: int, register: table.Register, stop: str, brakes: int, holds: int
    ) -> None:
        bench = self.armed(OperatingMode(mode), {register: 200}, ServoOptions(watchdog_stop=Stop(stop)))
        bench.pass_time(201)
        horn = bench.bus.servos[0].firmware.body.horn
        horn.velocity_rad_per_s = 0.5
        assert (self.torque(bench) < -0.1) == bool(brakes)
        horn.velocity_rad_per_s = 0.0
        horn.position_rad = 0.2
        assert (self.torque(bench) < -0.1) == bool(holds)

    def test_velocity_mode_stops_and_position_mode_holds_where_it_was(self) -> None:
        moving = self.armed(OperatingMode.VELOCITY, {table.GOAL_VELOCITY: 100}, ServoOptions())
        moving.bus.servos[0].firmware.body.horn.velocity_rad_per_s = 2.0
        moving.pass_time(201)
        assert self.torque(moving) < -0.1
        holding = self.armed(OperatingMode.POSITION, {}, ServoOptions())
        holding.write(1, table.GOAL_POSITION, 1000)
        holding.pass_time(201)
        assert self.torque(holding) == pytest.approx(0.0, abs=1e-9)

    @pytest.mark.parametrize(("feed", "trips"), [(WatchdogFeed.ANY_PACKET, 0), (WatchdogFeed.OWN_PACKET, 1)])
    def test_whose_packets_feed_it_is_a_switch(self, feed: WatchdogFeed, trips: int) -> None:
        bench = self.current(ServoOptions(watchdog_feed=feed))
        for _ in range(5):
            bench.pass_time(100)
            bench.one(2, Instruction.PING)
        assert bench.bus.counters.watchdog_trips == trips
