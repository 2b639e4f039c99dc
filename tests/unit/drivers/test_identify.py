"""What is said of a line on which servos are silent, strange or curt; each answer is given by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import pytest

from drivers.dynamixel.arm_map import ArmMap, Mark
from drivers.dynamixel.errors import Heard, NoReplyError, PortError, RejectedError
from drivers.dynamixel.identify import IdentityError, Line, another_arm, survey
from drivers.dynamixel.line.bus import Ping
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import StatusError
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.table import Register
from tests.support.servos.dxl_rig import WX200, at, build

IDS = tuple(slot.servo_id for slot in WX200.slots)
OTHER_SPEEDS = (9_600, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


@cache
def whole() -> Mapping[int, ServoFound]:
    """The servos of an arm that is as it should be."""
    rig = build()
    rig.driver.connect()
    return {servo.slot.servo_id: servo for servo in rig.driver.found}


@dataclass
class FakeBus:
    """A bus and its port; `heard` answer the broadcast, the others as `silent` says, and reads are as `refuse` says."""

    silent: Mapping[int, Heard] = field(default_factory=dict)
    strange: tuple[Ping, ...] = ()
    refuse: Callable[[int, Register], Exception | None] = lambda *_: None
    beyond: tuple[int, ...] = ()  # speeds that the adapter cannot make
    baud: int = WX200.baud
    asked: list[tuple[int, int, int]] = field(default_factory=list)  # speed, servo, attempts
    reads: set[int] = field(default_factory=set)

    @property
    def port(self) -> FakeBus:
        return self

    def set_baud(self, baud: int) -> None:
        if baud in self.beyond:
            raise PortError("speed", found=baud, expected="another", remedy="none")
        self.baud = baud

    def ping_all(self, _: float) -> list[Ping]:
        told = [Ping(i, servo.model_number, servo.firmware) for i, servo in whole().items() if i not in self.silent]
        return [ping for ping in told if ping.servo_id not in {p.servo_id for p in self.strange}] + [*self.strange]

    def ping(self, servo_id: int, attempts: int) -> Ping:
        self.asked.append((self.baud, servo_id, attempts))
        raise NoReplyError(servo_id, "ping", attempts=attempts, heard=self.silent[servo_id])

    def read(self, servo_id: int, register: Register) -> int:
        self.reads.add(servo_id)
        if (error := self.refuse(servo_id, register)) is not None:
            raise error
        return whole()[servo_id].values[register.name]


def found_on(bus: FakeBus, arm: ArmMap = WX200, **more: bool) -> Line:
    line: Any = bus
    return survey(line, arm, 0.1, **more)


def only(line: Line) -> IdentityError:
    (problem,) = line.problems
    return problem


@pytest.mark.parametrize(
    ("heard", "found", "remedy"),
    [
        (Heard.NOTHING, "none that answers, at any speed", "switch on the 12 V supply"),
        (Heard.NOISE, "none that answers, at any speed; bytes that are no packet", "switch on the 12 V supply"),
        (Heard.ECHO, "none that answers, at any speed; only an echo of the request", "switch on the 12 V supply"),
        (Heard.OTHER, "only answers to other requests, at 1000000 bit/s", "another program talks on this bus"),
        (Heard.DAMAGED, "damaged packets, at 1000000 bit/s", "the line spoils it"),
    ],
)
def test_of_a_line_without_an_answer_the_most_telling_servo_says_what_is_wrong(
    heard: Heard, found: str, remedy: str
) -> None:
    silent = {**dict.fromkeys(IDS, Heard.NOTHING), 4: heard}
    error = only(found_on(FakeBus(silent)))
    assert (error.servo_id, error.found) == (None, found)
    assert remedy in error.remedy


def test_a_silent_arm_is_asked_for_once_at_each_other_speed_that_the_adapter_makes() -> None:
    bus = FakeBus(dict.fromkeys(IDS, Heard.NOTHING), beyond=(4_500_000,))
    found_on(bus)
    assert bus.asked == [
        *((WX200.baud, i, 2) for i in IDS),
        *((baud, i, 1) for baud in OTHER_SPEEDS if baud != 4_500_000 for i in IDS),
    ]
    assert bus.baud == WX200.baud


@pytest.mark.parametrize(
    ("heard", "remedy"),
    [
        (Heard.NOTHING, "check its cable and those before it in the chain, or set its ID with"),
        (Heard.NOISE, "check the baud rate, the cable and its shield"),
        (Heard.ECHO, "the adapter returns what is sent"),
        (Heard.OTHER, "the adapter holds old answers back"),
        (Heard.DAMAGED, "two servos may have this ID: connect one alone"),
    ],
)
def test_of_one_missing_servo_what_came_instead_says_what_to_do(heard: Heard, remedy: str) -> None:
    bus = FakeBus({5: heard})
    line = found_on(bus)
    assert only(line).servo_id == 5
    assert only(line).remedy.startswith(remedy)
    assert [servo.slot.servo_id for servo in line.servos] == [1, 2, 3, 4, 6, 7]
    assert bus.asked == [(WX200.baud, 5, 2)], "who has answered is not asked again"


def test_an_id_that_answers_twice_is_neither_asked_nor_read() -> None:
    bus = FakeBus(strange=(Ping(5, 1020, 46),) * 2)
    line = found_on(bus)
    assert (only(line).servo_id, only(line).found) == (5, "2 answers to one ping")
    assert bus.reads == {*IDS} - {5}
    assert bus.asked == []


def test_a_servo_of_another_model_is_not_read_by_the_table_of_this_one() -> None:
    bus = FakeBus(strange=(Ping(5, 1060, 46),))
    line = found_on(bus)
    assert (only(line).servo_id, only(line).found) == (5, "XL430-W250")
    assert bus.reads == {*IDS} - {5}
    assert 5 not in [servo.slot.servo_id for servo in line.servos]


@pytest.mark.parametrize(
    ("register", "code", "read"),
    [
        (table.STARTUP_CONFIGURATION, StatusError.ACCESS, True),  # firmware 45 and later have it
        (table.STARTUP_CONFIGURATION, StatusError.RESULT_FAIL, False),
        (table.OPERATING_MODE, StatusError.ACCESS, False),
    ],
)
def test_of_what_a_servo_refuses_to_tell_only_registers_of_younger_firmware_may_be_absent(
    register: Register, code: StatusError, read: bool
) -> None:
    refused = RejectedError(5, "read", code)
    line = found_on(FakeBus(refuse=lambda i, r: refused if (i, r.name) == (5, register.name) else None))
    assert line.mute == (), "it has answered"
    if read:
        assert line.problems == ()
        (servo,) = (servo for servo in line.servos if servo.slot.servo_id == 5)
        assert whole()[5].values.keys() - servo.values.keys() == {register.name}
    else:
        assert only(line).servo_id == 5
        assert str(only(line).found) == f"refused with {code.name}, though it answers pings"


@pytest.mark.parametrize(("more", "remedy"), [({}, "Status Return Level may be 0"), ({"woken": True}, "not reliable")])
def test_a_servo_that_answers_pings_alone_is_mute(more: dict[str, bool], remedy: str) -> None:
    silence = NoReplyError(5, "read", attempts=3, heard=Heard.NOTHING)
    line = found_on(FakeBus(refuse=lambda i, _: silence if i == 5 else None), **more)
    assert line.mute == (5,)
    assert remedy in only(line).remedy


def test_an_arm_of_one_servo_has_a_mark_too() -> None:
    arm = at(WX200, joints=WX200.joints[2:3], mark=Mark("left", 1, ((2, "right"),)))
    (slot,) = arm.slots
    seen = ServoFound(slot, 1020, 46, {**whole()[4].values, "Moving Threshold": 2})
    error = another_arm(arm, [seen])
    assert error is not None
    assert (error.servo_id, error.found) == (None, "2, arm right's")
