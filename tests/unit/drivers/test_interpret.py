"""From one cycle's rows to the state of the joints: which servo counts, what is missing, what each check is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.cycle import CycleRows
from drivers.dynamixel.errors import FaultCause
from drivers.dynamixel.events import DriverEvent, OncePerServo
from drivers.dynamixel.interpret import SPEED_LASTS_CYCLES, Interpreter, Reading, servo_names
from drivers.dynamixel.line.group import Row
from drivers.dynamixel.servo.torque import torque_drive
from tests.support.servos.dxl_rig import WX200, at

TICK_RAD, SPEED_UNIT = 2.0 * np.pi / 4096, 0.229 * 2.0 * np.pi / 60.0
XM_Nm = torque_drive(WX200.controlled[1]).measured_Nm([1], 0.0)  # of one count
PLACES = {2: 1, 3: 2, 4: 3, 5: 4, 6: 5}  # of servo IDs in the arm's slots; 1 is held, 7 the gripper
ZEROS = [0] * 7


def rows(**changes: Row | None) -> list[Row | None]:
    """Rows of all seven servos; s2=… replaces servo 2's."""
    made: list[Row | None] = [(0, 10 * i, i, 2048 + i) for i in range(1, 8)]
    for name, row in changes.items():
        made[int(name[1:]) - 1] = row
    return made


class Bench:
    """An interpreter and what it told."""

    def __init__(self, arm: ArmMap = WX200) -> None:
        self.events: list[DriverEvent] = []
        drives = [torque_drive(joint) for joint in arm.controlled]
        self.interpreter = Interpreter(arm, drives, OncePerServo(self.events.append))
        self.stamp_ns = 1_000_000_000

    def read(
        self, cycle: list[Row | None], goals: list[int] | None = None, *, late: bool = False, damaged: bool = False
    ) -> Reading:
        self.stamp_ns += 5_000_000
        return self.interpreter.read(CycleRows(self.stamp_ns, cycle, b"", late, damaged), goals or ZEROS)


def test_the_speed_of_a_joint_that_nobody_sees_lasts_for_three_cycles() -> None:
    """For its back-EMF: with an older one a motor would go on pushing a joint that has stopped."""
    bench = Bench()
    assert SPEED_LASTS_CYCLES == 3
    for _ in range(2):  # counted anew each time
        speeds = bench.read(rows()).state.dq
        seen = [list(bench.interpreter.dq)] + [
            (bench.read(rows(s4=None)), list(bench.interpreter.dq))[1] for _ in range(SPEED_LASTS_CYCLES + 1)
        ]
        assert [dq[1] for dq in seen] == [speeds[1]] * (SPEED_LASTS_CYCLES + 1) + [0.0]
        assert [dq[2] for dq in seen] == [speeds[2]] * (SPEED_LASTS_CYCLES + 2), "the others are seen"


def test_a_joint_whose_encoder_jumps_is_not_seen_either() -> None:
    bench = Bench()
    bench.read(rows())
    for _ in range(SPEED_LASTS_CYCLES + 1):
        bench.read(rows(s4=(0, 40, 4, 4000)))
    assert bench.interpreter.dq[1] == 0.0


def test_each_joint_is_read_from_the_servo_that_is_followed() -> None:
    bench = Bench()
    reading = bench.read(rows())
    assert reading.state.stamp_ns == bench.stamp_ns
    np.testing.assert_allclose(reading.state.q, np.array([2, 4, 5, 6]) * TICK_RAD, atol=1e-12)
    np.testing.assert_allclose(reading.state.dq, np.array([2, 4, 5, 6]) * SPEED_UNIT, atol=1e-12)
    assert bench.interpreter.dq == reading.state.dq.tolist()
    np.testing.assert_allclose(reading.state.tau[:3], XM_Nm * np.array([20 + 30, 40, 50]), atol=1e-12)
    assert np.isnan(reading.state.tau[3]), "a servo without a current sensor says nothing of torque"
    assert (reading.stale, reading.jumped, reading.faults) == ([], False, [])


def test_a_joint_that_never_answered_is_taken_to_stand_still() -> None:
    bench = Bench()
    bench.read(rows(s4=None))
    assert bench.interpreter.dq[1] == 0.0


def test_a_joint_without_a_row_is_stale_and_the_others_are_not() -> None:
    bench = Bench()
    bench.read(rows())
    reading = bench.read(rows(s4=None))
    assert reading.stale == ["elbow"]
    for values in (reading.state.q, reading.state.dq, reading.state.tau):
        assert np.isnan(values[1])
        assert np.isfinite(values[[0, 2]]).all()
    assert bench.interpreter.dq[1] == pytest.approx(4 * SPEED_UNIT), "the last one known, for the back-EMF"


@pytest.mark.parametrize(("servo", "stale"), [("s3", []), ("s2", ["shoulder"]), ("s1", []), ("s7", [])])
def test_only_the_servo_that_is_followed_makes_a_joint_stale(servo: str, stale: list[str]) -> None:
    reading = Bench().read(rows(**{servo: None}))
    assert reading.stale == stale
    assert np.isnan(reading.state.tau[0]) == (servo in ("s2", "s3")), "half a torque is no torque"
    assert reading.jumped is False


def test_a_position_that_cannot_be_is_stale_once_and_a_fault_twice() -> None:
    bench = Bench()
    bench.read(rows())
    far = (0, 40, 4, 2048 + 500)
    reading = bench.read(rows(s4=far))
    assert (reading.stale, reading.jumped, reading.faults) == (["elbow"], True, [])
    assert np.isnan(reading.state.q[1])
    (fault,) = bench.read(rows(s4=far)).faults
    assert (fault.cause, fault.servo_id) == (FaultCause.POSITION_JUMP, 4)
    assert fault.found == f"a step to {500 * TICK_RAD:.3f} rad, 2 times in a row"
    reading = bench.read(rows())
    assert (reading.stale, reading.jumped, reading.faults) == ([], False, [])


