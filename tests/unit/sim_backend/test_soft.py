"""Grasps that give, against mechanics that can be written on paper and against the welded plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from drivers.pads import swinging_inertia
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.composition import arm_model, frame_number
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.plant import Plant
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspError, GraspSpec, PlantError, PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell
from tests.support.plant.soft_cells import soft, viscous
from tests.unit.sim_backend.test_plant import holding_torque

CELLS: dict[str, Callable[..., PlantSpec]] = {
    "two planar arms": planar_cell,
    "three six-joint arms": lambda servos=None, **kw: spatial_cell(3, servos, **kw),
}
PADS = [GraspSpec(1e2, 1.0), GraspSpec(1e4, 50.0), GraspSpec(1e6, 1e3)]


@pytest.fixture(params=list(CELLS.values()), ids=list(CELLS))
def cell(request: pytest.FixtureRequest) -> Callable[..., PlantSpec]:
    made: Callable[..., PlantSpec] = request.param
    return made


def test_at_rest_the_pads_share_the_weight_and_give_by_force_over_stiffness(cell: Callable[..., PlantSpec]) -> None:
    spec = cell(viscous(len(cell().arms[0].controlled)))
    k = 3e3
    plant = soft(spec, GraspSpec(k, 20.0, damping_ratio=1.0))
    tau, _ = holding_torque(spec)
    start = plant.observe(tau)
    for part in plant.slices:  # joints locked, so that nothing but the pads gives
        plant.servos.set_viscous(part, 1e6)
    plant.advance(tau, 3000)
    seen = plant.observe(tau)
    weight = -spec.object.mass_kg * spec.gravity
    np.testing.assert_allclose(seen.grasp_wrench[:, :3].sum(axis=0), weight, atol=1e-4)
    np.testing.assert_allclose(seen.contact_error_m, np.linalg.norm(seen.grasp_wrench[:, :3], axis=1) / k, rtol=1e-4)
    np.testing.assert_allclose(
        seen.contact_error_rad, np.linalg.norm(seen.grasp_wrench[:, 3:], axis=1) / 20.0, rtol=1e-4, atol=1e-7
    )
    sag = start.p_object - seen.p_object
    assert float(sag @ weight) > 0.0
    assert float(np.abs(seen.v_object).max()) < 1e-7
    assert np.linalg.norm(sag) == pytest.approx(np.linalg.norm(weight) / (len(spec.arms) * k), rel=0.2)


@pytest.mark.parametrize("pads", PADS, ids=["100 N/m", "1e4 N/m", "1e6 N/m"])
def test_undriven_motion_gains_no_energy_at_any_stiffness(cell: Callable[..., PlantSpec], pads: GraspSpec) -> None:
    """Without friction and torque only the pads take energy out; linearising adds at most 3 mJ up to 7.5 rad/s."""
    plant = soft(cell(), replace(pads, damping_ratio=0.05))
    tau = np.zeros(plant.joint_count)
    energy = [plant.observe(tau).energy]
    for _ in range(100):
        plant.advance(tau, 4)
        energy.append(plant.observe(tau).energy)
    assert max(energy) < energy[0] + 3e-3
    assert float(np.abs(plant.dq).max()) > 1.0  # it did fall and swing


def test_stiff_pads_move_as_welds_do(cell: Callable[..., PlantSpec]) -> None:
    spec = cell(viscous(len(cell().arms[0].controlled)))
    welded, plant = Plant(spec), soft(spec, GraspSpec(1e6, 1e3))
    tau, _ = holding_torque(spec)
    tau = tau + 0.15 * np.sin(np.arange(len(tau)))
    for _ in range(60):
        welded.advance(tau, 5)
        plant.advance(tau, 5)
    assert float(np.abs(welded.q - welded.spec.arms[0].q_start[0]).max()) > 0.02
    np.testing.assert_allclose(plant.q, welded.q, atol=2e-3)
    np.testing.assert_allclose(plant.T_world_object.translation, welded.T_world_object.translation, atol=2e-4)
    a, b = plant.observe(tau), welded.observe(tau)
    assert a.energy == pytest.approx(b.energy, abs=5e-3)
    np.testing.assert_allclose(a.grasp_wrench[:, :3].sum(axis=0), b.grasp_wrench[:, :3].sum(axis=0), atol=0.05)


def test_free_object_takes_the_momentum_of_a_push() -> None:
    spec = planar_cell()
    plant = soft(spec, GraspSpec(1e4, 50.0), gravity=np.zeros(3))
    for arm in spec.names:
        plant.release(arm)
    plant.push(np.array([0.3, -0.2, 0.1, 0.0, 0.0, 1e-4]))
    plant.advance(np.zeros(6), 100)
    plant.push(np.zeros(6))
    plant.advance(np.zeros(6), 100)
    seen = plant.observe(np.zeros(6))
    np.testing.assert_allclose(seen.v_object[:3], np.array([0.3, -0.2, 0.1]) * 0.1 / spec.object.mass_kg, rtol=1e-9)
    assert seen.v_object[5] == pytest.approx(1e-4 * 0.1 / spec.object.inertia[2, 2], rel=1e-6)
    assert not seen.grasp_wrench.any()
    assert np.isnan(seen.contact_error_m).all()


def test_push_is_borne_by_the_grasps() -> None:
    spec = planar_cell(viscous(3))
    plant = soft(spec, GraspSpec(1e4, 50.0, damping_ratio=1.0))
    for arm in spec.names:
        plant.brake(arm, 1e6)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2]) + np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    plant.advance(np.zeros(6), 3000)
    seen = plant.observe(np.zeros(6))
    weight = -spec.object.mass_kg * spec.gravity
    np.testing.assert_allclose(seen.grasp_wrench[:, :3].sum(axis=0), weight - [3.0, 0.0, 0.0], atol=1e-4)


def test_released_arm_no_longer_acts_on_the_object() -> None:
    spec = planar_cell(viscous(3))
    plant = soft(spec, GraspSpec(1e4, 50.0))
    tau, _ = holding_torque(spec)
    plant.advance(tau, 50)
    plant.release("left")
    seen = plant.observe(tau)
    assert not seen.grasp_wrench[0].any()
    assert np.isnan(seen.contact_error_m[0])
    assert not np.isnan(seen.contact_error_m[1])
    plant.advance(tau, 300)
    assert plant.T_world_object.translation[1] < spec.object.p_world[1] - 1e-3


def test_observing_and_dividing_calls_change_no_bit(cell: Callable[..., PlantSpec]) -> None:
    spec = cell(viscous(len(cell().arms[0].controlled)))
    whole, parts = soft(spec, PADS[1]), soft(spec, PADS[1])
    tau = np.full(whole.joint_count, 0.05)
    whole.advance(tau, 40)
    for n in (1, 2, 3, 4, 7, 23):
        parts.advance(tau, n)
        parts.observe(-tau)
    assert whole.t == parts.t
    assert np.array_equal(whole.q, parts.q)
    assert np.array_equal(whole.dq, parts.dq)


def test_start_in_motion_takes_the_object_axes() -> None:
    spec = replace(planar_cell(names=("left",)), gravity=np.zeros(3))
    spec = replace(spec, grasp=PADS[0])
    plant = SoftPlant(spec)
    plant.release("left")
    R = plant.T_world_object.rotation
    plant.set_velocity(np.array([0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 1.0]))
    seen = plant.observe(np.zeros(3))
    np.testing.assert_allclose(seen.v_object, [*(R @ [0.1, 0.2, 0.3]), *(R @ [0.0, 0.0, 1.0])], atol=1e-15)


def test_divergence_is_refused() -> None:
    plant = soft(planar_cell(), PADS[1])
    with pytest.raises(PlantError, match="the motion of the plant"):
        plant.advance(np.full(6, 1e9), 50)


def test_what_cannot_be_a_pad_is_refused() -> None:
    with pytest.raises(PlantError, match="welded grasps"):
        SoftPlant(planar_cell())
    with pytest.raises(PlantError, match="stiffness_N_per_m"):
        GraspSpec(0.0, 1.0)
    with pytest.raises(PlantError, match="damping_ratio"):
        GraspSpec(1.0, 1.0, -0.1)
    with pytest.raises(PlantError, match="slip_N"):
        GraspSpec(1.0, 1.0, open_m=0.01)
    spec = planar_cell()
    with pytest.raises(GraspError, match="left"):
        soft(replace(spec, arms=(replace(spec.arms[0], q_start=np.zeros(3)), spec.arms[1])), PADS[0])


def test_a_substep_is_the_one_that_is_written_down() -> None:
    """One seized arm holds the object on a stiff pad: along x a mass on spring and damper, substep by substep."""
    pads = GraspSpec(2e4, 1e3, damping_ratio=0.1)
    spec = replace(planar_cell(viscous(3), names=("left",)), gravity=np.zeros(3))
    plant = soft(spec, pads)
    plant.brake("left", 1e12)
    F, m, K, h = 0.7, spec.object.mass_kg, pads.stiffness_N_per_m, spec.substep_s
    C = float(plant._pads.C[0, 0])
    plant.push(np.array([F, 0.0, 0.0, 0.0, 0.0, 0.0]))
    x = v = 0.0
    for _ in range(40):
        a = (F - K * (x + 0.5 * h * v) - C * v) / (m + 0.3 * h * h * K + 0.5 * h * C)
        x, v = x + h * (v + 0.5 * h * a), v + h * a
        plant.advance(np.zeros(3), 1)
        seen = plant.observe(np.zeros(3))
        assert seen.p_object[0] - spec.object.p_world[0] == pytest.approx(x, abs=2e-7)
        assert seen.v_object[0] == pytest.approx(v, abs=2e-4)
        assert seen.grasp_wrench[0, 0] == pytest.approx(-K * x - C * v, abs=1e-2)
    assert float(plant._pads.C[0, 1]) == pytest.approx(0.2 * np.sqrt(K * swinging_mass(spec)), rel=1e-9)


def swinging_mass(spec: PlantSpec) -> float:
    """Two directions over the trace of the arm's mobility J M⁻¹ Jᵀ in them, computed from the arm alone."""
    arm = spec.arms[0]
    model = arm_model(arm)
    model.armature = np.array(arm.rotor_inertia)
    data = model.createData()
    M = pin.crba(model, data, arm.q_start)
    frame = frame_number(model, arm.ee_frame)
    J = pin.computeFrameJacobian(model, data, arm.q_start, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
    return 2.0 / float(np.trace(J @ np.linalg.inv(M) @ J.T))


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.03)], ids=["centred", "off its centre"])
def test_free_object_keeps_its_angular_momentum(centre: tuple[float, float, float]) -> None:
    spec = replace(planar_cell(names=("left",)), gravity=np.zeros(3))
    body = replace(spec.object, inertia=np.diag([4e-5, 1e-4, 1.2e-4]), centre_m=np.array(centre))
    plant = SoftPlant(replace(spec, object=body, grasp=PADS[0], substep_s=1e-4))
    plant.release("left")
    plant.set_velocity(np.array([0.0, 0.0, 0.0, 0.1, 0.2, -0.1, 2.0, -3.0, 4.0]))

    def momenta() -> tuple[Vector, Vector]:
        seen, R = plant.observe(np.zeros(3)), plant.T_world_object.rotation
        r, w = R @ body.centre_m, seen.v_object[3:]
        linear = body.mass_kg * (seen.v_object[:3] + np.cross(w, r))
        return linear, R @ body.inertia @ R.T @ w + np.cross(seen.p_object + r, linear)

    before = momenta()
    plant.advance(np.zeros(3), 3000)
    assert pin.log3(plant.T_world_object.rotation) @ [1.0, -1.0, 1.0] != pytest.approx(0.0, abs=0.1)
    for one, other in zip(before, momenta(), strict=True):
        np.testing.assert_allclose(other, one, atol=0.01 * float(np.linalg.norm(one)))


