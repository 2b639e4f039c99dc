"""How a driver that takes an arm over asks for it: after silence, in time, those that are missing again."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers.dynamixel.line import codec
from drivers.dynamixel.standby import Handover, StandbyDriver
from tests.support.servos.dxl_rig import WX200, enabled
from tests.support.servos.scripted_line import BEGIN_NS, MS, US, Answer, Arrivals, Line, asked

IDS = (1, 2, 3, 4, 5, 6, 7)
QUIET_NS, ATTEMPT_NS, QUIET_MAX_NS = 1500 * US, 12 * MS, 6 * MS
INDIRECT_DATA_1 = 224


@cache
def handover() -> Handover:
    return Handover.of(enabled().driver)


def status(servo_id: int, error: int = 0) -> bytes:
    """Torque and LED on, no hardware error, watchdog of 10 counts, goal 0."""
    return codec.status(servo_id, error, struct.pack("<BBBbh", 1, 1, 0, 10, 0))


def adopted(answer: Answer, noise: Arrivals = ()) -> tuple[Line, list[bool]]:  # type: ignore[assignment]
    """The line afterwards, and of which joints the torque is known.  noise: what comes unasked, ns from the start."""
    line = Line(answer)
    line.coming = [(BEGIN_NS + after_ns, data) for after_ns, data in noise]
    port: Any = line
    driver = StandbyDriver(WX200, line, port=port)
    driver.prepare(handover())
    held = driver.adopt(None)
    return line, (~np.isnan(held)).tolist()


def requests(line: Line) -> list[tuple[int, tuple[int, ...], int]]:
    """Of each: when it went out, ns from the start, the servos asked, and until when it may take."""
    assert all(asked(data)[:3] == (False, INDIRECT_DATA_1, 6) for _, data, _ in line.writes)
    return [(ns - BEGIN_NS, asked(data)[3], deadline_ns - BEGIN_NS) for ns, data, deadline_ns in line.writes]


def all_but(*silent: int) -> Answer:
    return lambda _, request: [(2 * MS, b"".join(status(i) for i in asked(request)[3] if i not in silent))]


def test_a_quiet_line_is_asked_once() -> None:
    line, known = adopted(all_but())
    assert requests(line) == [(QUIET_NS, IDS, QUIET_NS + ATTEMPT_NS)]
    assert known == [True] * 4


def test_who_does_not_answer_is_asked_twice_more_and_alone() -> None:
    line, known = adopted(all_but(6, 7))
    turn_ns = QUIET_NS + ATTEMPT_NS
    assert requests(line) == [
        (QUIET_NS + n * turn_ns, ids, (n + 1) * turn_ns) for n, ids in enumerate((IDS, (6, 7), (6, 7)))
    ]
    assert known == [True, True, True, False]


def test_a_late_answer_to_the_process_before_is_waited_out() -> None:
    line, known = adopted(all_but(), noise=[(1400 * US, status(2))])
    assert requests(line)[0][0] == 1400 * US + QUIET_NS
    assert known == [True] * 4


def test_a_babbling_line_is_waited_for_no_longer_than_that() -> None:
    noise = [(n * MS, b"\x55") for n in range(1, 40)]
    assert requests(adopted(all_but(), noise)[0])[0][0] == QUIET_MAX_NS


@pytest.mark.parametrize(
    ("error", "believed"),
    [(0x00, True), (0x80, True), (0x01, False), (0x07, False), (0x40, False), (0x81, False)],
    ids=["none", "alert", "result fail", "access", "highest bit of a code", "alert and result fail"],
)
def test_an_answer_that_says_no_says_nothing_of_the_goal_and_an_alert_says_it(error: int, believed: bool) -> None:
    line, known = adopted(
        lambda _, request: [(2 * MS, b"".join(status(i, error if i == 4 else 0) for i in asked(request)[3]))]
    )
    assert known == [True, believed, True, True]
    assert [ids for _, ids, _ in requests(line)] == ([IDS] if believed else [IDS, (4,), (4,)])
