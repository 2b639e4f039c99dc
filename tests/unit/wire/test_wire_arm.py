"""Servos on joints: directions, zeros, pairs, and physics that keeps up with the clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from agent.config.cell import load_arm_file
from agent.config.servo_map import resting_joints
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import Instruction, OperatingMode
from drivers.dynamixel.servo.counts import TICK_CENTRE, TICK_RAD
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import CATCH_UP_NS, EmulatedCell
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, baud_code, servo_eeprom, wire_arm
from sim_backend.wire.world import FreeJoint
from tests.support.servos.wire_bench import MS, Bench, build, word

KT = SERVOS["XM430-W350"].torque_constant_Nm_per_A


@dataclass(frozen=True, slots=True)
class JointData:
    name: str
    servo: str
    ids: Sequence[int]
    reverse: Sequence[bool]
    zero_tick: int = TICK_CENTRE
    position_limit_ticks: tuple[int, int] = (0, 4095)


class FreeWorld:
    """Arms of independent joints."""

    def __init__(self, arms: Sequence[Sequence[FreeJoint]]) -> None:
        self.substep_s = 1e-3
        self.joints = [list(joints) for joints in arms]
        self._tau = [[0.0] * len(joints) for joints in arms]

    def state(self, arm: int) -> tuple[Sequence[float], Sequence[float]]:
        joints = self.joints[arm]
        return [joint.q_rad for joint in joints], [joint.dq_rad_per_s for joint in joints]

    def apply(self, arm: int, tau_Nm: Sequence[float]) -> None:
        self._tau[arm] = list(tau_Nm)

    def advance(self) -> None:
        for joints, torques in zip(self.joints, self._tau, strict=True):
            for joint, tau_Nm in zip(joints, torques, strict=True):
                joint.step(tau_Nm, self.substep_s)


SHOULDER = JointData("shoulder", "XM430-W350", (2, 3), (False, True))
ELBOW = JointData("elbow", "XM430-W350", (4,), (True,), 2148)
GRIPPER = JointData("gripper", "XL430-W250", (7,), (False,))


def bench_of(arm: EmulatedArm) -> Bench:
    bench = Bench(*arm.bus.servos)
    bench.bus = arm.bus
    bench.baud = 1_000_000
    return bench


def make(
    q: Sequence[float] = (0.0, 0.0), entries: Sequence[JointData] = (SHOULDER, ELBOW, GRIPPER)
) -> tuple[EmulatedCell, FreeWorld, Bench]:
    wiring = wire_arm("left", entries, ("shoulder", "elbow"), baud=1_000_000, plant_arm=0)
    world = FreeWorld([[FreeJoint(q_rad=x, inertia_kg_m2=0.02) for x in q]])
    arm = EmulatedArm(wiring)
    cell = EmulatedCell([arm], world)
    return cell, world, bench_of(arm)


def test_all_servos_of_a_joint_report_its_angle_whatever_their_direction() -> None:
    _, _, bench = make((100 * TICK_RAD, -50 * TICK_RAD))
    assert [bench.read(i, table.PRESENT_POSITION) for i in (2, 3, 4)] == [2148, 2148, 2098]


@pytest.mark.parametrize("zero_tick", [0, 1024, 2048, 3000, 4095])
@pytest.mark.parametrize("reverse", [False, True])
def test_zero_tick_is_what_is_read_at_zero_radians(zero_tick: int, reverse: bool) -> None:
    entry = JointData("shoulder", "XM430-W350", (2,), (reverse,), zero_tick)
    _, _, bench = make((0.0,), (entry,))
    assert bench.read(2, table.PRESENT_POSITION) == zero_tick


def test_wrong_drive_mode_turns_the_reading_around() -> None:
    _, _, bench = make((100 * TICK_RAD, 0.0))
    bench.write(3, table.DRIVE_MODE, 0)
    assert bench.read(3, table.PRESENT_POSITION) == 1948


def test_servos_of_a_joint_add_their_torques() -> None:
    cell, world, bench = make()
    for servo_id in (2, 3):
        bench.write(servo_id, table.OPERATING_MODE, OperatingMode.CURRENT)
    bench.sync_write(table.GOAL_CURRENT, {2: 100})
    bench.write(2, table.TORQUE_ENABLE, 1)
    assert bench.read(3, table.TORQUE_ENABLE) == 1, "the shadow follows its leader"
    cell.advance_to(10 * MS)
    expected = 2 * 0.269 * KT / 0.02 * 0.010
    assert world.joints[0][0].dq_rad_per_s == pytest.approx(expected, rel=0.01)


def test_pair_fights_itself_when_one_has_the_wrong_direction() -> None:
    cell, world, bench = make()
    bench.write(3, table.DRIVE_MODE, 0)
    for servo_id in (2, 3):
        bench.write(servo_id, table.OPERATING_MODE, OperatingMode.CURRENT)
    bench.sync_write(table.GOAL_CURRENT, {2: 100})
    bench.write(2, table.TORQUE_ENABLE, 1)
    cell.advance_to(10 * MS)
    assert world.joints[0][0].dq_rad_per_s == pytest.approx(0.0, abs=1e-9)


def test_joint_of_no_plant_moves_by_itself() -> None:
    cell, world, bench = make()
    bench.write(7, table.OPERATING_MODE, OperatingMode.PWM)
    bench.write(7, table.GOAL_PWM, 300)
    bench.write(7, table.TORQUE_ENABLE, 1)
    cell.advance_to(200 * MS)
    assert bench.read(7, table.PRESENT_POSITION) > 2060
    assert world.joints[0][0].q_rad == 0.0


def test_reading_is_taken_at_its_own_instant_between_two_substeps() -> None:
    cell, world, bench = make()
    world.joints[0][0].dq_rad_per_s = 10.0
    cell.advance_to(5 * MS + 600_000)
    assert bench.read(2, table.PRESENT_POSITION) == round(0.056 / TICK_RAD) + 2048


def test_physics_keeps_up_with_the_clock_in_whole_substeps() -> None:
    cell, _, _ = make()
    for now_us in (300, 900, 1500, 1600, 7999, 8000):
        cell.advance_to(now_us * 1000)
    assert cell.counters.substeps == 8
    assert cell.time_ns == 8 * MS


def test_time_the_host_could_not_keep_is_let_go_and_counted() -> None:
    cell, _, _ = make()
    cell.advance_to(CATCH_UP_NS + 300 * MS)
    assert cell.counters.skipped_ns == 300 * MS
    assert cell.counters.substeps == CATCH_UP_NS // MS


def test_position_hold_carries_a_gravity_load() -> None:
    cell, world, bench = make((math.pi / 2, 0.0))
    world.joints[0][0].gravity_Nm = 1.0
    bench.write(2, table.TORQUE_ENABLE, 1)
    cell.advance_to(2_000 * MS)
    assert world.joints[0][0].q_rad == pytest.approx(math.pi / 2, abs=20 * TICK_RAD)


def test_free_joint_with_friction_comes_to_rest_at_any_step() -> None:
    for dt_s in (1e-4, 1e-3, 1e-2, 0.1):
        joint = FreeJoint(dq_rad_per_s=3.0, inertia_kg_m2=1e-4, coulomb_Nm=0.2, viscous_Nm_s_per_rad=0.3)
        speeds = []
        for _ in range(100):
            joint.step(0.0, dt_s)
            speeds.append(abs(joint.dq_rad_per_s))
        assert speeds == sorted(speeds, reverse=True)


def test_unknown_speed_is_refused() -> None:
    with pytest.raises(ValueError, match="servos know"):
        baud_code(500_000)


def test_two_arms_have_their_own_buses() -> None:
    eeprom = servo_eeprom(baud=1_000_000)
    arms = [
        EmulatedArm(ArmWiring(name, (JointWiring("j", (ServoWiring(1, "XM430-W350", eeprom=eeprom),)),)))
        for name in ("left", "right")
    ]
    EmulatedCell(arms, None)
    arms[0].bus.receive(build(1, Instruction.WRITE, word(65) + b"\1"), 0, 1_000_000)
    assert [arm.servo(1).firmware.memory.get(table.LED) for arm in arms] == [1, 0]


@pytest.mark.parametrize("model", ["wx200", "wx250s", "awx250s"])
def test_joints_of_no_plant_have_the_friction_of_their_own_servos(model: str) -> None:
    """The figures of the arm file, which are rounded, for joints; a gripper's are scaled from them by its servo."""
    file, _ = load_arm_file(model, "test")
    wired = wire_arm("left", resting_joints(file), [], baud=file.baud, plant_arm=None)
    friction = {joint.name: (joint.coulomb_Nm, joint.viscous_Nm_s_per_rad) for joint in wired.joints}
    for joint in file.joints:
        coulomb_Nm, viscous = friction[joint.name]
        assert coulomb_Nm == pytest.approx(joint.coulomb_Nm.value, rel=0.1)
        assert viscous == pytest.approx(joint.viscous_Nm_s_per_rad.value, rel=0.25)
    stall = SERVOS[file.gripper.servo].stall_torque_Nm
    assert friction["gripper"] == pytest.approx((0.1 * stall / 4.1, 0.05 * stall / 4.1))
    free = next(joint.free for joint in EmulatedArm(wired).joints if joint.name == "gripper")
    assert free is not None
    assert (free.coulomb_Nm, free.viscous_Nm_s_per_rad) == friction["gripper"]
