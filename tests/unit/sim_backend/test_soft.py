"""Grasps that give, against mechanics that can be written on paper and against the welded plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.plant import Plant
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspError, GraspSpec, PlantError, PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell
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


def soft(spec: PlantSpec, pads: GraspSpec, **changes: object) -> SoftPlant:
    return SoftPlant(replace(spec, grasp=pads, **changes))  # type: ignore[arg-type]


def viscous(n: int) -> ActuatorSpec:
    return ActuatorSpec.of(n, viscous_Nms_rad=0.5)


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


def pulled(pads: GraspSpec, force_N: float) -> tuple[SoftPlant, Vector]:
    """One braked arm holds the object, which is pulled along x without gravity."""
    spec = replace(planar_cell(viscous(3), names=("left",)), gravity=np.zeros(3))
    plant = soft(spec, pads)
    plant.brake("left", 1e6)
    plant.push(np.array([force_N, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return plant, np.zeros(3)


def test_pad_holds_below_its_bound_and_slips_above_for_good() -> None:
    pads = GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_N=4.0)
    plant, tau = pulled(pads, 3.9)
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_m[0] == pytest.approx(3.9 / 2e3, rel=1e-3)
    plant.push(np.zeros(6))
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_m[0] < 1e-6
    plant.push(np.array([6.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    plant.advance(tau, 60)
    plant.push(np.zeros(6))
    plant.advance(tau, 1000)
    seen = plant.observe(tau)
    assert seen.contact_error_m[0] > 1e-3
    assert np.linalg.norm(seen.grasp_wrench[0, :3]) < 1e-3


def test_pad_that_has_slipped_too_far_opens() -> None:
    plant, tau = pulled(GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_N=4.0, open_m=5e-3), 8.0)
    plant.advance(tau, 400)
    seen = plant.observe(tau)
    assert np.isnan(seen.contact_error_m[0])
    assert not seen.grasp_wrench.any()


def test_pad_slips_under_a_moment() -> None:
    plant, tau = pulled(GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_Nm=0.1), 0.0)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.09]))
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_rad[0] == pytest.approx(0.09 / 20.0, rel=1e-2)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2]))
    plant.advance(tau, 200)
    assert plant.observe(tau).contact_error_rad[0] > 0.02


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
