"""Setting up on a line that stands still for a while: an answer to an older question is not the next one's."""

from __future__ import annotations

import pytest

from agent.motors import eeprom
from agent.motors.find import survey
from drivers.dynamixel.errors import NoReplyError, RejectedError
from drivers.dynamixel.line.bus import MARKS, PING_BYTES, Bus
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    CURRENT_LIMIT,
    ID,
    MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT,
    MODEL_NUMBER,
    PWM_LIMIT,
    STATUS_RETURN_LEVEL,
    TORQUE_ENABLE,
    Register,
)
from drivers.dynamixel.standby import Page
from sim_backend.wire.bus import Tampered
from sim_backend.wire.timing import BusTiming
from tests.support.few import few
from tests.support.servos.dxl_rig import Rig
from tests.support.servos.tool_rig import bus_of, fresh, servo_rig

MS = 1_000_000
SERVO = fresh("XM430-W350", 4, Current_Limit=321, PWM_Limit=456)
TRUE = {
    ID: 4, BAUD_RATE: 1, MODEL_NUMBER: 1020, CURRENT_LIMIT: 321, PWM_LIMIT: 456, MAX_VOLTAGE_LIMIT: 160,
    MIN_VOLTAGE_LIMIT: 95,
}  # fmt: skip
STOOD_MS = [0, 30, 55, 62, 70, 80, 84, 85, 86, 88, 90, 110, 140, 147, 160, 171, 175, 200, 240, 300]


class Queue:
    """What the adapter holds back while it stands still, it hands over one by one afterwards, in its order."""

    def __init__(self, rig: Rig, apart_ms: float) -> None:
        self._rig, self._apart_ns = rig, round(apart_ms * MS)
        self._free_ns = 0
        rig.bus.tamper = self._held

    def stand(self, for_ms: float) -> None:
        """From now on."""
        self._free_ns = self._rig.clock.now_ns() + round(for_ms * MS)

    def _held(self, _: int, data: bytes) -> list[Tampered]:
        now_ns = self._rig.clock.now_ns()
        self._free_ns = max(now_ns, self._free_ns) + self._apart_ns
        return [Tampered(data, self._free_ns - now_ns)]


def line(apart_ms: float) -> tuple[Rig, Bus, Queue]:
    rig = servo_rig(SERVO, timing=BusTiming())
    bus = bus_of(rig)
    bus.port.set_baud(57_600)
    return rig, bus, Queue(rig, apart_ms)


def answers(bus: Bus, registers: list[Register]) -> list[bool | None]:
    """Of each register whether it was read as it is; None where no answer was believed."""
    found: list[bool | None] = []
    for register in registers:
        try:
            found.append(bus.read(4, register) == TRUE[register])
        except NoReplyError:
            found.append(None)
    return found


@pytest.mark.parametrize("apart_ms", [2.0, 20.0, 50.0])
@pytest.mark.parametrize("stood_ms", few(STOOD_MS, STOOD_MS[::3].__contains__))
def test_no_register_is_read_as_another_one_however_long_the_line_stood_still(stood_ms: float, apart_ms: float) -> None:
    _, bus, queue = line(apart_ms)
    queue.stand(stood_ms)
    found = answers(bus, [*TRUE, *TRUE])
    assert False not in found
    assert found[4:] == [True] * (len(found) - 4)  # once it goes again, all is read


@pytest.mark.parametrize("stood_ms", few(STOOD_MS, STOOD_MS[::3].__contains__))
def test_a_line_that_stands_still_again_and_again_has_no_register_read_as_another_one(stood_ms: float) -> None:
    _, bus, queue = line(4.0)
    found = []
    for register in [*TRUE] * 3:
        queue.stand(stood_ms)
        found += answers(bus, [register])
    assert False not in found
    assert stood_ms > 140 or None not in found


def test_a_refusal_of_an_older_question_is_not_the_next_ones() -> None:
    rig, bus, queue = line(4.0)
    rig.put(4, TORQUE_ENABLE, 1)
    queue.stand(86.0)
    with pytest.raises(RejectedError):
        bus.write(4, ID, 5)
    queue.stand(2.0)
    assert answers(bus, [CURRENT_LIMIT, ID]) == [True, True]


def test_an_acknowledgement_of_an_older_write_is_not_the_next_ones() -> None:
    rig, bus, queue = line(4.0)
    queue.stand(86.0)
    bus.write(4, CURRENT_LIMIT, 300)
    rig.put(4, TORQUE_ENABLE, 1)
    with pytest.raises(RejectedError):
        bus.write(4, PWM_LIMIT, 400)


@pytest.mark.parametrize("stood_ms", few(STOOD_MS, STOOD_MS[::3].__contains__))
def test_a_scan_shows_a_servo_as_it_is_or_says_that_it_does_not_answer(stood_ms: float) -> None:
    rig, bus, queue = line(4.0)
    begun_ns = rig.clock.now_ns()

    def told(_: str) -> None:
        queue.stand(stood_ms + (870 if rig.clock.now_ns() > begun_ns else 0))

    for seen in survey(bus, "virtual", [57_600], told):
        assert (seen.servo_id, seen.model_number) == (4, 1020)
        assert (seen.voltage_V, seen.temperature_C, seen.torque_on) in ((12.0, 25, False), (None, None, None))


def test_the_eeprom_is_read_whole_while_the_line_stands_still_now_and_then() -> None:
    rig, bus, queue = line(3.0)
    registers = eeprom.writable(SERVOS["XM430-W350"])
    true = {r.name: rig.get(4, r) for r in registers if rig.servo(4).firmware.memory.has(r)}
    found = {}
    for place, register in enumerate(registers):
        queue.stand(86.0 if place % 3 == 0 else 0.0)
        found |= eeprom.read(bus, 4, [register])
    assert found == true


def test_a_servo_that_answers_pings_alone_is_found_behind_a_read_that_it_did_not_answer() -> None:
    rig, bus, _ = line(1.0)
    rig.put(4, STATUS_RETURN_LEVEL, 0)
    assert answers(bus, [ID]) == [None]
    assert bus.ping(4).model_number == 1020


def test_an_older_pings_answer_does_not_say_that_an_older_read_is_past() -> None:
    _, bus, queue = line(4.0)
    queue.stand(400.0)
    with pytest.raises(NoReplyError):
        bus.ping(4, attempts=1)
    assert answers(bus, [CURRENT_LIMIT]) == [None]
    assert bus.ping(4).model_number == 1020
    assert answers(bus, [PWM_LIMIT]) == [True]


def test_a_line_that_answers_in_time_is_asked_nothing_more() -> None:
    rig, bus, _ = line(1.0)
    rig.port.writes.clear()
    bus.ping(4)
    assert answers(bus, [*TRUE]) == [True] * len(TRUE)
    assert len(rig.port.writes) == 1 + len(TRUE)


def test_a_servo_that_was_slow_once_costs_one_question_more_and_then_none() -> None:
    rig, bus, queue = line(1.0)
    queue.stand(90.0)
    assert answers(bus, [ID]) == [True]
    rig.port.writes.clear()
    assert answers(bus, [CURRENT_LIMIT]) == [True]
    assert len(rig.port.writes) == 1


def test_marks_are_answered_as_nothing_else_is() -> None:
    lengths = {r.length for model in SERVOS.values() for r in model.registers.values()} | {0, PING_BYTES}
    pages = {6, 3}
    assert not lengths & set(MARKS)
    assert len(Page) == len(pages)
    assert not pages & set(MARKS)
    assert max(MARKS) < 10  # the least that a cycle asks of a servo