def test_pose_is_of_the_present_whoever_asks_for_it_first(cell: Callable[..., PlantSpec]) -> None:
    asked, silent = soft(cell(), PADS[1]), soft(cell(), PADS[1])
    J = asked.joint_count
    tau, v = np.full(J, 0.05), np.concatenate([np.full(J, 0.3), np.zeros(6)])
    asked.advance(tau, 7)
    silent.advance(tau, 7)
    T = asked.T_world_object
    assert np.array_equal(T.translation, asked.observe(tau).p_object)
    assert float(np.abs(T.translation - asked.spec.object.p_world).max()) > 1e-6
    assert np.array_equal(silent.reported()[0], asked.q)
    for plant in (asked, silent):
        plant.advance(tau, 3)
    assert not np.array_equal(asked.q, silent.spec.arms[0].q_start)
    for plant in (asked, silent):
        plant.set_velocity(v)
        plant.advance(tau, 3)
    assert np.array_equal(asked.q, silent.q)
    assert asked.t == pytest.approx(13e-3)


def test_arm_that_is_let_go_in_motion_begins_as_pinocchio_says() -> None:
    spec = planar_cell(names=("left",))
    plant = soft(spec, PADS[1])
    plant.release("left")
    dq, tau = np.array([1.0, -2.0, 1.5]), np.array([0.1, 0.2, -0.1])
    plant.set_velocity(np.concatenate([dq, np.zeros(6)]))
    plant.advance(tau, 1)
    arm = spec.arms[0]
    model = arm_model(arm)
    model.armature, model.gravity = np.array(arm.rotor_inertia), pin.Motion(spec.gravity, np.zeros(3))
    model.jointPlacements[1] = arm.T_world_base * model.jointPlacements[1]
    bias = pin.rnea(model, model.createData(), arm.q_start, dq, np.zeros(3))
    a = np.linalg.solve(pin.crba(model, model.createData(), arm.q_start), tau - bias)
    np.testing.assert_allclose((plant.dq - dq) / spec.substep_s, a, rtol=1e-9)


