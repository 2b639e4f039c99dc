"""A cycle of the driver with an arm that does as the test says: what it reads, sends and refuses to send."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from drivers.dynamixel.cycle import CycleRows
from drivers.dynamixel.driver import CycleTimes, DynamixelDriver
from drivers.dynamixel.errors import (
    DxlServoFault,
    FaultCause,
    PortLostError,
    StaleJointsError,
    TorqueError,
    WriteTimeoutError,
)
from drivers.dynamixel.interpret import Reading
from drivers.interface import JointState, ServoHealth
from tests.support.servos.dxl_rig import build


@dataclass
class Clock:
    """Moves on by a millisecond each time it is asked."""

    ns: int = 0

    def now_ns(self) -> int:
        self.ns += 1_000_000
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        raise NotImplementedError

    utc_offset_ns = 0


STATE = JointState(5, np.zeros(4), np.zeros(4), np.zeros(4))
ROWS: list[Any] = [(0, 0, 0, 0)] * 7


@dataclass
class Arm:
    """Stands in for what `connect` made."""

    cycle: CycleRows = field(default_factory=lambda: CycleRows(5, list(ROWS), b"", False, False))
    reading: Reading = field(default_factory=lambda: Reading(STATE, [], False, []))
    found: list[DxlServoFault] = field(default_factory=list)
    error: Exception | None = None
    calls: list[Any] = field(default_factory=list)
    misses: int = 3

    @property
    def reader(self) -> Arm:
        return self

    @property
    def monitor(self) -> Arm:
        return self

    def hear_health(self) -> None:
        self.calls.append("hear")

    def read(self) -> CycleRows:
        self.calls.append("read")
        if self.error is not None:
            raise self.error
        return self.cycle

    def interpret(self, cycle: CycleRows, now_ns: int) -> Reading:
        assert cycle is self.cycle
        self.calls.append(("interpret", now_ns))
        return self.reading

    def faults(self, reading: Reading, known: list[DxlServoFault]) -> list[DxlServoFault]:
        assert reading is self.reading
        self.calls.append("faults")
        return [*known, *self.found]

    def write(self, tau_Nm: list[float], begin_ns: int) -> list[float]:
        self.calls.append(("write", tau_Nm, begin_ns))
        return [tau + 0.5 for tau in tau_Nm]

    def health(self, now_ns: int) -> ServoHealth:
        return ServoHealth.none(now_ns)


Made = tuple[DynamixelDriver, Arm, Clock]


@pytest.fixture
def made() -> Callable[..., Made]:
    def make(*, torque: bool = True) -> Made:
        rig = build()
        rig.driver.connect()
        if torque:
            rig.driver.enable()
        driver: Any = rig.driver
        arm, clock = Arm(), Clock()
        driver._running, driver._clock = arm, clock
        return driver, arm, clock

    return make


def test_a_cycle_hears_reads_and_interprets_and_says_where_the_time_went(made: Callable[..., Made]) -> None:
    driver, arm, _ = made()
    driver.times = CycleTimes()
    assert (driver.times.exchange, driver.times.interpret, driver.times.write) == (0, 0, 0)
    assert driver.read() is STATE
    assert arm.calls == ["hear", "read", ("interpret", 2_000_000), "faults"]
    assert (driver.times.exchange, driver.times.interpret) == (1_000_000, 1_000_000)
    assert driver.counters.health_misses == 3
    assert driver.write(np.array([1.0, 2.0, 3.0, 4.0])).tolist() == [1.5, 2.5, 3.5, 4.5]
    assert arm.calls[-1] == ("write", [1.0, 2.0, 3.0, 4.0], 1_000_000), "counted from where the read began"
    assert driver.times.write == 1_000_000
    assert driver.health().stamp_ns == 6_000_000


def test_what_servos_without_torque_do_is_no_fault(made: Callable[..., Made]) -> None:
    driver, arm, _ = made(torque=False)
    arm.found = [DxlServoFault(FaultCause.TORQUE_LOST, servo_id=1, joint="waist", found="", expected="")]
    assert driver.read() is STATE
    assert "faults" not in arm.calls


def test_a_fault_goes_before_a_stale_joint_and_carries_the_state(made: Callable[..., Made]) -> None:
    driver, arm, _ = made()
    arm.found = [
        DxlServoFault(cause, servo_id=i, joint="elbow", found="", expected="")
        for i, cause in enumerate((FaultCause.SILENT, FaultCause.NO_EFFECT))
    ]
    arm.reading = Reading(STATE, ["elbow"], False, [])
    with pytest.raises(DxlServoFault, match="does not answer") as caught:
        driver.read()
    assert caught.value.state is STATE
    assert len(driver.faults) == 2


@pytest.mark.parametrize(
    ("jumped", "late", "damaged", "reason"),
    [
        (True, True, True, "a position it cannot have reached"),
        (False, True, True, "only a late reply to an earlier request"),
        (False, False, True, "a damaged reply"),
        (False, False, False, "no reply"),
    ],
)
def test_why_a_joint_is_stale(made: Callable[..., Made], jumped: bool, late: bool, damaged: bool, reason: str) -> None:
    driver, arm, _ = made()
    arm.cycle = CycleRows(5, [*ROWS[:3], None, *ROWS[4:]], b"", late, damaged)
    arm.reading = Reading(STATE, ["elbow"], jumped, [])
    with pytest.raises(StaleJointsError) as caught:
        driver.read()
    assert caught.value.found == f"{reason} from servo 4 (joint elbow)"
    assert (caught.value.joints, caught.value.servo_ids) == (("elbow",), (4,))
    assert caught.value.partial is STATE


def test_a_state_with_nothing_fresh_is_none(made: Callable[..., Made]) -> None:
    driver, arm, _ = made()
    arm.reading = Reading(STATE, ["shoulder", "elbow", "wrist_angle"], False, [])
    with pytest.raises(StaleJointsError) as caught:
        driver.read()
    assert caught.value.partial is STATE
    arm.reading = Reading(STATE, ["shoulder", "elbow", "wrist_angle", "wrist_rotate"], False, [])
    with pytest.raises(StaleJointsError) as caught:
        driver.read()
    assert caught.value.partial is None


def test_a_request_that_the_port_does_not_take_makes_every_joint_stale(made: Callable[..., Made]) -> None:
    driver, arm, _ = made()
    arm.error = WriteTimeoutError("port", found="", expected="", remedy="")
    with pytest.raises(StaleJointsError, match="no answer, for the port took no request, from servo 1, 2") as caught:
        driver.read()
    assert caught.value.joints == ("shoulder", "elbow", "wrist_angle", "wrist_rotate")
    assert caught.value.servo_ids == (1, 2, 3, 4, 5, 6, 7)
    assert caught.value.partial is None
    arm.error = PortLostError("port", found="", expected="", remedy="")
    with pytest.raises(PortLostError):
        driver.read()


@pytest.mark.parametrize("bad", [[0.0] * 3, [0.0] * 5, [0.0, np.nan, 0.0, 0.0], [0.0, 0.0, 0.0, -np.inf]])
def test_torques_that_are_none_are_refused_before_anything_is_sent(made: Callable[..., Made], bad: list[float]) -> None:
    driver, arm, _ = made()
    with pytest.raises(TorqueError, match="arm left: torque") as caught:
        driver.write(np.array(bad))
    assert caught.value.expected == "4 finite numbers"
    assert str(caught.value.found) == str(bad)
    assert arm.calls == []
