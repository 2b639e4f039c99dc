"""The closed chain against mechanics that can be written on paper."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.composition import arm_model, compose
from sim_backend.physics.plant import Plant
from sim_backend.physics.spec import PlantError, PlantSpec
from tests.support.plant.plant_cells import BOX, GRAVITY, planar_cell, spatial_cell

CELLS: dict[str, Callable[[], PlantSpec]] = {
    "one planar arm": lambda: planar_cell(names=("left",)),
    "two planar arms": planar_cell,
    "one six-joint arm": lambda: spatial_cell(1),
    "two six-joint arms": lambda: spatial_cell(2),
    "three six-joint arms": lambda: spatial_cell(3),
    "four six-joint arms": lambda: spatial_cell(4),
}
MX = ActuatorSpec.of(3, coulomb_Nm=[0.0843, 0.0843, 0.0078], viscous_Nms_rad=[0.0347, 0.0347, 0.0362])


@pytest.fixture(params=CELLS.values(), ids=CELLS.keys())
def spec(request: pytest.FixtureRequest) -> PlantSpec:
    made: PlantSpec = request.param()
    return made


def no_arms(gravity: Vector, quat: Vector | None = None) -> Plant:
    body = BOX if quat is None else replace(BOX, quat_world=quat)
    return Plant(PlantSpec((), body, gravity))


def nothing(plant: Plant) -> Vector:
    return np.zeros(plant.joint_count)


def holding_torque(spec: PlantSpec) -> tuple[Vector, Vector]:
    """Torques (J,) that hold the cell at its start pose, and the wrenches (N, 6) on the object that they mean.

    Every arm carries its own weight and an equal share of the object's, by its own model and J^T alone.
    """
    share = -spec.object.mass_kg * spec.gravity / len(spec.arms)
    taus, wrenches = [], []
    for arm in spec.arms:
        model = arm_model(arm)
        model.gravity = pin.Motion(arm.T_world_base.rotation.T @ spec.gravity, np.zeros(3))
        data = model.createData()
        frame = max(i for i, f in enumerate(model.frames) if f.name == arm.ee_frame)
        J = pin.computeFrameJacobian(model, data, arm.q_start, frame, pin.LOCAL_WORLD_ALIGNED)
        R = arm.T_world_base.rotation
        p_ee_object = -(spec.object.T_world_object.rotation @ arm.T_object_ee.translation)
        wrench = np.concatenate([share, np.cross(p_ee_object, share)])
        in_base = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
        taus.append(pin.computeGeneralizedGravity(model, data, arm.q_start) + J.T @ in_base)
        wrenches.append(wrench)
    return np.concatenate(taus), np.array(wrenches)


def test_free_object_falls_at_g() -> None:
    plant = no_arms(GRAVITY)
    start = plant.observe(nothing(plant))
    plant.advance(nothing(plant), 500)
    end = plant.observe(nothing(plant))
    assert end.t == pytest.approx(0.5)
    np.testing.assert_allclose(end.p_object - start.p_object, 0.5 * GRAVITY * 0.25, atol=1e-12)
    np.testing.assert_allclose(end.v_object, [*(GRAVITY * 0.5), 0, 0, 0], atol=1e-12)
    assert end.energy == pytest.approx(start.energy, abs=1e-12)


def test_pushed_object_accelerates_by_force_over_mass_in_world_axes() -> None:
    plant = no_arms(np.zeros(3), quat=np.array([math.cos(0.6), 0.0, 0.0, math.sin(0.6)]))
    force = np.array([0.02, -0.01, 0.03])
    plant.push(np.concatenate([force, np.zeros(3)]))
    plant.advance(nothing(plant), 100)
    np.testing.assert_allclose(plant.observe(nothing(plant)).v_object[:3], force / 0.062 * 0.1, rtol=1e-9)
    plant.push(np.zeros(6))
    before = plant.observe(nothing(plant)).v_object
    plant.advance(nothing(plant), 100)
    np.testing.assert_allclose(plant.observe(nothing(plant)).v_object, before, atol=1e-15)


def test_tumbling_object_keeps_energy_and_angular_momentum() -> None:
    plant = no_arms(np.zeros(3))
    plant.set_velocity(np.array([0, 0, 0, 3.0, -1.0, 2.0]))

    def momentum() -> Vector:
        seen = plant.observe(nothing(plant))
        R = plant.T_world_object.rotation
        L: Vector = R @ BOX.inertia @ R.T @ seen.v_object[3:]
        return L

    L0, E0 = momentum(), plant.observe(nothing(plant)).energy
    plant.advance(nothing(plant), 1000)
    np.testing.assert_allclose(momentum(), L0, rtol=1e-4)
    assert plant.observe(nothing(plant)).energy == pytest.approx(E0, rel=1e-4)


def test_cell_stays_at_rest_under_gravity_compensation(spec: PlantSpec) -> None:
    plant = Plant(spec)
    tau, _ = holding_torque(spec)
    plant.advance(tau, 300)
    assert np.abs(plant.dq).max() < 1e-8
    assert np.linalg.norm(plant.T_world_object.translation - spec.object.p_world) < 1e-9


def test_grasp_wrenches_at_rest_are_those_the_torques_mean(spec: PlantSpec) -> None:
    tau, wrenches = holding_torque(spec)
    np.testing.assert_allclose(Plant(spec).observe(tau).grasp_wrench, wrenches, atol=1e-8)


def test_what_pushes_the_object_is_in_the_wrenches_that_are_told_and_in_those_of_an_instant_that_is_kept() -> None:
    spec = planar_cell(ActuatorSpec.of(3, viscous_Nms_rad=0.5))
    plant, push = Plant(spec), np.array([1.0, 0.0, -3.0, 0.0, 0.2, 0.0])
    tau, at_rest = holding_torque(spec)
    for arm in spec.names:
        plant.brake(arm, 1e6)
    plant.push(push)
    plant.advance(tau, 100)
    seen, kept = plant.observe(tau), plant.snapshot(tau)
    plant.push(np.zeros(6))
    plant.advance(tau, 100)
    forces = (seen.grasp_wrench - at_rest)[:, :3].sum(axis=0)
    np.testing.assert_allclose(forces, -push[:3], atol=0.05)  # the joints creep
    assert np.array_equal(kept.observation().grasp_wrench, seen.grasp_wrench)
    np.testing.assert_allclose(
        plant.observe(tau).grasp_wrench[:, :3].sum(axis=0), at_rest[:, :3].sum(axis=0), atol=1e-3
    )


def test_servos_report_the_torque_they_give() -> None:
    spec = planar_cell()
    plant = Plant(spec)
    tau, _ = holding_torque(spec)
    plant.advance(tau, 10)
    np.testing.assert_allclose(plant.reported()[2], tau, atol=1e-12)


def test_squeeze_shows_as_opposite_forces_in_world_axes() -> None:
    spec = planar_cell()
    squeeze_N = 3.0
    tau, weight = holding_torque(spec)
    for part, arm, force in zip(Plant(spec).slices, spec.arms, (squeeze_N, -squeeze_N), strict=True):
        model = arm_model(arm)
        frame = max(i for i, f in enumerate(model.frames) if f.name == "ee")
        J = pin.computeFrameJacobian(model, model.createData(), arm.q_start, frame, pin.LOCAL_WORLD_ALIGNED)
        tau[part] += J[:3].T @ (arm.T_world_base.rotation.T @ np.array([force, 0, 0]))
    seen = Plant(spec).observe(tau)
    np.testing.assert_allclose(seen.grasp_wrench - weight, [[3, 0, 0, 0, 0, 0], [-3, 0, 0, 0, 0, 0]], atol=1e-8)


def energy_error(spec: PlantSpec, duration_s: float) -> float:
    plant = Plant(spec)
    start = plant.observe(nothing(plant)).energy
    worst = 0.0
    for _ in range(20):
        plant.advance(nothing(plant), round(duration_s / 20 / spec.substep_s))
        worst = max(worst, abs(plant.observe(nothing(plant)).energy - start))
    return worst


@pytest.mark.parametrize("make", [planar_cell, lambda **s: spatial_cell(3, **s)], ids=["planar", "three arms"])
def test_energy_error_of_the_frictionless_chain_falls_with_the_square_of_the_step(
    make: Callable[..., PlantSpec],
) -> None:
    coarse, fine = (energy_error(make(substep_s=h), 0.4) for h in (1e-3, 0.5e-3))
    assert coarse < 2e-3
    assert 3.0 < coarse / fine < 5.0


def test_motion_converges_with_the_square_of_the_step_under_torque_steps_and_friction() -> None:
    rng = np.random.default_rng(3)
    torques = rng.normal(scale=0.3, size=(60, 6))

    def end(h: float) -> Vector:
        plant = Plant(planar_cell(replace(MX, coulomb_speed_rad_s=np.full(3, 0.05)), substep_s=h))
        for tau in torques:
            plant.advance(tau, round(5e-3 / h))
        return np.concatenate([plant.q, plant.dq])

    truth = end(1e-3 / 32)
    errors = [float(np.abs(end(h) - truth).max()) for h in (1e-3, 0.5e-3)]
    assert errors[0] < 5e-3
    assert errors[0] / errors[1] > 2.5


@pytest.mark.parametrize("seconds", [20.0, pytest.param(100.0, marks=pytest.mark.long)])
def test_grasps_stay_closed_to_10_micrometres(seconds: float) -> None:
    plant = Plant(planar_cell(MX))
    phase = np.arange(6)
    worst = 0.0
    for k in range(round(seconds / 0.05)):
        plant.advance(np.array([0.8, 0.5, 0.2] * 2) * np.sin(2 * np.pi * k * 0.05 / 3 + phase), 50)
        worst = max(worst, float(plant.observe(nothing(plant)).contact_error_m.max()))
    assert plant.t == pytest.approx(seconds)
    assert worst < 1e-5


def test_friction_only_takes_energy_even_with_a_coarse_step_and_a_sharp_sign() -> None:
    servos = ActuatorSpec.of(3, coulomb_Nm=0.5, viscous_Nms_rad=0.2, coulomb_speed_rad_s=1e-4)
    arms = tuple(replace(a, rotor_inertia=np.zeros(3)) for a in planar_cell(servos).arms)
    plant = Plant(PlantSpec(arms, BOX, np.zeros(3), substep_s=5e-3))
    plant.advance(np.array([0.9, -0.8, 0.7, 0.9, -0.8, 0.7]), 20)
    energies = [plant.observe(nothing(plant)).energy]
    for _ in range(100):
        plant.advance(nothing(plant), 1)
        energies.append(plant.observe(nothing(plant)).energy)
    assert energies[0] > 1e-4
    assert np.diff(energies).max() < 1e-3 * energies[0]
    assert energies[-1] < 1e-5 * energies[0]


def test_rotor_inertia_and_gravity_survive_the_composition(spec: PlantSpec) -> None:
    model = compose(spec).model
    expected = np.concatenate([*(a.rotor_inertia for a in spec.arms), np.zeros(6)])
    assert model.armature.tolist() == expected.tolist()
    assert model.gravity.linear.tolist() == spec.gravity.tolist()
    bare = compose(replace(spec, arms=tuple(replace(a, rotor_inertia=0 * a.rotor_inertia) for a in spec.arms))).model
    q = compose(spec).q_start
    M, M_bare = (np.triu(pin.crba(m, m.createData(), q)) for m in (model, bare))
    np.testing.assert_allclose(np.diag(M - M_bare), expected, atol=1e-15)


def test_heavy_rotors_slow_the_motion() -> None:
    def moved(rotor_inertia: float) -> float:
        cell = planar_cell()
        arms = tuple(replace(a, rotor_inertia=np.full(3, rotor_inertia)) for a in cell.arms)
        plant = Plant(replace(cell, arms=arms))
        plant.advance(nothing(plant), 50)
        return float(np.abs(plant.dq).max())

    assert moved(10.0) < 0.01 * moved(0.01)


def test_friction_does_not_change_the_rotor_inertia_the_observer_sees() -> None:
    spec = planar_cell(MX)
    plant, again = Plant(spec), Plant(spec)
    plant.advance(nothing(plant), 20)
    q, dq, a = plant.q, plant.dq, np.zeros(6)
    again.advance(nothing(again), 20)
    for _ in range(3):
        again.observe(a)
    assert again.q.tolist() == q.tolist()
    assert again.dq.tolist() == dq.tolist()
    assert again.observe(a).energy == plant.observe(a).energy


def test_same_commands_give_the_same_motion_bit_for_bit(spec: PlantSpec) -> None:
    rng = np.random.default_rng(1)
    torques = rng.normal(scale=0.5, size=(40, sum(len(a.controlled) for a in spec.arms)))
    silent, watched = Plant(spec), Plant(spec)
    for tau in torques:
        silent.advance(tau, 5)
        watched.observe(tau)
        for _ in range(5):
            watched.advance(tau, 1)
            watched.observe(-tau)
    assert silent.q.tobytes() == watched.q.tobytes()
    assert silent.dq.tobytes() == watched.dq.tobytes()


def test_what_is_handed_out_belongs_to_the_receiver() -> None:
    plant = Plant(planar_cell())
    plant.advance(np.full(6, 0.1), 10)
    seen, q, reported = plant.observe(nothing(plant)), plant.q, plant.reported()
    gaps = seen.contact_error_m, seen.contact_error_rad
    handed_out = (seen.p_object, seen.quat_object, seen.grasp_wrench, *gaps, seen.tau_applied, seen.q, q, *reported)
    kept = [a.copy() for a in handed_out]
    plant.advance(np.full(6, -0.4), 50)
    plant.observe(np.ones(6))
    for array, copy in zip(handed_out, kept, strict=True):
        assert array.tolist() == copy.tolist()


def test_attitude_is_told_scalar_first() -> None:
    plant = Plant(planar_cell())
    plant.advance(np.full(6, 0.1), 50)
    told = pin.Quaternion(*plant.observe(nothing(plant)).quat_object.tolist())
    np.testing.assert_allclose(told.matrix(), plant.T_world_object.rotation, atol=1e-12)


def test_released_arm_no_longer_acts_on_the_object() -> None:
    spec = planar_cell()
    plant = Plant(spec)
    plant.advance(nothing(plant), 10)
    plant.release("right")
    plant.advance(nothing(plant), 200)
    seen = plant.observe(nothing(plant))
    assert seen.grasp_wrench[1].tolist() == [0.0] * 6
    assert np.linalg.norm(seen.grasp_wrench[0]) > 0.01
    assert math.isnan(seen.contact_error_m[1])
    assert seen.contact_error_m[0] < 1e-5


def test_braked_arm_hardly_moves_and_carries_the_other() -> None:
    plant = Plant(planar_cell())
    plant.brake("left", 500.0)
    plant.advance(nothing(plant), 200)
    assert np.abs(plant.dq).max() < 0.05
    plant.brake("left", 0.0)
    plant.advance(nothing(plant), 200)
    assert np.abs(plant.dq).max() > 0.3


def test_resting_cell_lets_time_pass_and_nothing_else() -> None:
    plant = Plant(planar_cell())
    q = plant.q
    plant.rest(7)
    assert plant.t == pytest.approx(0.007)
    assert plant.q.tolist() == q.tolist()


@pytest.mark.parametrize("torque", [math.nan, 1e200])
def test_motion_that_is_not_finite_ends_the_plant(torque: float) -> None:
    plant = Plant(planar_cell())
    with pytest.raises(PlantError, match="no finite number at t = "):
        plant.advance(np.full(6, torque), 20)