def test_openings_are_those_of_the_kinematics_after_a_long_way(cell: Callable[..., PlantSpec]) -> None:
    plant = soft(cell(), PADS[0])
    tau = np.zeros(plant.joint_count)
    plant.advance(tau, 300)
    seen, T = plant.observe(tau), plant.T_world_object
    for i, (arm, part) in enumerate(zip(plant.spec.arms, plant.slices, strict=True)):
        model = arm_model(arm)
        data = model.createData()
        pin.framesForwardKinematics(model, data, seen.q[part])
        gap = (T * arm.T_object_ee).actInv(arm.T_world_base * data.oMf[frame_number(model, arm.ee_frame)])
        assert seen.contact_error_m[i] == pytest.approx(float(np.linalg.norm(gap.translation)), abs=2e-5)
        assert seen.contact_error_rad[i] == pytest.approx(float(np.linalg.norm(pin.log3(gap.rotation))), abs=2e-4)
    assert float(seen.contact_error_m.max()) > 1e-3


@pytest.mark.parametrize(
    ("v", "substeps"),
    [
        ([0.0] * 9, 10),
        ([0.0, 0.0, 0.2] + [0.0] * 6, 10),
        ([0.0, 0.0, -1.0] + [0.0] * 6, 5),
        ([1.0, 0.0, 0.0] + [0.0] * 6, 5),
        ([0.0] * 3 + [5.0, 5.0, 5.0, 0.0, 0.0, 0.0], 10),
        ([0.0] * 6 + [2.5, 0.0, 0.0], 2),
        ([0.0] * 6 + [0.0, 2.5, 0.0], 2),
        ([0.0] * 6 + [0.0, 0.0, 2.5], 2),
        ([100.0] + [0.0] * 8, 1),
    ],
)
def test_a_linearisation_lasts_ten_milliseconds_or_five_milliradians(v: list[float], substeps: int) -> None:
    plant = soft(planar_cell(names=("left",)), PADS[1])
    plant.set_velocity(np.array(v))
    assert plant._left == substeps
    made: list[int] = []
    again = plant._linearise
    plant._linearise = lambda: (made.append(1), again())[1]  # type: ignore[method-assign]
    plant.advance(np.zeros(3), substeps)
    assert made == []
    plant.advance(np.zeros(3), 1)
    assert made == [1]


