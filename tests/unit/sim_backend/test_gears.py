"""Backlash: what a motor does in its gap, that no momentum is lost, and that plants and emulated servos have it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.reality import draw
from agent.config.schema.reality import ArmReality as Entry
from agent.config.schema.reality import Reality as Given
from agent.process.simulated import plant_spec
from agent.study.lab import Laboratory, Run
from agent.study.measure import measure
from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorError, ActuatorSpec
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.physics.free_arm import FreeArms
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.gears import LEAST_INERTIA, Gears, gears
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.lone import LoneArm
from sim_backend.physics.plant import Plant
from sim_backend.physics.reality import ArmReality, Reality, realised
from sim_backend.physics.spec import GraspSpec, PlantError, PlantSpec
from sim_backend.wire.plant_world import PlantWorld, without_servo_electronics
from tests.support.plant.plant_cells import planar_cell
from tests.support.plant.served_plant import SERVOS
from tests.support.starts import start_joints

H = 1e-3
GAP = 1e-3


def gear(gap: float = GAP, inertia: float = 0.01) -> Gears:
    return Gears(np.array([gap]), np.array([inertia]), H)


class Mechanism:
    """Joints of a mass matrix without rotors, moved through their gears; all gaps begin closed backwards."""

    def __init__(self, M: list[list[float]], rotors: list[float], gaps: list[float]) -> None:
        self.M, self.gears = np.array(M), Gears(np.array(gaps), np.array(rotors), H)
        self.gears.x = -0.5 * np.array(gaps)
        self.dq = np.zeros(len(gaps))
        self.blows = 0

    def _accelerated(self, torque: Vector) -> Vector:
        return np.linalg.solve(self.M + np.diag(self.gears.inertia), torque)

    def advance(self, motor: list[float], outside: list[float] | None = None) -> None:
        g, tau = self.gears, np.array(motor)
        if g.meets:
            self.blows += 1
            self.dq = self.dq + g.meet(self.dq, self._accelerated)[0]
        a = self._accelerated(g.passed(tau) + (0.0 if outside is None else np.array(outside)))
        self.dq = self.dq + H * a
        g.step(tau, self.dq, a)

    @property
    def energy(self) -> float:
        M = self.M + np.diag(self.gears.inertia)
        return float(0.5 * self.dq @ M @ self.dq) + self.gears.energy


@pytest.mark.parametrize(("whole", "speed"), [(0.013, 4.615), (0.02, 3.0), (0.05, 1.2)])
def test_all_that_a_motor_pushes_reaches_its_joint_in_one_blow(whole: float, speed: float) -> None:
    joint = Mechanism([[whole - 0.012]], [0.012], [5.76e-3])
    for _ in range(300):
        joint.advance([0.2])
    assert joint.dq[0] == pytest.approx(0.3 * 0.2 / whole, rel=1e-12)
    assert joint.dq[0] == pytest.approx(speed, abs=5e-4)
    assert joint.blows == 1


def test_a_motor_crosses_its_gap_alone_and_the_joint_is_without_its_inertia_meanwhile() -> None:
    joint = Mechanism([[0.001]], [0.012], [5.76e-3])
    taken = 0
    while not joint.gears.meets:
        joint.advance([0.2])
        taken += 1
        assert joint.dq[0] == 0.0
        assert joint.gears.inertia[0] == 0.0
        assert joint.gears.speed[0] == pytest.approx(taken * H * 0.2 / 0.012)
        assert joint.energy == pytest.approx(0.5 * 0.012 * joint.gears.speed[0] ** 2)
        assert joint.gears.x[0] == pytest.approx(min(2.88e-3, -2.88e-3 + 0.1 * (taken * H) ** 2 / 0.012))
    assert taken * H == pytest.approx(np.sqrt(2.0 * 5.76e-3 * 0.012 / 0.2), abs=H)
    joint.advance([0.2])
    assert joint.gears.inertia[0] == 0.012
    assert joint.gears.x[0] == 2.88e-3
    assert joint.gears.speed[0] == joint.dq[0]


def test_a_blow_takes_out_the_energy_of_the_difference_of_speeds_and_no_momentum() -> None:
    joint = Mechanism([[0.004]], [0.012], [GAP])
    joint.gears.speed, joint.dq = np.array([0.5]), np.array([-0.3])
    before = joint.energy
    while not joint.gears.meets:
        joint.advance([0.0])
    assert joint.energy == pytest.approx(before)
    joint.advance([0.0])
    assert joint.dq[0] == pytest.approx((0.012 * 0.5 - 0.004 * 0.3) / 0.016)
    assert before - joint.energy == pytest.approx(0.5 * 0.004 * 0.012 / 0.016 * 0.8**2)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_teeth_push_one_way_only(side: float) -> None:
    joint = Mechanism([[0.004]], [0.012], [GAP])
    for _ in range(60):
        joint.advance([0.1 * side])
    assert joint.gears.inertia[0] == 0.012
    assert joint.gears.x[0] == 0.5 * GAP * side
    joint.advance([0.1 * side], [0.02 * side])  # 7.5 rad/s², where the motor alone would reach 8.3
    joint.advance([0.1 * side], [0.02 * side])
    assert joint.gears.inertia[0] == 0.012
    speed = joint.dq[0]
    joint.advance([0.1 * side], [0.05 * side])  # 9.4 rad/s²
    assert joint.gears.inertia[0] == 0.0, "they part in the next"
    joint.advance([0.1 * side], [0.05 * side])
    assert joint.dq[0] == pytest.approx(speed + side * H * (0.15 / 0.016 + 0.05 / 0.004))
    assert joint.gears.speed[0] == pytest.approx(speed + side * H * (0.15 / 0.016 + 0.1 / 0.012))
    assert abs(joint.gears.x[0]) < 0.5 * GAP
    limp = Mechanism([[0.004]], [0.012], [GAP])
    limp.advance([-0.1])
    while limp.gears.inertia[0] == 0.0:
        limp.advance([-0.1])
    limp.advance([0.0], [-0.1])
    assert limp.gears.inertia[0] == 0.0, "a motor that gives nothing is not dragged along"


def test_a_motor_that_turns_back_before_the_end_of_its_gap_meets_nothing() -> None:
    joint = Mechanism([[0.004]], [0.012], [GAP])
    joint.gears.x, joint.gears.speed = np.array([0.5 * GAP]), np.array([0.01])
    joint.advance([-0.13])
    assert joint.gears.speed[0] < 0.0
    assert joint.gears.x[0] == 0.5 * GAP
    assert not joint.gears.meets


def test_teeth_that_the_blow_of_others_pulls_at_part_unless_their_motor_pushes_more() -> None:
    def struck(coupling: float, push: float) -> tuple[Gears, Vector]:
        """Two joints; the second's teeth are together, the first's meet at 0.5 rad/s; both backwards."""
        two = Mechanism([[0.010, coupling], [coupling, 0.010]], [0.012, 0.012], [GAP, GAP])
        g = two.gears
        g._meshed = np.array([False, True])
        g._share()
        g.speed = np.array([-0.5, 0.0])
        g.step(np.array([0.0, -push]), np.zeros(2), np.zeros(2))
        assert g.meets
        dv, given = g.meet(np.zeros(2), two._accelerated)
        assert given.tolist() == [-0.006, 0.0]
        return g, dv

    for coupling, push in ((0.008, 0.0), (-0.008, 2.0)):  # towards its motor; away from one that pushes
        g, dv = struck(coupling, push)
        np.testing.assert_allclose(np.array([[0.022, coupling], [coupling, 0.022]]) @ dv, [-0.006, 0.0], atol=1e-15)
        assert g.inertia.tolist() == [0.012, 0.012]
        np.testing.assert_allclose(g.speed, dv)
    g, dv = struck(-0.008, 1.0)
    np.testing.assert_allclose(np.array([[0.022, -0.008], [-0.008, 0.010]]) @ dv, [-0.006, 0.0], atol=1e-15)
    assert g.inertia.tolist() == [0.012, 0.0]
    assert g.speed.tolist() == [dv[0], 0.0]


def test_a_blow_is_solved_once_and_again_only_where_teeth_part() -> None:
    two = Mechanism([[0.010, -0.008], [-0.008, 0.010]], [0.012, 0.012], [GAP, 0.0])
    two.gears.speed = np.array([-0.5, 0.0])
    two.gears.step(np.zeros(2), np.zeros(2), np.zeros(2))
    asked: list[Vector] = []

    def jump(given: Vector) -> Vector:
        asked.append(given)
        return two._accelerated(given)

    two.gears.meet(np.zeros(2), jump)
    assert [given.tolist() for given in asked] == [[-0.006, 0.0]]
    assert two.gears.inertia.tolist() == [0.012, 0.012], "a joint without a gap has none to open"
    kept = two.gears.inertia
    two.gears.step(np.array([-0.1, 0.1]), np.zeros(2), np.zeros(2))
    assert two.gears.inertia is kept


def test_a_joint_that_is_pushed_away_in_its_gap_moves_the_end_of_it() -> None:
    joint = Mechanism([[0.004]], [0.012], [GAP])
    joint.gears.x = np.zeros(1)
    for k in range(1, 6):
        joint.advance([0.0], [0.1])
        assert joint.gears.x[0] == pytest.approx(-0.5 * 25.0 * (k * H) ** 2)


def test_at_the_very_end_of_the_gap_teeth_meet_where_the_motor_comes_and_not_where_it_stands() -> None:
    g = gear()
    faster = H * (1.0 / 0.01) * 0.2
    g.x, g.speed = np.array([0.5 * GAP]), np.array([-0.5 * faster])
    g.step(np.array([0.2]), np.zeros(1), np.zeros(1))
    assert g.x[0] == 0.5 * GAP
    assert g.speed[0] > 0.0
    assert g.meets
    g = gear()
    g.x, g.speed = np.array([0.5 * GAP]), np.array([faster])
    g.step(np.array([-0.2]), np.zeros(1), np.zeros(1))
    assert g.speed[0] == 0.0
    assert not g.meets


def test_motors_that_are_told_to_move_along_meet_nothing() -> None:
    joint = Mechanism([[0.004]], [0.012], [GAP])
    while not joint.gears.meets:
        joint.advance([0.2])
    joint.gears.along(np.array([0.3]))
    assert joint.gears.speed.tolist() == [0.3]
    assert not joint.gears.meets
    joint.dq = np.array([0.3])
    joint.advance([0.0])
    assert joint.gears.inertia[0] == 0.0


def test_joints_without_backlash_keep_torque_and_rotor_to_the_bit() -> None:
    g = Gears(np.array([0.0, GAP, 0.0]), np.array([0.01, 0.01, 0.0]), H)
    rng = np.random.default_rng(1)
    for _ in range(50):
        motor, dq, ddq = rng.normal(size=(3, 3))
        assert g.passed(motor)[[0, 2]].tolist() == motor[[0, 2]].tolist()
        assert g.inertia[[0, 2]].tolist() == [0.01, 0.0]
        assert g.ahead_s[[0, 2]].tolist() == [0.5 * H, 0.5 * H]
        g.step(motor, dq, ddq)
        assert g.speed[[0, 2]].tolist() == dq[[0, 2]].tolist()
        assert g.x[[0, 2]].tolist() == [0.0, 0.0]


def test_a_motor_without_inertia_crosses_in_a_substep_and_loses_nothing() -> None:
    joint = Mechanism([[0.01]], [0.0], [GAP])
    for _ in range(100):
        joint.advance([0.1])
    assert joint.dq[0] == pytest.approx(0.1 * 0.1 / (0.01 + LEAST_INERTIA))
    assert LEAST_INERTIA == 1e-5


@pytest.mark.parametrize("pads", [None, GraspSpec(1e5, 100.0)])
def test_both_plants_have_it_and_emulated_servos_keep_it(pads: GraspSpec | None) -> None:
    believed = replace(planar_cell(SERVOS), grasp=pads)
    assert gears(believed) is None
    real = realised(believed, Reality(arms={"left": ArmReality(backlash_rad=(0.0, 0.01, 0.0))}))
    np.testing.assert_array_equal(real.arms[0].actuator.backlash_rad, [0.0, 0.01, 0.0])
    assert not real.arms[1].actuator.backlash_rad.any()

    def moved(spec: PlantSpec) -> float:
        """By what a torque moves the joint beyond what the rest of the cell does to it."""
        q = []
        for torque in (0.0, 0.2):
            world = PlantWorld(build_plant(without_servo_electronics(spec)), supported=False)
            world.tau_Nm[1] = torque
            for _ in range(10):
                world.advance()
            q.append(float(world.plant.q[1]))
        return abs(q[1] - q[0])

    assert moved(real) == 0.0
    assert moved(believed) > 1e-4


def loose(spec: PlantSpec, gap: float = 5.76e-3, viscous: float = 0.0) -> PlantSpec:
    """The cell with this gap in every joint, its servos with no other effect."""
    arms = tuple(
        replace(arm, actuator=ActuatorSpec.of(len(arm.controlled), backlash_rad=gap, viscous_Nms_rad=viscous))
        for arm in spec.arms
    )
    return replace(spec, arms=arms)


PADS = GraspSpec(2e4, 50.0)
MOVED = (  # one arm that falls with the object
    "identify_wx200", "simulation.effects.friction=false", "simulation.effects.saturation=false",
    "world.gravity_m_per_s2=[0.0,0.0,-1.0]",
)  # fmt: skip


def shipped(name: str, *overrides: str) -> PlantSpec:
    cell = load_cell(Path(name), list(overrides))
    return plant_spec(cell, start_joints(cell))


def energies(plant: AnyPlant, substeps: int) -> Vector:
    zero = np.zeros(plant.joint_count)
    seen = []
    for _ in range(substeps // 10):
        plant.advance(zero, 10)
        seen.append(plant.observe(zero).energy)
    return np.array(seen)


@pytest.mark.parametrize("gap", [1.7e-3, 5.76e-3])
@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_a_plant_whose_motors_give_nothing_gains_no_energy_by_its_gaps(pads: GraspSpec | None, gap: float) -> None:
    spec = replace(shipped(*MOVED), grasp=pads)
    plant = build_plant(loose(spec, gap))
    found = energies(plant, 3000)
    tight = energies(build_plant(spec), 3000)
    rises = [float((e - np.minimum.accumulate(e)).max()) for e in (found, tight)]
    assert rises[0] < rises[1] + 1e-4
    assert found[-1] < tight[-1] - 1e-4, "blows cost some"
    assert np.abs(plant.dq).max() > 0.1


def test_a_cell_that_falls_freely_gains_nothing_at_speeds_beyond_its_servos() -> None:
    spec = loose(shipped("paper_real", "simulation.effects.friction=false"))
    plant = build_plant(spec)
    found = energies(plant, 2000)
    assert np.abs(plant.dq).max() > 5.0
    assert float((found - np.minimum.accumulate(found)).max()) < 1e-3
    assert found[-1] > 0.8 * found[0]


def test_an_arm_alone_gains_nothing_either_and_moves_as_one_whose_grasp_is_open() -> None:
    spec = replace(loose(shipped(*MOVED)), grasp=None)
    plant, lone = build_plant(spec), LoneArm(spec, 0)
    plant.release("arm")
    zero, met = np.zeros(3), 0
    for k in range(400):
        tau = zero if k < 200 else np.array([0.0, 0.0, 0.05 * np.sin(0.05 * k)])
        met += lone._gears is not None and lone._gears.meets
        plant.advance(tau, 1)
        lone.advance(tau)
    assert met > 3
    np.testing.assert_allclose(lone.q, plant.q, atol=1e-9)
    np.testing.assert_allclose(lone.dq, plant.dq, atol=1e-8)


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_a_plants_wrist_gets_all_that_its_motor_pushed(pads: GraspSpec | None) -> None:
    """In the cell of one arm, whose grasp is open."""
    spec = replace(shipped(*MOVED), gravity=np.zeros(3), grasp=pads)
    speeds = []
    for one in (loose(spec), spec):
        plant = build_plant(one)
        plant.release("arm")
        plant.advance(np.array([0.0, 0.0, 0.2]), 200)
        speeds.append(float(plant.dq[2]))
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-3)


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_in_the_gap_what_is_observed_is_without_motor_and_rotor(pads: GraspSpec | None) -> None:
    spec = replace(loose(shipped(*MOVED)), grasp=pads)
    geared, bare = build_plant(spec), build_plant(_without_rotors(spec))
    tau = np.array([0.05, 0.05, 0.05])
    for plant, command in ((geared, tau), (bare, np.zeros(3))):
        plant.advance(command, 10)
    seen, expected = geared.observe(tau), bare.observe(np.zeros(3))
    assert geared._gears is not None
    assert not geared._gears.inertia.any()
    np.testing.assert_allclose(seen.q, expected.q, atol=1e-12 if pads is None else 1e-5)
    np.testing.assert_allclose(seen.grasp_wrench, expected.grasp_wrench, atol=1e-9 if pads is None else 0.05)
    rotors = 0.5 * float(spec.arms[0].rotor_inertia @ (10 * H * tau / spec.arms[0].rotor_inertia) ** 2)
    assert seen.energy - expected.energy == pytest.approx(rotors, rel=1e-6 if pads is None else 0.05)
    assert seen.tau_applied.tolist() == tau.tolist(), "of the motors"


def _without_rotors(spec: PlantSpec) -> PlantSpec:
    return replace(
        spec,
        arms=tuple(replace(a, rotor_inertia=0.0 * a.rotor_inertia, actuator=ActuatorSpec.of(3)) for a in spec.arms),
    )


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_a_start_in_motion_takes_the_motors_along(pads: GraspSpec | None) -> None:
    spec = replace(loose(shipped(*MOVED)), grasp=pads)
    plant = build_plant(spec)
    plant.release("arm")
    dq = np.array([0.5, -0.4, 0.3])
    plant.set_velocity(np.concatenate([dq, np.zeros(6)]))
    assert plant._gears is not None
    assert plant._gears.speed.tolist() == dq.tolist()


def test_arms_that_are_set_down_at_rest_have_motors_at_rest() -> None:
    plant = HandledPlant(replace(loose(shipped(*MOVED)), grasp=PADS))
    plant.advance(np.full(3, 0.1), 5)
    assert plant._gears is not None
    assert plant._gears.speed.all()
    plant.let_go(plant.q, plant.T_world_object)
    assert not plant._gears.speed.any()


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_a_motor_in_its_gap_is_held_back_by_its_own_speed(pads: GraspSpec | None) -> None:
    spec = replace(shipped(*MOVED), gravity=np.zeros(3), grasp=pads)
    servos = ActuatorSpec.of(3, stall_Nm=1.0, no_load_rad_s=0.2, backlash_rad=0.01)
    spec = replace(spec, arms=tuple(replace(arm, actuator=servos) for arm in spec.arms))
    plant, lone = build_plant(spec), LoneArm(spec, 0)
    plant.advance(np.full(3, 1.0), 20)
    for _ in range(20):
        lone.advance(np.full(3, 1.0))
    for one in (plant, lone):
        assert one._gears is not None
        assert not one._gears.inertia.any()
        assert (one._gears.speed < 0.2).all()
        assert (one._gears.speed > 0.1).all()
    assert (plant.observe(np.full(3, 1.0)).tau_applied < 0.5).all()
    assert (plant.reported()[2] < 0.5).all()


@pytest.mark.parametrize("pads", [None, GraspSpec(1e6, 1e3)], ids=["welds", "pads"])
def test_gears_are_told_the_speeds_and_accelerations_of_every_substep(
    pads: GraspSpec | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = build_plant(replace(loose(shipped(*MOVED), viscous=0.3), grasp=pads))
    gears = plant._gears
    assert gears is not None
    told, step = list[tuple[Vector, Vector]](), gears.step

    def watched(motor: Vector, dq: Vector, ddq: Vector) -> None:
        told.append((dq.copy(), ddq.copy()))
        step(motor, dq, ddq)

    monkeypatch.setattr(gears, "step", watched)
    for k in range(40):
        before, blow = plant.dq.copy(), gears.meets
        plant.advance(np.array([0.3, -0.2, 0.1]), 1)
        dq, ddq = told[k]
        assert np.array_equal(dq, plant.dq)
        if not blow:
            np.testing.assert_allclose(ddq, (plant.dq - before) / H, rtol=1e-6, atol=1e-6)
    assert len(told) == 40
    assert max(np.abs(ddq).max() for _, ddq in told) > 1.0


@pytest.mark.parametrize("pads", [None, GraspSpec(1e6, 1e3)], ids=["welds", "pads"])
@pytest.mark.parametrize("viscous", [0.0, 0.3])
def test_the_grasps_torque_that_is_metered_is_what_moves_the_object(pads: GraspSpec | None, viscous: float) -> None:
    """One arm that turns it by the wrist, through a blow."""
    spec = replace(loose(shipped(*MOVED), viscous=viscous), gravity=np.zeros(3), grasp=pads)
    body, free, plant = spec.object, FreeArms(spec), build_plant(spec)
    dq = np.array([0.0, 0.0, -0.3])

    def momentum() -> Vector:
        """Of the object, as a momentum of the joints that hold it."""
        seen = plant.observe(np.zeros(3))
        free.terms(plant.q, plant.dq)
        jacobian, T_world_ee = free.end_effector(0)
        R, linear = plant.T_world_object.rotation, body.mass_kg * seen.v_object[:3]
        angular = R @ body.inertia @ R.T @ seen.v_object[3:]
        return jacobian.T @ np.concatenate([linear, angular - np.cross(T_world_ee.translation - seen.p_object, linear)])

    free.terms(spec.arms[0].q_start, dq)
    jacobian, T_world_ee = free.end_effector(0)
    twist, T = jacobian @ dq, plant.T_world_object
    twist[:3] += np.cross(twist[3:], T.translation - T_world_ee.translation)
    plant.set_velocity(np.concatenate([dq, T.rotation.T @ twist[:3], T.rotation.T @ twist[3:]]))
    plant.meter_grasps()
    tau, met = np.array([0.0, 0.0, 0.2]), 0
    for _ in range(60):
        before = momentum()
        assert plant._gears is not None
        met += plant._gears.meets
        plant.advance(tau, 1)
        given = H * plant.grasp_torque()
        np.testing.assert_allclose(given, before - momentum(), atol=2e-7, rtol=1e-3)
    assert met > 0


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
@pytest.mark.parametrize("viscous", [0.05, 200.0], ids=["limp", "locked"])
def test_joints_that_rub_without_their_rotors_come_to_rest_without_ringing(
    pads: GraspSpec | None, viscous: float
) -> None:
    spec = replace(loose(shipped(*MOVED), 0.1), gravity=np.zeros(3), grasp=pads)
    plant, lone = build_plant(spec), LoneArm(spec, 0)
    plant.release("arm")
    plant.brake("arm", viscous)
    lone.brake(viscous)
    dq = np.array([0.0, 0.0, 1.0])
    plant.set_velocity(np.concatenate([dq, np.zeros(6)]))
    lone.dq = dq
    for _ in range(30):
        plant.advance(np.zeros(3), 1)
        lone.advance(np.zeros(3))
        assert plant.dq[2] > -1e-3
        assert lone.dq[2] > -1e-3
    assert plant.dq[2] < 0.6


@pytest.mark.parametrize("pads", [None, PADS], ids=["welds", "pads"])
def test_how_a_motion_with_gaps_is_divided_or_watched_changes_no_bit_of_it(pads: GraspSpec | None) -> None:
    spec = replace(loose(shipped(*MOVED), 1e-3), grasp=pads)
    whole, parts = build_plant(spec), build_plant(spec)
    tau = np.array([0.3, -0.2, 0.1])
    whole.advance(tau, 200)
    for _ in range(100):
        parts.advance(tau, 2)
        parts.observe(tau)
    assert np.array_equal(whole.q, parts.q)
    assert np.array_equal(whole.dq, parts.dq)


def test_an_instant_that_is_worked_out_later_has_the_gears_of_then() -> None:
    plant = build_plant(loose(shipped(*MOVED), 1e-3))
    assert isinstance(plant, Plant)
    tau = np.array([0.3, -0.2, 0.1])
    for _ in range(10):
        plant.advance(tau, 7)
        now, kept = plant.observe(tau), plant.snapshot(tau)
        plant.advance(tau, 7)
        then = kept.observation()
        assert (then.energy, then.grasp_wrench.tolist()) == (now.energy, now.grasp_wrench.tolist())


@pytest.mark.parametrize("meshed", [False, True])
def test_friction_that_is_observed_is_what_slowed_the_joint_with_the_rotor_that_turns_along(meshed: bool) -> None:
    spec = replace(loose(shipped(*MOVED), 0.1), gravity=np.zeros(3))
    tight = replace(spec.arms[0].actuator, backlash_rad=np.array([0.1, 0.1, 0.0 if meshed else 0.1]))
    spec = replace(spec, arms=(replace(spec.arms[0], actuator=tight),))
    sticking = FrictionSpec(*np.array([0.001, 0.0005, 0.1, 1.0, 0.0, 0.0, 0.5])[:, None] * np.ones(3))
    plant = build_plant(replace(spec, arms=(replace(spec.arms[0], friction=sticking),)))
    plant.release("arm")
    plant.set_velocity(np.array([0.0, 0.0, 0.3, *np.zeros(6)]))
    free = FreeArms(spec)
    M = free.terms(plant.q, np.zeros(3))[0] - np.diag(spec.arms[0].rotor_inertia * [1.0, 1.0, 0.0 if meshed else 1.0])
    for _ in range(5):
        before = plant.dq
        plant.advance(np.zeros(3), 1)
        slowed = M @ (plant.dq - before) / H
        np.testing.assert_allclose(plant.observe(np.zeros(3)).tau_friction, slowed, atol=2e-3 * np.abs(slowed).max())


def test_backlash_that_cannot_be_is_refused() -> None:
    with pytest.raises(ActuatorError, match="backlash_rad"):
        ActuatorSpec.of(1, backlash_rad=-1e-3)
    with pytest.raises(ActuatorError, match="backlash_rad"):
        ActuatorSpec.of(1, backlash_rad=np.inf)
    with pytest.raises(PlantError, match=r"backlash_rad.*one per controlled joint"):
        realised(planar_cell(SERVOS), Reality(arms={"left": ArmReality(backlash_rad=(0.01,))}))


@pytest.mark.parametrize(
    ("name", "seed"), [("paper_real", None), pytest.param("three_wx250s", 3, marks=pytest.mark.long)]
)
def test_a_cell_lives_with_a_tenth_of_a_degree_in_every_joint(name: str, seed: int | None) -> None:
    cell = load_cell(Path(name), ["duration_s=1.0", "simulation.ready_s=0.2", "report.transient_s=0.4"])
    drawn = Given() if seed is None else draw(cell.file.tolerance, seed, cell)
    entry = {arm.name: drawn.arms.get(arm.name, Entry()) for arm in cell.arms}
    gap = (float(np.radians(0.1)),)
    arms = {arm.name: entry[arm.name].model_copy(update={"backlash_rad": gap * arm.n}) for arm in cell.arms}
    lab = Laboratory(cell)
    assert Run(lab, drawn.model_copy(update={"arms": arms})).plant._gears is not None
    result = measure(lab, drawn.model_copy(update={"arms": arms}))
    assert result.within_bounds
    assert result != measure(lab, drawn)
