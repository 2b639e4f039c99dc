"""Fault commands: what is understood, when they act, what they do."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import HardwareError, Instruction
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.faults import Fault, FaultError, FaultKind, parse_lines, read_lines, require_known
from sim_backend.wire.injector import Injector, by_arm
from sim_backend.wire.pty import PtyPort
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring
from tests.support.documents import ROOT
from tests.support.servos.wire_bench import MS, Bench, word

PING_ALL = 0xFE, Instruction.PING


def test_the_page_has_every_kind_and_key_with_what_holds_where_none_is_given() -> None:
    page = (ROOT / "docs/commands.md").read_text().split("### Faults of emulated servos")[1].split("## ")[0]
    _, *rows = [line for line in page.splitlines() if line.startswith("| `")]
    kinds = [kind for row in rows for kind in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(kinds) == sorted(kind.value for kind in FaultKind)
    for name, key in Fault.model_fields.items():
        assert f"`{name}`" in page
        if name != "duration_s" and isinstance(key.default, (int, float)):
            assert f"`{name}` ({key.default:g})" in page
    example = page.split("```")[1]
    assert [fault.kind for fault in parse_lines(example)] == [FaultKind.SILENT, FaultKind.DROP]


class Rig(Bench):
    """Three servos with an injector on the same clock."""

    def __init__(self, port: PtyPort | None = None, seed: int = 1) -> None:
        joints = tuple(JointWiring(f"j{i}", (ServoWiring(i, "XM430-W350"),)) for i in (1, 2, 3))
        self.arm = EmulatedArm(ArmWiring("left", joints, 57_600))
        super().__init__(*self.arm.bus.servos)
        self.bus = self.arm.bus
        self.injector = Injector(self.arm, port, seed)

    def fault(self, **keys: object) -> None:
        self.injector.add([Fault.parse(json.dumps({"arm": "left"} | keys))], self.now_ns)
        self.injector.tick(self.now_ns)

    def tick(self, after_ms: float) -> None:
        self.now_ns += round(after_ms * MS)
        self.injector.tick(self.now_ns)

    def heard(self) -> list[int]:
        return [answer.servo_id for answer in self.send(*PING_ALL)]


class TestCommands:
    def test_command_is_read_with_its_defaults(self) -> None:
        fault = Fault.parse('{"kind": "delay", "arm": "left", "servo": 3, "start_s": 1, "delay_ms": 4}')
        assert (fault.kind, fault.servo, fault.start_s, fault.delay_ms) == (FaultKind.DELAY, 3, 1.0, 4.0)
        assert fault.probability == 1.0

    def test_file_of_commands_may_hold_comments_and_empty_lines(self) -> None:
        text = '# first\n\n{"kind": "drop", "arm": "left"}\n{"kind": "babble", "arm": "right"}\n'
        assert [fault.kind for fault in parse_lines(text)] == [FaultKind.DROP, FaultKind.BABBLE]

    @pytest.mark.parametrize(
        ("line", "said"),
        [
            ("drop left", "line"),
            ("[1]", "line"),
            ('{"kind": "drop"}', "arm"),
            ('{"kind": "explode", "arm": "left"}', "kind"),
            ('{"kind": "drop", "arm": "left", "sevro": 3}', "sevro"),
            ('{"kind": "drop", "arm": "left", "servo": 300}', "servo"),
            ('{"kind": "drop", "arm": "left", "start_s": -1}', "start_s"),
            ('{"kind": "drop", "arm": "left", "probability": 1.5}', "probability"),
            ('{"kind": "drop", "arm": "left", "duration_s": 5e9}', "duration_s: .* at most 1e.06 s; without the key"),
            (f'{{"kind": "drop", "arm": "left", "{"x" * 5000}": 1}}', "xxx"),
            (f'{{"kind": "drop", "arm": "{"x" * 9000}"}}', "arm: found 'xxx"),
        ],
    )
    def test_command_that_makes_no_sense_is_refused_with_the_key(self, line: str, said: str) -> None:
        with pytest.raises(FaultError, match=f"fault command: {said}") as refused:
            require_known(parse_lines(line), {"left": [3]})
        assert len(str(refused.value)) < 500

    def test_a_fault_may_last_a_million_seconds_or_have_no_end(self) -> None:
        lasting = [Fault(kind=FaultKind.DROP, arm="left", duration_s=x).duration_s for x in (1e6, math.inf)]
        assert lasting == [1e6, Fault(kind=FaultKind.DROP, arm="left").duration_s]

    @pytest.mark.parametrize(
        ("name", "found"),
        [
            ("folder", "no regular file"),
            ("large", "20 MB"),
            ("pipe", "no regular file"),
            ("none", "No such file"),
            ("a\0", ""),
        ],
    )
    def test_a_file_of_commands_is_a_file_and_no_pipe_is_waited_for(
        self, tmp_path: Path, name: str, found: str
    ) -> None:
        (tmp_path / "folder").mkdir()
        os.mkfifo(tmp_path / "pipe")
        with (tmp_path / "large").open("wb") as file:
            file.truncate(20_000_000)
        with pytest.raises(FaultError, match=f"^faults file {re.escape(str(tmp_path))}/.*: found {found}"):
            read_lines(tmp_path / name, {"left": [1]})

    def test_unknown_servo_and_arm_are_refused_and_nothing_is_planned(self) -> None:
        rig = Rig()
        with pytest.raises(FaultError, match="servo of arm left"):
            rig.fault(kind="mute", servo=9)
        with pytest.raises(FaultError, match="found 'right'"):
            by_arm({"left": rig.injector}, [Fault(kind=FaultKind.MUTE, arm="right")], 0)
        rig.tick(1)
        assert rig.heard() == [1, 2, 3]


class TestReplies:
    def test_dropped_reply_is_missing_and_the_others_are_not(self) -> None:
        rig = Rig()
        rig.fault(kind="drop", servo=2)
        assert rig.heard() == [1, 3]

    def test_corrupted_reply_differs_in_one_bit(self) -> None:
        rig = Rig()
        clean = rig.raw(b"\xff\xff\xfd\x00\x01\x03\x00\x01\x19\x4e")
        rig.fault(kind="corrupt", servo=1)
        spoiled = rig.raw(b"\xff\xff\xfd\x00\x01\x03\x00\x01\x19\x4e")
        assert sum((a ^ b).bit_count() for a, b in zip(clean, spoiled, strict=True)) == 1

    def test_duplicated_reply_comes_twice(self) -> None:
        rig = Rig()
        rig.fault(kind="duplicate", servo=3)
        assert rig.heard() == [1, 2, 3, 3]

    def test_delayed_reply_comes_later_behind_the_others(self) -> None:
        rig = Rig()
        rig.fault(kind="delay", servo=1, delay_ms=4)
        assert rig.heard() == [2, 3]
        assert rig.bus.due_ns() == rig.now_ns + 4 * MS
        assert rig.bus.take(rig.now_ns + 4 * MS)

    def test_probability_thins_faults_out_and_the_seed_repeats_them(self) -> None:
        def run(seed: int) -> list[int]:
            rig = Rig(seed=seed)
            rig.fault(kind="drop", probability=0.5)
            return [len(rig.heard()) for _ in range(50)]

        assert run(1) == run(1)
        assert run(1) != run(2)
        assert 40 < sum(run(1)) < 110

    def test_fault_lasts_from_its_start_for_its_duration(self) -> None:
        rig = Rig()
        rig.fault(kind="drop", servo=1, start_s=0.1, duration_s=0.2)
        heard = []
        for _ in range(4):
            heard.append(1 in rig.heard())
            rig.tick(100)
        assert heard == [True, False, False, True]


class TestServos:
    def test_silent_servo_neither_hears_nor_answers(self) -> None:
        rig = Rig()
        rig.fault(kind="silent", servo=2, duration_s=1)
        rig.send(0xFE, Instruction.WRITE, word(65) + b"\1")
        assert rig.heard() == [1, 3]
        rig.tick(1001)
        assert [rig.read(i, table.LED) for i in (1, 2, 3)] == [1, 0, 1]

    def test_mute_servo_obeys(self) -> None:
        rig = Rig()
        rig.fault(kind="mute", servo=2, duration_s=1)
        rig.send(0xFE, Instruction.WRITE, word(65) + b"\1")
        assert rig.heard() == [1, 3]
        rig.tick(1001)
        assert rig.read(2, table.LED) == 1

    @pytest.mark.parametrize(
        ("kind", "error"),
        [("overload", HardwareError.OVERLOAD), ("electrical_shock", HardwareError.ELECTRICAL_SHOCK)],
    )
    def test_hardware_error_takes_the_torque(self, kind: str, error: HardwareError) -> None:
        rig = Rig()
        rig.write(2, table.TORQUE_ENABLE, 1)
        rig.fault(kind=kind, servo=2)
        assert rig.read(2, table.HARDWARE_ERROR_STATUS) == error
        assert rig.read(2, table.TORQUE_ENABLE) == 0

    def test_overheating_ramps_until_the_servo_shuts_down(self) -> None:
        rig = Rig()
        rig.write(2, table.TORQUE_ENABLE, 1)
        rig.fault(kind="overheat", servo=2, temperature_C=85, ramp_s=1)
        temperatures = []
        for _ in range(10):
            rig.tick(100)
            rig.pass_time(1)
            temperatures.append(rig.read(2, table.PRESENT_TEMPERATURE))
        assert temperatures == pytest.approx([25 + 6 * (n + 1) for n in range(10)], abs=1)
        assert rig.read(2, table.TORQUE_ENABLE) == 0

    def test_supply_falls_and_returns(self) -> None:
        rig = Rig()
        rig.fault(kind="voltage", voltage_V=9, duration_s=0.5)
        rig.tick(1)
        assert rig.read(1, table.PRESENT_INPUT_VOLTAGE) == 90
        rig.tick(500)
        assert rig.read(1, table.PRESENT_INPUT_VOLTAGE) == 120

    def test_reboot_and_power_loss_clear_ram(self) -> None:
        for kind in ("reboot", "power_loss"):
            rig = Rig()
            rig.write(1, table.TORQUE_ENABLE, 1)
            rig.fault(kind=kind, servo=1, duration_s=0.1)
            assert 1 not in rig.heard()
            rig.tick(101)
            rig.tick(301)
            assert rig.read(1, table.TORQUE_ENABLE) == 0

    def test_stuck_encoder_stops_counting_and_a_wrong_one_jumps(self) -> None:
        rig = Rig()
        horn = rig.bus.servos[0].firmware.body.horn
        rig.fault(kind="encoder_stuck", servo=1, duration_s=0.1)
        horn.position_rad, horn.velocity_rad_per_s = 0.5, 1.0
        assert rig.read(1, table.PRESENT_POSITION) == 2048
        assert rig.read(1, table.PRESENT_VELOCITY) == 0
        rig.tick(101)
        assert rig.read(1, table.PRESENT_POSITION) == 2374
        rig.fault(kind="encoder_offset", servo=1, offset_ticks=-57, duration_s=0.1)
        assert rig.read(1, table.PRESENT_POSITION) == 2374 - 57
        rig.tick(101)
        assert rig.read(1, table.PRESENT_POSITION) == 2374

    def test_clearing_ends_what_runs_and_forgets_what_was_planned(self) -> None:
        rig = Rig()
        rig.fault(kind="mute", servo=2)
        rig.fault(kind="mute", servo=3, start_s=1)
        rig.injector.clear(rig.now_ns)
        rig.tick(2000)
        assert rig.heard() == [1, 2, 3]


class Pluggable:
    """A port that counts how often it is plugged in and unplugged."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def vanish(self) -> None:
        self.told.append("vanish")

    def appear(self) -> None:
        self.told.append("appear")