@pytest.mark.fault("S5")
@pytest.mark.parametrize("sign", [1, -1])
def test_a_speed_that_cannot_be_is_stale_once_and_a_fault_twice_and_no_torque_is_made_of_it(sign: int) -> None:
    """Of an intact answer; the position beside it is as it was, and is believed again with the next."""
    bench = Bench()
    most = 1.6 * WX200.slots[3].model.no_load_rad_per_s
    bench.read(rows(s4=(0, 40, sign * int(most / SPEED_UNIT), 2052)))
    assert bench.interpreter.dq[1] == pytest.approx(sign * most, rel=0.01)
    beyond = (0, 40, sign * (int(most / SPEED_UNIT) + 1), 2052)
    reading = bench.read(rows(s4=beyond))
    assert (reading.stale, reading.jumped, reading.faults) == (["elbow"], True, [])
    assert np.isnan([reading.state.q[1], reading.state.dq[1], reading.state.tau[1]]).all()
    (fault,) = bench.read(rows(s4=(0, 40, sign * (2**31 - 1), 2052))).faults
    assert (fault.cause, fault.servo_id) == (FaultCause.POSITION_JUMP, 4)
    assert fault.found == f"a speed of {sign * (2**31 - 1) * SPEED_UNIT:.3g} rad/s, 2 times in a row"
    assert fault.expected == f"at most {most:.1f} rad/s"
    assert bench.interpreter.doubted() is not None
    reading = bench.read(rows())
    assert (reading.stale, reading.jumped, reading.faults) == ([], False, [])
    assert bench.interpreter.doubted() is None


def test_a_joint_that_jumps_keeps_its_last_speed_and_does_not_hide_the_joints_after_it() -> None:
    bench = Bench()
    bench.read(rows())
    reading = bench.read(rows(s2=(0, 20, 99, 3000)))
    assert bench.interpreter.dq[0] == pytest.approx(2 * SPEED_UNIT)
    assert np.isfinite(reading.state.q[1:]).all()


def test_an_arm_whose_whole_line_may_stall_is_borne_for_that_long() -> None:
    whole, alone = [None] * 7, rows(s4=None)
    for patience, cycle, borne in ((20, whole, 27), (0, whole, 7), (20, alone, 7)):
        bench = Bench(replace(WX200, line_patience_cycles=patience))
        assert not any(bench.read(cycle).faults for _ in range(borne))
        assert bench.read(cycle).faults


def test_a_servo_that_stays_silent_is_a_fault_with_what_came_instead() -> None:
    for late, damaged, cause in ((False, False, "SILENT"), (True, False, "OUTDATED"), (False, True, "GARBLED")):
        bench = Bench()
        faults = [bench.read(rows(s7=None), late=late, damaged=damaged).faults for _ in range(8)]
        assert faults[:7] == [[]] * 7
        assert [(fault.cause.name, fault.servo_id) for fault in faults[7]] == [(cause, 7)]


@pytest.mark.parametrize("servo", [2, 3, 4, 5])
def test_goals_are_held_against_the_current_of_the_servo_they_were_sent_to(servo: int) -> None:
    bench = Bench()
    goals = [300 if place == PLACES[servo] else 0 for place in range(7)]
    still = {f"s{i}": (0, 0, 0, 2048) for i in range(1, 8)}
    faults = [bench.read(rows(**still), goals).faults for _ in range(8)]
    assert faults[:7] == [[]] * 7
    assert [(fault.cause, fault.servo_id) for fault in faults[7]] == [(FaultCause.NO_EFFECT, servo)]
    assert bench.read(rows(**still | {f"s{servo}": None}), goals).faults == [], "nothing to compare"


def test_a_part_of_its_goal_is_told_of_the_servo_it_was_sent_to_and_is_no_fault() -> None:
    bench = Bench()
    goals = [300 if place == PLACES[3] else 0 for place in range(7)]
    assert all(bench.read(rows(s3=(0, 30, 0, 2048)), goals).faults == [] for _ in range(99))
    assert bench.read(rows(s3=None), goals).faults == [], "nothing to compare"
    assert bench.events == []
    bench.read(rows(s3=(0, 30, 0, 2048)), goals)
    assert [(event.kind.name, event.servo_id) for event in bench.events] == [("PART_OF_CURRENT", 3)]


def test_servos_of_one_joint_are_compared_when_both_answer() -> None:
    bench = Bench()
    fight = {"s2": (0, 300, 0, 2048), "s3": (0, -300, 0, 2048)}
    for _ in range(19):
        bench.read(rows(**fight))
    bench.read(rows(**fight | {"s3": None}))
    bench.read(rows(**fight | {"s2": None}))
    assert bench.events == []
    bench.read(rows(**fight))
    assert [(event.kind.name, event.servo_id) for event in bench.events] == [("PAIR_FIGHTING", 3)]


def test_an_arm_without_pairs_has_none_to_compare() -> None:
    single = tuple(replace(joint, ids=joint.ids[:1], reverse=joint.reverse[:1]) for joint in WX200.joints)
    bench = Bench(at(WX200, joints=single))
    seven = rows()
    for _ in range(30):
        bench.read([*seven[:2], *seven[3:]], [0] * 6)
    assert bench.events == []


def test_names_of_servos_without_a_row() -> None:
    assert servo_names(WX200.slots, rows(s3=None, s7=None)) == [3, 7]