def test_servos_report_the_torque_they_give() -> None:
    plant = soft(planar_cell(ActuatorSpec.of(3, torque_scale=1.1)), PADS[1])
    tau = np.array([0.3, -0.2, 0.1, 0.2, 0.1, -0.3])
    plant.advance(tau, 2)
    np.testing.assert_allclose(plant.reported()[2], tau, rtol=1e-12)


def test_motion_up_to_ten_thousand_per_second_is_no_divergence() -> None:
    plant = soft(replace(planar_cell(names=("left",)), gravity=np.zeros(3)), PADS[1])
    plant.release("left")
    for speed, diverges in ((9.9e3, False), (1.01e4, True)):
        plant.set_velocity(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, 0.0]))
        if diverges:
            with pytest.raises(PlantError, match="the motion of the plant"):
                plant.advance(np.zeros(3), 1)
        else:
            plant.advance(np.zeros(3), 1)


def test_push_acts_at_once_and_no_longer_than_it_lasts() -> None:
    plant = soft(replace(planar_cell(names=("left",)), gravity=np.zeros(3)), PADS[1])
    plant.release("left")
    tau, m, h = np.zeros(3), plant.spec.object.mass_kg, plant.spec.substep_s
    plant.advance(tau, 3)
    for force, v in ((0.4, 0.4), (-0.1, 0.3), (0.0, 0.3)):
        plant.push(np.array([force, 0.0, 0.0, 0.0, 0.0, 0.0]))
        plant.advance(tau, 1)
        assert plant.observe(tau).v_object[0] == pytest.approx(v * h / m, rel=1e-9)


def test_time_passes_at_rest_and_nothing_moves() -> None:
    plant = soft(planar_cell(), PADS[1])
    plant.rest(5)
    assert plant.t == pytest.approx(5e-3)
    assert np.array_equal(plant.q, np.concatenate([a.q_start for a in plant.spec.arms]))


