"""What the plant has against what is believed: each error where it acts, in the direction that its key says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from sim_backend.physics.actuator import ActuatorError, ActuatorSpec
from sim_backend.physics.build import build_plant
from sim_backend.physics.composition import arm_model, frame_number
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.plant import Plant
from sim_backend.physics.reality import ArmReality, Reality, realised
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import ArmSpec, GraspError, GraspSpec, PlantError, PlantSpec
from sim_backend.wire.plant_world import PlantWorld, without_servo_electronics
from tests.support.plant.plant_cells import planar_cell, spatial_cell
from tests.support.plant.served_plant import SERVOS, TAU, ServedPlant
from tests.support.plant.soft_cells import viscous

CELLS: dict[str, Callable[..., PlantSpec]] = {
    "two planar arms": planar_cell,
    "three six-joint arms": lambda servos=None, **kw: spatial_cell(3, servos, **kw),
}


def only(spec: PlantSpec, **errors: object) -> Reality:
    """Errors of the first arm and no others."""
    return Reality(arms={spec.names[0]: ArmReality(**errors)})  # type: ignore[arg-type]


def end_effector(arm: ArmSpec) -> pin.SE3:
    model = arm_model(arm)
    data = model.createData()
    pin.framesForwardKinematics(model, data, arm.q_start)
    return arm.T_world_base * data.oMf[frame_number(model, arm.ee_frame)]


def test_reality_without_errors_is_what_is_believed() -> None:
    spec = planar_cell(SERVOS)
    same = realised(spec, only(spec))
    for believed, real in zip(spec.arms, same.arms, strict=True):
        assert np.array_equal(real.q_start, believed.q_start)
        assert np.array_equal(real.T_world_base.homogeneous, believed.T_world_base.homogeneous)
        assert np.array_equal(real.T_object_ee.homogeneous, believed.T_object_ee.homogeneous)
        assert np.array_equal(real.actuator.torque_scale, believed.actuator.torque_scale)
        assert real.actuator.delay_s == believed.actuator.delay_s
        assert (real.masses.tolist(), real.skew_s) == ([1.0, 1.0, 1.0], 0.0)
        assert np.array_equal(real.actuator.zero_error_rad, np.zeros(3))
    assert np.array_equal(same.object.inertia, spec.object.inertia)
    assert same.grasp is None


def test_base_stands_beside_where_it_is_believed_and_the_arm_still_holds_the_object() -> None:
    spec = spatial_cell(2)
    real = realised(spec, only(spec, base_m=(1e-3, -2e-3, 3e-3), base_rad=(0.0, 0.0, 0.02))).arms[0]
    believed = spec.arms[0]
    np.testing.assert_allclose(real.T_world_base.translation - believed.T_world_base.translation, [1e-3, -2e-3, 3e-3])
    turned = real.T_world_base.rotation @ believed.T_world_base.rotation.T
    np.testing.assert_allclose(pin.log3(turned), [0.0, 0.0, 0.02], atol=1e-12)
    np.testing.assert_allclose(real.T_object_ee.homogeneous, believed.T_object_ee.homogeneous, atol=1e-9)
    assert not np.allclose(real.q_start, believed.q_start, atol=1e-3)


def test_grasp_is_beside_where_it_is_believed_in_the_axes_of_the_object() -> None:
    spec = spatial_cell(2)
    turned = replace(spec.object, quat_world=np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    R = turned.T_world_object.rotation
    arms = tuple(
        replace(a, T_object_ee=pin.SE3(R.T @ a.T_object_ee.rotation, R.T @ a.T_object_ee.translation))
        for a in spec.arms
    )
    spec = replace(spec, object=turned, arms=arms)
    real = realised(spec, only(spec, grasp_m=(2e-3, 0.0, 1e-3), grasp_rad=(0.0, 0.01, 0.0))).arms[0]
    moved = end_effector(real).translation - end_effector(spec.arms[0]).translation
    np.testing.assert_allclose(moved, R @ [2e-3, 0.0, 1e-3], atol=1e-9)
    turn = real.T_object_ee.rotation @ spec.arms[0].T_object_ee.rotation.T
    np.testing.assert_allclose(pin.log3(turn), [0.0, 0.01, 0.0], atol=1e-9)


def test_planar_arm_leaves_in_its_grasp_what_it_cannot_follow() -> None:
    spec = planar_cell()
    real = realised(spec, only(spec, base_m=(0.0, 1e-3, 4e-3)))
    build_plant(real)  # every arm starts on its grasp
    shift = real.arms[0].T_object_ee.translation - spec.arms[0].T_object_ee.translation
    np.testing.assert_allclose(shift, [0.0, 0.0, 4e-3], atol=1e-9)


def test_base_out_of_reach_is_refused() -> None:
    spec = planar_cell()
    with pytest.raises(GraspError, match="left"):
        realised(spec, only(spec, base_m=(-0.5, 0.0, 0.0)))


@pytest.mark.parametrize("grasp", [None, GraspSpec(1e5, 100.0)], ids=["welds", "pads"])
def test_encoders_report_from_their_own_zero(grasp: GraspSpec | None) -> None:
    spec = replace(planar_cell(), grasp=grasp)
    plant = build_plant(realised(spec, only(spec, zeros_rad=(0.01, -0.02, 0.0))))
    reported, _, _ = plant.reported()
    np.testing.assert_allclose(reported - plant.q, [0.01, -0.02, 0.0, 0.0, 0.0, 0.0], atol=1e-15)


def test_emulated_servos_stand_at_the_encoders_zero_and_keep_the_plants_friction() -> None:
    spec = planar_cell(SERVOS)
    real = without_servo_electronics(realised(spec, only(spec, zeros_rad=(0.01, -0.02, 0.0), friction=1.5)))
    world = PlantWorld(build_plant(real))
    zeros = np.array([0.01, -0.02, 0.0])
    np.testing.assert_allclose(world.state(0)[0], world.plant.q[:3] + zeros, atol=1e-15)
    np.testing.assert_allclose(world.state(1)[0], world.plant.q[3:], atol=0.0)
    np.testing.assert_allclose(real.arms[0].actuator.coulomb_Nm, 1.5 * SERVOS.coulomb_Nm)


def test_masses_scale_the_links_and_not_the_rotors() -> None:
    spec = planar_cell()
    real = realised(spec, only(spec, masses=1.2)).arms[0]
    for one, other in zip(arm_model(spec.arms[0]).inertias[1:], arm_model(real).inertias[1:], strict=True):
        assert other.mass == pytest.approx(1.2 * one.mass)
        np.testing.assert_allclose(other.inertia, 1.2 * one.inertia)
        np.testing.assert_allclose(other.lever, one.lever)
    assert np.array_equal(real.rotor_inertia, spec.arms[0].rotor_inertia)
    heavier = replace(spec, arms=(replace(spec.arms[0], masses=2.0, skew_s=0.001), spec.arms[1]))
    twice = realised(heavier, only(spec, masses=1.2, skew_s=0.002)).arms[0]
    assert (twice.masses.tolist(), twice.skew_s) == (pytest.approx([2.4, 2.4, 2.4]), pytest.approx(0.003))


def test_each_joint_may_have_links_and_friction_of_its_own() -> None:
    spec = planar_cell(SERVOS)
    sticking = replace(spec, arms=(replace(spec.arms[0], friction=FrictionSpec(*np.full((7, 3), 0.1))), spec.arms[1]))
    errors = only(spec, masses=2.0, link_masses=(0.5, 0.3, 1.2), friction=0.5, joint_friction=(1.0, 3.0, 0.2))
    left, right = realised(sticking, errors).arms
    believed = arm_model(spec.arms[0]).inertias[1:]
    for times, one, other in zip((1.0, 0.6, 2.4), believed, arm_model(left).inertias[1:], strict=True):
        assert other.mass == pytest.approx(times * one.mass)
        np.testing.assert_allclose(other.inertia, times * one.inertia)
        np.testing.assert_allclose(other.lever, one.lever)
    rubs = np.array([0.5, 1.5, 0.1])
    np.testing.assert_allclose(left.actuator.coulomb_Nm, rubs * SERVOS.coulomb_Nm)
    np.testing.assert_allclose(left.actuator.viscous_Nms_rad, rubs * SERVOS.viscous_Nms_rad)
    assert left.friction is not None
    np.testing.assert_allclose(left.friction.breakaway_Nm, 0.1 * rubs)
    np.testing.assert_allclose(left.friction.viscous_Nms_rad, 0.1 * rubs)
    assert right.masses.tolist() == [1.0, 1.0, 1.0]
    assert np.array_equal(right.actuator.coulomb_Nm, SERVOS.coulomb_Nm)


def test_friction_torque_constants_delay_and_skew_reach_the_servos() -> None:
    dry = FrictionSpec(*np.full((7, 3), 0.1))
    spec = planar_cell(SERVOS)
    spec = replace(spec, arms=tuple(replace(a, friction=dry) for a in spec.arms))
    errors = only(spec, friction=0.5, torque_constant=(1.1, 0.9, 1.0), skew_s=0.004, backlash_rad=(0.01, 0.0, 0.02))
    real = realised(spec, replace(errors, delay_s=0.0055, delay_jitter_s=0.001))
    left, right = real.arms
    np.testing.assert_allclose(left.actuator.viscous_Nms_rad, 0.5 * SERVOS.viscous_Nms_rad)
    np.testing.assert_allclose(left.actuator.torque_scale, [1.1, 0.9, 1.0])
    assert (left.actuator.delay_s, right.actuator.delay_s, left.actuator.delay_jitter_s) == (0.0055, 0.0055, 0.001)
    assert left.actuator.backlash_rad.tolist() == [0.01, 0.0, 0.02]
    assert np.array_equal(right.actuator.backlash_rad, SERVOS.backlash_rad)
    assert (left.skew_s, right.skew_s) == (0.004, 0.0)
    assert left.friction is not None
    assert right.friction is not None
    scaled = {"coulomb_Nm", "breakaway_Nm", "load", "breakaway_load", "viscous_Nms_rad"}
    for key in vars(dry):
        np.testing.assert_allclose(getattr(left.friction, key), 0.05 if key in scaled else 0.1)
    np.testing.assert_allclose(right.friction.coulomb_Nm, 0.1)


def test_joints_may_stick_of_which_nobody_believes_it() -> None:
    spec = planar_cell(SERVOS)
    own = only(spec, friction=2.0, breakaway_Nm=(0.3, 0.2, 0.0), stribeck_rad_per_s=0.5, load_friction=(0.05, 0.0, 0.1))
    real = realised(spec, own)
    left, right = real.arms
    assert right.friction is None
    assert left.friction is not None
    assert left.friction.breakaway_Nm.tolist() == [0.3, 0.2, 0.0]
    assert left.friction.stribeck_rad_s.tolist() == [0.5, 0.5, 0.5]
    assert left.friction.load.tolist() == [0.05, 0.0, 0.1]
    np.testing.assert_array_equal(left.friction.coulomb_Nm, 2.0 * SERVOS.coulomb_Nm)
    np.testing.assert_array_equal(left.friction.viscous_Nms_rad, 2.0 * SERVOS.viscous_Nms_rad)
    emulated = without_servo_electronics(real).arms[0].friction
    assert emulated is left.friction
    assert not any(arm.friction for arm in realised(spec, only(spec, friction=2.0)).arms)
    assert realised(spec, only(spec, load_friction=(0.1, 0.1, 0.1))).arms[0].friction is not None
    assert realised(spec, only(spec, breakaway_Nm=(0.1, 0.1, 0.1))).arms[0].friction is not None


def test_a_stribeck_velocity_is_that_of_any_breakaway_and_refused_without_one() -> None:
    spec = planar_cell(SERVOS)

    def sticking(breakaway: float, of_load: float) -> PlantSpec:
        rows = np.array([0.05, breakaway, 0.1, 2.0, 0.05, of_load, 0.03])[:, None] * np.ones(3)
        return replace(spec, arms=tuple(replace(arm, friction=FrictionSpec(*rows)) for arm in spec.arms))

    for believed in (sticking(0.05, 0.0), sticking(0.0, 0.1)):
        quick = realised(believed, only(believed, stribeck_rad_per_s=0.5)).arms[0].friction
        assert quick is not None
        assert quick.stribeck_rad_s.tolist() == [0.5] * 3
        assert quick.breakaway_Nm.tolist() == believed.arms[0].friction.breakaway_Nm.tolist()  # type: ignore[union-attr]
        kept = realised(believed, only(believed, friction=0.5)).arms[0].friction
        assert kept is not None
        assert kept.stribeck_rad_s.tolist() == [0.1] * 3
    for none in (spec, sticking(0.0, 0.0)):
        with pytest.raises(PlantError, match=r"arm left: stribeck_rad_per_s: found 0\.5 rad/s of no breakaway"):
            realised(none, only(none, stribeck_rad_per_s=0.5))


def test_own_breakaway_and_load_stand_in_the_place_of_what_is_believed_each_alone() -> None:
    spec = planar_cell(SERVOS)
    believed = FrictionSpec(*np.full((7, 3), 0.1))
    spec = replace(spec, arms=tuple(replace(a, friction=believed) for a in spec.arms))
    sticks = realised(spec, only(spec, friction=0.5, breakaway_Nm=(0.3, 0.3, 0.3))).arms[0].friction
    assert sticks is not None
    assert (sticks.breakaway_Nm[0], sticks.stribeck_rad_s[0], sticks.load[0]) == (0.3, 1.0, 0.05)
    pressed = realised(spec, only(spec, friction=0.5, load_friction=(0.2, 0.2, 0.2))).arms[0].friction
    assert pressed is not None
    assert (pressed.breakaway_Nm[0], pressed.stribeck_rad_s[0], pressed.load[0]) == (0.05, 0.1, 0.2)
    with pytest.raises(PlantError, match="breakaway_Nm"):
        realised(spec, only(spec, breakaway_Nm=(0.1,)))
    with pytest.raises(PlantError, match="load_friction"):
        realised(spec, only(spec, load_friction=(0.1,)))


def test_pads_replace_welds_and_keep_what_a_cell_says_of_slipping() -> None:
    spec = planar_cell()
    pads = Reality(pads_N_per_m=2e3, pads_Nm_per_rad=30.0, pads_damping_ratio=0.1)
    assert realised(spec, pads).grasp == GraspSpec(2e3, 30.0, 0.1)
    slipping = replace(spec, grasp=GraspSpec(1e5, 100.0, slip_N=9.0))
    assert realised(slipping, Reality(pads_N_per_m=2e3)).grasp == GraspSpec(2e3, 100.0, slip_N=9.0)
    assert realised(slipping, Reality(pads_Nm_per_rad=30.0)).grasp == GraspSpec(1e5, 30.0, slip_N=9.0)
    assert realised(slipping, Reality(pads_damping_ratio=0.5)).grasp == GraspSpec(1e5, 100.0, 0.5, slip_N=9.0)
    with pytest.raises(PlantError, match="pads_Nm_per_rad"):
        realised(spec, Reality(pads_N_per_m=2e3))


def test_an_arm_s_own_pads_are_its_alone() -> None:
    spec = replace(planar_cell(), grasp=GraspSpec(1e5, 100.0))
    left = realised(spec, Reality(arms={"left": ArmReality(pads_N_per_m=2e3, pads_Nm_per_rad=7.0)}))
    assert left.grasp == spec.grasp
    assert [arm.pads for arm in left.arms] == [(2e3, 7.0), (None, None)]
    assert SoftPlant(left)._pads.K.tolist() == [[2e3] * 3 + [7.0] * 3, [1e5] * 3 + [100.0] * 3]
    turned = realised(spec, Reality(pads_N_per_m=3e4, arms={"right": ArmReality(pads_Nm_per_rad=7.0)}))
    assert SoftPlant(turned)._pads.K.tolist() == [[3e4] * 3 + [100.0] * 3, [3e4] * 3 + [7.0] * 3]
    with pytest.raises(PlantError, match=r"reality of arm left: pads: found grasps that are welded"):
        realised(planar_cell(), Reality(arms={"left": ArmReality(pads_N_per_m=2e3)}))
    with pytest.raises(PlantError, match="arm left: pads"):
        realised(spec, Reality(arms={"left": ArmReality(pads_N_per_m=-1.0)}))


def test_what_is_not_there_is_refused() -> None:
    spec = planar_cell()
    with pytest.raises(PlantError, match="middle"):
        realised(spec, Reality(arms={"middle": ArmReality()}))
    with pytest.raises(PlantError, match="zeros_rad"):
        realised(spec, only(spec, zeros_rad=(0.0, 0.1)))
    with pytest.raises(PlantError, match="masses"):
        realised(spec, only(spec, masses=0.0))
    with pytest.raises(ActuatorError, match="delay_jitter_s"):
        realised(spec, Reality(delay_s=0.001, delay_jitter_s=0.002))
    with pytest.raises(ActuatorError, match="zero_error_rad"):
        ActuatorSpec.of(3, zero_error_rad=np.nan)


@pytest.mark.parametrize("make", list(CELLS.values()), ids=list(CELLS))
def test_object_hangs_from_its_centre_of_mass(make: Callable[..., PlantSpec]) -> None:
    """Pads on braked arms bear weight and moment of an object whose centre is not where its frame is."""
    believed = make(viscous(len(make().arms[0].controlled)))
    centre = np.array([0.01, -0.004, 0.006])
    spec = replace(realised(believed, Reality(object=1.3, object_centre_m=(0.01, -0.004, 0.006))), grasp=None)
    plant = SoftPlant(replace(spec, grasp=GraspSpec(3e3, 20.0, damping_ratio=1.0)))
    for name in spec.names:
        plant.brake(name, 1e6)
    plant.advance(np.zeros(plant.joint_count), 3000)
    seen = plant.observe(np.zeros(plant.joint_count))
    weight = -1.3 * believed.object.mass_kg * believed.gravity
    levers = [plant.T_world_object.act(a.T_object_ee.translation) - seen.p_object for a in spec.arms]
    W = seen.grasp_wrench
    moment = sum(w[3:] + np.cross(r, w[:3]) for w, r in zip(W, levers, strict=True))
    np.testing.assert_allclose(W[:, :3].sum(axis=0), weight, atol=1e-4)
    np.testing.assert_allclose(moment, np.cross(plant.T_world_object.rotation @ centre, weight), atol=2e-4)


def test_welds_and_stiff_pads_agree_on_an_object_off_its_centre() -> None:
    believed = planar_cell(viscous(3))
    spec = realised(believed, Reality(object=10.0, object_centre_m=(0.02, 0.01, 0.0)))
    welded, soft = Plant(spec), SoftPlant(replace(spec, grasp=GraspSpec(1e6, 1e3)))
    tau = np.array([0.3, -0.2, 0.1, 0.1, 0.2, -0.1])
    for _ in range(40):
        welded.advance(tau, 5)
        soft.advance(tau, 5)
    centred = Plant(realised(believed, Reality(object=10.0)))
    centred.advance(tau, 200)
    assert float(np.abs(centred.q - welded.q).max()) > 5e-3  # it does matter where the centre is
    np.testing.assert_allclose(soft.q, welded.q, atol=3e-3)
    a, b = soft.observe(tau), welded.observe(tau)
    assert a.energy == pytest.approx(b.energy, abs=5e-3)


def test_spinning_object_swings_about_its_centre_of_mass() -> None:
    """Let go of and without gravity, the centre of mass goes straight on and the frame turns about it."""
    spec = replace(spatial_cell(2), gravity=np.zeros(3))
    spec = replace(realised(spec, Reality(object_centre_m=(0.02, 0.0, 0.01))), grasp=GraspSpec(1e3, 10.0))
    for plant in (SoftPlant(spec), Plant(replace(spec, grasp=None))):
        for name in spec.names:
            plant.release(name)
        plant.set_velocity(np.concatenate([np.zeros(plant.joint_count), [0.0, 0.0, 0.0, 0.0, 3.0, 1.0]]))
        energy = plant.observe(np.zeros(plant.joint_count)).energy
        centre = plant.T_world_object.act(spec.object.centre_m)
        R = plant.T_world_object.rotation
        velocity = np.cross(R @ [0.0, 3.0, 1.0], R @ spec.object.centre_m)
        plant.advance(np.zeros(plant.joint_count), 200)
        np.testing.assert_allclose(plant.T_world_object.act(spec.object.centre_m), centre + 0.2 * velocity, atol=2e-4)
        assert plant.observe(np.zeros(plant.joint_count)).energy == pytest.approx(energy, rel=1e-2)


def test_each_arm_is_told_the_time_of_its_own_clock(tmp_path: Path) -> None:
    spec = planar_cell(SERVOS)
    real = realised(spec, only(spec, skew_s=0.004))
    with ServedPlant(tmp_path, spec=real) as served:
        left, right = served.enabled()
        for tick in range(3):
            assert left.read().stamp_ns == 4_000_000 + tick * 5_000_000
            assert right.read().stamp_ns == tick * 5_000_000
            left.write(TAU)
            right.write(TAU)
