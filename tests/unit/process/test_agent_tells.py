"""What an agent tells: health once a second (none of a driver without servos), events on the clock of its rows."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.process.tellers import ServoTeller, SetClock, Teller
from agent.telemetry.ring.texts import TextReader, TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.health import Health
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Kind
from drivers.interface import GripState, ServoHealth
from tests.support.servos import dxl_rig

OFFSET_NS = 1_700_000_000_000_000_000


def told(ring: Path, driver: Any, beats: int, rate_hz: float) -> list[Health]:
    writer = TextWriter(ring, "left")
    with RingWriter(ring, AGENT_STATE, "left", ("waist",)):
        servos = ServoTeller(driver, writer, OFFSET_NS, rate_hz)
        for _ in range(beats):
            servos.beat()
        found = TextReader(ring).read_new()
    writer.close()
    assert {kind for kind, _ in found} <= {Kind.HEALTH}
    return [Health.from_json(text) for _, text in found]


def test_what_the_driver_read_in_its_gaps_is_told_once_in_so_many_cycles(tmp_path: Path) -> None:
    rig = dxl_rig.build(dxl_rig.PLANAR)
    rig.driver.connect()
    rig.driver.enable()
    rig.driver.read()
    found = told(tmp_path / "ring", rig.driver, 401, 200)
    assert len(found) == 2
    slots = rig.arm.slots
    assert 0 <= OFFSET_NS + rig.clock.now_ns() - found[0].utc_ns < 1_000_000
    assert found[0].servo_id == tuple(slot.servo_id for slot in slots)
    assert found[0].joint == tuple(slot.joint.name for slot in slots)
    assert found[0].temperature_C == (25.0,) * len(slots)
    np.testing.assert_allclose(found[0].voltage_V, 12.0)
    senses = [slot.model.current_unit_mA is not None for slot in slots]
    assert [not np.isnan(x) for x in found[0].current_A] == senses
    assert [np.isnan(x) for x in found[0].load] == senses


class Gripping:
    """A driver with a servo and a gripper."""

    def health(self) -> ServoHealth:
        one = np.ones(1)
        return ServoHealth(
            5, (7,), ("gripper",), one, one, np.zeros(1, np.uint8), *[one] * 6, slow_ns=np.zeros(1, np.int64)
        )

    def grip(self, width_m: float) -> None: ...

    def grip_state(self) -> GripState:
        return GripState(5, 0.0439, 0.0, 0.2, 8.26, 0.03, 9.1)


def test_a_gripper_is_told_with_the_servos(tmp_path: Path) -> None:
    [found] = told(tmp_path / "ring", Gripping(), 200, 200)
    assert (found.grip_width_m, found.grip_width_cmd_m) == (0.0439, 0.03)
    assert (found.grip_force_N, found.grip_force_max_N) == (8.3, 9.1)


class Joints:
    """A driver without servos."""

    def health(self) -> ServoHealth:
        return ServoHealth.none(5)


def test_a_driver_without_servos_tells_nothing(tmp_path: Path) -> None:
    assert told(tmp_path / "ring", Joints(), 10, 1) == []


class RunClock:
    """A plant's clock: simulated nanoseconds and where they are in UTC."""

    utc_offset_ns = OFFSET_NS

    def now_ns(self) -> int:
        return 250


def test_an_agents_event_has_the_time_of_its_rows_once_there_is_one(tmp_path: Path) -> None:
    writer = TextWriter(tmp_path / "ring", "left")
    teller: Any = Teller("left", writer)
    begin_ns = time.time_ns()
    teller.event(Level.INFO, "before")
    teller.clock = RunClock()
    teller.event(Level.INFO, "torque on", priority=3)
    before, on = (Event.from_json(text) for _, text in TextReader(tmp_path / "ring").read_new())
    writer.close()
    assert begin_ns <= before.utc_ns <= time.time_ns()
    assert before.data == {}
    assert (on.utc_ns, on.data) == (OFFSET_NS + 250, {"stamp_ns": 250, "priority": 3})


@pytest.mark.fault("C3")
def test_a_wall_clock_that_is_set_is_told_once_and_a_slow_correction_is_not(tmp_path: Path) -> None:
    texts, offset_ns = TextWriter(tmp_path / "ring", "left"), [OFFSET_NS]
    with RingWriter(tmp_path / "ring", AGENT_STATE, "left", ("waist",)):
        clock = SimpleNamespace(utc_offset_ns=OFFSET_NS, now_ns=lambda: 7)
        tell = Teller("left", texts)
        tell.clock = clock  # type: ignore[assignment]
        wall = SetClock(tell, clock, 200.0, lambda: offset_ns[0])  # type: ignore[arg-type]
        for step_ns in (0, 900_000, -900_000, 1_100_000, 0, -3_600 * 10**9):
            offset_ns[0] += step_ns
            for _ in range(200):
                wall.beat()
        offset_ns[0] += 10**9
        for _ in range(199):
            wall.beat()
        found = [Event.from_json(text) for _, text in TextReader(tmp_path / "ring").read_new()]
    texts.close()
    assert [event.text for event in found] == [
        "the wall clock was set by +0.0011 s",
        "the wall clock was set by -3.6e+03 s",
    ]
    assert [event.data["step_s"] for event in found] == pytest.approx([1.1e-3, -3600.0])
    assert {event.utc_ns for event in found} == {OFFSET_NS + 7}, "in the time of the rows"