class TestOverlaps:
    """Two faults of one kind, from 0 to 1 s and from 0.5 to 2 s, or the second within the first."""

    @staticmethod
    def both(
        rig: Rig, kind: str, first: dict[str, object] | None = None, second: dict[str, object] | None = None,
        second_s: float = 1.5,
    ) -> None:  # fmt: skip
        rig.fault(kind=kind, duration_s=1.0, **(first or {}))
        rig.fault(kind=kind, start_s=0.5, duration_s=second_s, **(second or {}))

    def test_a_servo_has_a_fault_until_the_last_one_ends(self) -> None:
        for kind in ("silent", "mute", "power_loss"):
            for second in ({"servo": 2}, {}):
                rig = Rig()
                self.both(rig, kind, {"servo": 2}, second)
                for after_ms, heard in (
                    (400, [1, 3]),
                    (800, [1, 3] if second else []),
                    (700, [1, 3] if second else []),
                ):
                    rig.tick(after_ms)
                    assert rig.heard() == heard, (kind, second)
                rig.tick(200)
                rig.tick(400)  # a boot
                assert rig.heard() == [1, 2, 3], (kind, second)

    def test_line_and_port_have_a_fault_until_the_last_one_ends(self) -> None:
        port = Pluggable()
        rig = Rig(port)
        for kind in ("stall", "port_loss", "babble"):
            self.both(rig, kind)
        for after_ms in (0, 600, 500, 800):
            rig.tick(after_ms)
            assert rig.injector.stalled
            assert port.told == ["vanish"], "once"
            rig.bus.take(rig.now_ns)
            rig.tick(1)
            assert rig.bus.take(rig.now_ns), "babbling"
        rig.tick(200)
        assert not rig.injector.stalled
        assert port.told == ["vanish", "appear"]
        rig.tick(1)
        assert not rig.bus.take(rig.now_ns)

    @pytest.mark.parametrize(("second_s", "volts"), [(1.5, [80, 70, 70, 120]), (0.4, [80, 70, 80, 120])])
    def test_the_supply_is_that_of_the_newest_and_in_the_end_the_one_before_them_all(
        self, second_s: float, volts: list[int]
    ) -> None:
        rig, found = Rig(), []
        self.both(rig, "voltage", {"voltage_V": 8}, {"voltage_V": 7, "servo": 2}, second_s)
        for after_ms in (400, 200, 350, 1100):
            rig.tick(after_ms)
            found.append(rig.read(2, table.PRESENT_INPUT_VOLTAGE))
        assert found == volts
        assert rig.read(1, table.PRESENT_INPUT_VOLTAGE) == 120

    def test_a_position_is_wrong_by_the_newest_and_a_stuck_one_stays_where_it_stuck(self) -> None:
        rig = Rig()
        self.both(rig, "encoder_offset", {"offset_ticks": 10}, {"offset_ticks": 30})
        found = [rig.read(1, table.PRESENT_POSITION)]
        for after_ms in (600, 500, 1000):
            rig.tick(after_ms)
            found.append(rig.read(1, table.PRESENT_POSITION))
        assert found == [2048 + 10, 2048 + 30, 2048 + 30, 2048]
        self.both(rig, "encoder_stuck")
        rig.bus.servos[0].firmware.body.horn.position_rad = 0.5
        for after_ms, position in ((600, 2048), (500, 2048), (1000, 2374)):
            rig.tick(after_ms)
            assert rig.read(1, table.PRESENT_POSITION) == position

    def test_clearing_ends_both(self) -> None:
        rig = Rig()
        for kind in ("voltage", "silent", "stall"):
            self.both(rig, kind)
        rig.tick(600)
        rig.injector.clear(rig.now_ns)
        rig.tick(100)
        assert rig.heard() == [1, 2, 3]
        assert rig.read(1, table.PRESENT_INPUT_VOLTAGE) == 120
        assert not rig.injector.stalled


