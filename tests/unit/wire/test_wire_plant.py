"""Emulated servos on the closed chain: what is written is torque in the physics, what is read is quantised physics."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.build import build_plant
from sim_backend.physics.calendar import Limpness
from sim_backend.physics.plant import Plant
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.plant_world import PlantWorld, emulate, without_servo_electronics
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, servo_eeprom
from tests.support.plant.plant_cells import PLANAR_JOINTS, planar_cell
from tests.support.servos.wire_bench import MS, Bench

XM = SERVOS["XM430-W350"]
NM_PER_COUNT = 2.69e-3 * XM.torque_constant_Nm_per_A
GOALS = {1: 300, 2: 150, 3: 40}  # counts of goal current


def start(*, supported: bool) -> tuple[EmulatedCell, PlantWorld, list[Bench]]:
    wirings = []
    for place, name in enumerate(("left", "right")):
        joints = tuple(
            JointWiring(joint, (ServoWiring(i + 1, XM.name, eeprom=servo_eeprom(baud=57_600)),), i)
            for i, joint in enumerate(PLANAR_JOINTS)
        )
        wirings.append(ArmWiring(name, joints, 57_600, place))
    cell, world = emulate(planar_cell(), wirings, timing=None, supported=supported)
    benches = []
    for arm in cell.arms:
        bench = Bench(*arm.bus.servos)
        bench.bus = arm.bus
        benches.append(bench)
    return cell, world, benches


def torque_on(bench: Bench) -> None:
    for servo_id in GOALS:
        bench.write(servo_id, table.OPERATING_MODE, OperatingMode.CURRENT)
        bench.write(servo_id, table.GOAL_CURRENT, 0)
        bench.write(servo_id, table.TORQUE_ENABLE, 1)


def test_goal_currents_move_the_chain_as_their_torques_do() -> None:
    cell, world, benches = start(supported=False)
    for bench in benches:
        torque_on(bench)
        bench.sync_write(table.GOAL_CURRENT, GOALS)
    cell.advance_to(50 * MS)
    twin = Plant(planar_cell())
    twin.advance(np.array([count * NM_PER_COUNT for count in GOALS.values()] * 2), 50)
    assert np.allclose(world.plant.q, twin.q, atol=1e-9)
    assert np.allclose(world.plant.dq, twin.dq, atol=1e-7)


def test_present_registers_are_the_physics_on_their_grids() -> None:
    cell, world, benches = start(supported=False)
    cell.advance_to(40 * MS)
    q, dq = world.state(1)
    for i in range(3):
        assert benches[1].read(i + 1, table.PRESENT_POSITION) == 2048 + round(q[i] / TICK_RAD)
        assert benches[1].read(i + 1, table.PRESENT_VELOCITY) == round(dq[i] / VELOCITY_UNIT_RAD_PER_S)


def test_cell_rests_on_its_support_until_every_arm_gives_torque() -> None:
    cell, world, benches = start(supported=True)
    q_start = world.plant.q
    cell.advance_to(100 * MS)
    torque_on(benches[0])
    benches[0].sync_write(table.GOAL_CURRENT, GOALS)
    torque_on(benches[1])
    cell.advance_to(200 * MS)
    assert world.supported
    assert np.array_equal(world.plant.q, q_start)
    benches[1].sync_write(table.GOAL_CURRENT, GOALS)
    cell.advance_to(210 * MS)
    assert not world.supported
    assert not np.array_equal(world.plant.q, q_start)
    assert world.observe().t == pytest.approx(0.21)


def test_watchdogs_of_dead_clients_take_the_torque_from_the_chain() -> None:
    cell, world, benches = start(supported=False)
    for bench in benches:
        bench.now_ns = 0
        torque_on(bench)
        bench.sync_write(table.GOAL_CURRENT, GOALS)
        for servo_id in GOALS:
            bench.write(servo_id, table.BUS_WATCHDOG, 1)
    seen = []
    for now_ms in range(1, 30):
        cell.advance_to(now_ms * MS)
        seen.append(bool(np.any(world.tau_Nm)))
        for arm in cell.arms:
            arm.bus.tick(now_ms * MS)
    assert seen == [True] * 21 + [False] * 8
    assert [arm.bus.counters.watchdog_trips for arm in cell.arms] == [3, 3]


def test_servos_bring_their_electronics_and_the_plant_keeps_its_friction() -> None:
    servos = ActuatorSpec.of(
        3, delay_s=0.01, tau_max_Nm=4.0, torque_lsb_Nm=0.005, torque_scale=1.1, stall_Nm=4.1, no_load_rad_s=4.8,
        coulomb_Nm=0.1, viscous_Nms_rad=0.05, position_lsb_rad=0.0015, velocity_lsb_rad_s=0.024,
    )  # fmt: skip
    bare = without_servo_electronics(planar_cell(servos)).arms[0].actuator
    assert bare.delay_s == 0.0
    assert math.isinf(bare.stall_Nm[0])
    assert math.isinf(bare.tau_max_Nm[0])
    assert (bare.position_lsb_rad, bare.velocity_lsb_rad_s, bare.torque_lsb_Nm[0]) == (0.0, 0.0, 0.0)
    assert (bare.coulomb_Nm[0], bare.viscous_Nms_rad[0], bare.torque_scale[0]) == (0.1, 0.05, 1.1)


def test_servos_of_a_limp_arm_move_nothing_from_its_instant_on() -> None:
    spec = replace(without_servo_electronics(planar_cell()), happenings=(Limpness(0.003, "right"),))
    world, tau = PlantWorld(build_plant(spec), supported=False), [0.02, 0.01, 0.01]
    given = []
    for _ in range(5):
        for arm in (0, 1):
            world.apply(arm, tau)
        given.append(world.observe().tau_applied)
        world.advance()
    assert [g[3:].tolist() for g in given] == [tau, tau, tau, [0.0] * 3, [0.0] * 3]
    assert all(g[:3].tolist() == tau for g in given)
    twin = Plant(replace(spec, happenings=()))
    twin.advance(np.array(tau * 2), 3)
    twin.advance(np.array([*tau, 0.0, 0.0, 0.0]), 2)
    assert np.array_equal(world.plant.q, twin.q), "those of the other go on"