def test_truth_is_told_for_the_torques_that_act() -> None:
    plant = soft(planar_cell(viscous(3)), PADS[1])
    tau = np.array([0.3, -0.2, 0.1, 0.2, 0.1, -0.3])
    plant.advance(tau, 200)
    seen = plant.observe(2.0 * tau)
    np.testing.assert_allclose(seen.tau_applied, 2.0 * tau)
    np.testing.assert_allclose(seen.tau_friction, -0.5 * plant.dq, atol=0.02 * float(np.abs(plant.dq).max()))
    assert float(np.abs(plant.dq).max()) > 0.05
    np.testing.assert_allclose(plant.observe(tau).tau_applied, tau)


def sticking() -> PlantSpec:
    spec = planar_cell()
    zero, one = np.zeros(3), np.ones(3)
    dry = FrictionSpec(0.1 * one, 0.1 * one, 0.3 * one, one, 0.05 * one, zero, 0.02 * one)
    return replace(spec, arms=tuple(replace(arm, friction=dry) for arm in spec.arms))


def test_dry_friction_holds_and_slides_as_between_welds() -> None:
    spec = sticking()
    welded, plant = Plant(spec), soft(spec, GraspSpec(1e6, 1e3))
    tau, _ = holding_torque(spec)
    for one in (welded, plant):
        one.advance(tau, 100)
    assert float(np.abs(plant.dq).max()) < 2e-3  # held
    for one in (welded, plant):
        one.advance(tau + np.array([0.6, -0.5, 0.3, 0.0, 0.0, 0.0]), 150)
    assert float(np.abs(welded.dq).max()) > 0.2
    np.testing.assert_allclose(plant.q, welded.q, atol=3e-3)
    a, b = plant.observe(tau), welded.observe(tau)
    np.testing.assert_allclose(a.tau_friction, b.tau_friction, atol=0.02)
    assert float(np.abs(b.tau_friction).max()) > 0.1


def test_brake_reaches_dry_friction() -> None:
    free, seized = soft(sticking(), PADS[1]), soft(sticking(), PADS[1])
    tau = holding_torque(free.spec)[0] + np.array([0.6, -0.5, 0.3, 0.0, 0.0, 0.0])
    for name in seized.spec.names:
        seized.brake(name, 1e4)
    for plant in (free, seized):
        plant.advance(tau, 400)
    assert float(np.abs(free.dq).max()) > 0.2
    assert float(np.abs(seized.dq).max()) < 1e-3


def test_a_turned_object_is_told_as_it_stands() -> None:
    plant = soft(planar_cell(), PADS[0], gravity=np.zeros(3))
    for arm in plant.spec.names:
        plant.release(arm)
    plant.push(np.array([0.0, 0.0, 0.0, 1e-3, 2e-3, -3e-3]))
    plant.advance(np.zeros(6), 400)
    seen = plant.observe(np.zeros(6))
    turned = pin.Quaternion(*seen.quat_object).toRotationMatrix()  # scalar first
    np.testing.assert_allclose(turned, plant.T_world_object.rotation, atol=1e-12)
    assert np.abs(seen.quat_object).min() > 0.01, "no part of it is zero"


def test_an_arm_swings_with_its_inverse_mean_mobility_and_not_at_all_where_it_has_none() -> None:
    M, J = np.diag([1.0, 2.0, 4.0]), np.zeros((6, 3))
    J[0, 0], J[1, 1], J[2, 2] = 1.0, 2.0, 2.0  # mobilities 1, 2, 1
    assert swinging_inertia(J @ np.linalg.inv(M) @ J.T).tolist() == [0.75, 0.75, 0.75, 0.0, 0.0, 0.0]
    J[3, 0] = J[4, 1] = 1.0  # 1 and 1/2, in two directions
    np.testing.assert_allclose(swinging_inertia(J @ np.linalg.inv(M) @ J.T)[3:], 2.0 / 1.5)


def test_a_grasp_that_closes_as_it_was_holds_as_if_it_had_not_opened(cell: Callable[..., PlantSpec]) -> None:
    spec = cell(viscous(len(cell().arms[0].controlled)))
    spec = replace(spec, grasp=GraspSpec(3e3, 20.0, damping_ratio=1.0))
    held, taken = SoftPlant(spec), HandledPlant(spec)
    taken.release(spec.names[0])
    taken.take_hold(0)
    tau, _ = holding_torque(spec)
    for plant in (held, taken):
        plant.push(np.array([0.5, 0.0, 0.5, 0.0, 0.02, 0.0]))
        plant.advance(tau, 100)
    np.testing.assert_allclose(taken.q, held.q, atol=1e-12)
    np.testing.assert_allclose(taken.observe(tau).grasp_wrench, held.observe(tau).grasp_wrench, atol=1e-9)