class TestLineAndPort:
    def test_babbling_never_ends_until_it_is_told_to(self) -> None:
        rig = Rig()
        rig.fault(kind="babble", duration_s=0.01)
        amounts = []
        for _ in range(12):
            rig.tick(1)
            amounts.append(len(rig.bus.take(rig.now_ns)))
        assert amounts[:9] == [100] * 9
        assert amounts[-1] == 0

    def test_a_servo_that_never_stops_talking_keeps_the_line_from_all_of_them(self) -> None:
        rig = Rig()
        rig.fault(kind="babble", duration_s=0.01)
        rig.fault(kind="babble", servo=2, duration_s=0.02)
        assert rig.bus.talked_over
        collisions = rig.bus.counters.collisions
        assert rig.heard() == []
        assert rig.bus.counters.collisions > collisions
        rig.tick(15)
        assert rig.bus.talked_over, "another one has ended"
        rig.tick(10)
        rig.bus.take(rig.now_ns)  # what it said until then
        assert rig.heard() == [1, 2, 3]

    def test_stall_is_seen_by_the_server(self) -> None:
        rig = Rig()
        rig.fault(kind="stall", duration_s=0.1)
        assert rig.injector.stalled
        rig.tick(101)
        assert not rig.injector.stalled

    def test_port_vanishes_and_comes_back_under_the_same_name(self, tmp_path: Path) -> None:
        port = PtyPort(tmp_path / "arm-left")
        port.appear()
        try:
            rig = Rig(port)
            rig.fault(kind="port_loss", duration_s=0.1)
            assert not (tmp_path / "arm-left").is_symlink()
            rig.tick(101)
            assert (tmp_path / "arm-left").is_char_device()
        finally:
            port.vanish()
        assert list(tmp_path.iterdir()) == []
