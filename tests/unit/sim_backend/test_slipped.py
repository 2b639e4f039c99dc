"""Grasps that have slipped: what the arm loses the object gets, at one place, and no energy comes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.free_arm import FreeArms
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.openings import Openings
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspSpec, PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell
from tests.support.plant.soft_cells import soft, viscous

SLIPPERY = GraspSpec(2e3, 20.0, damping_ratio=0.25, slip_N=3.0, slip_Nm=0.05, open_m=1.0)


def slipped_cell(pads: GraspSpec = SLIPPERY, moment_Nm: float = 0.2) -> SoftPlant:
    """Two six-joint arms whose pads have been pushed millimetres and tens of milliradians aside, and are in motion."""
    plant = soft(spatial_cell(2), pads)
    plant.push(np.array([0.0, 9.0, 2.0, 0.0, moment_Nm, 0.0]))
    plant.advance(np.zeros(plant.joint_count), 100)
    plant.push(np.zeros(6))
    seen = plant.observe(np.zeros(plant.joint_count))
    assert seen.slip_m.min() > 2e-3
    return plant


def ends(plant: SoftPlant) -> Iterator[tuple[int, Vector, Vector]]:
    """Of each arm its number, the Jacobian (6, n) of its end effector, and its place from the object's origin."""
    arms = FreeArms(plant.spec)
    arms.terms(plant.q, plant.dq)
    for i, own in enumerate(plant.slices):
        jacobian, pose = arms.end_effector(i)
        yield i, jacobian[:, own].copy(), pose.translation - plant.T_world_object.translation


def about_origin(wrench: Vector, lever: Vector) -> Vector:
    return np.concatenate([wrench[:3], wrench[3:] + np.cross(lever, wrench[:3])])


def test_what_momentum_the_arms_lose_at_their_end_effectors_the_object_gets_both_linear_and_angular() -> None:
    """Substep by substep, each on its own linearisation, while pads slide and afterwards."""
    plant = slipped_cell()
    plant.meter_grasps()
    tau = np.zeros(plant.joint_count)
    for substep in range(60):
        plant._left = 0
        geometry, v = list(ends(plant)), plant.observe(tau).v_object
        plant.advance(tau, 1)
        on_joints = plant.grasp_torque()
        a = (plant.observe(tau).v_object - v) / plant.spec.substep_s
        got = plant._M[plant.joint_count :, plant.joint_count :] @ a + plant._c[plant.joint_count :]
        given = sum(
            about_origin(np.linalg.solve(jacobian.T, -on_joints[plant.slices[i]]), lever)
            for i, jacobian, lever in geometry
        )
        np.testing.assert_allclose(given, got, rtol=0.0, atol=1e-9, err_msg=f"substep {substep}")


def test_the_wrench_that_is_told_is_the_one_that_acts_at_the_end_effector() -> None:
    plant = slipped_cell()
    tau, J = np.zeros(plant.joint_count), plant.joint_count
    plant._arrive()
    plant._linearise()
    seen, pads = plant.observe(tau), plant._pads
    pulls = pads.K * (plant._phi - pads.slipped) + pads.C * plant._openings.G.dot(plant._v).reshape(-1, 6)
    acting = -plant._openings.G.T @ pulls.ravel()
    np.testing.assert_allclose(
        sum(about_origin(seen.grasp_wrench[i], lever) for i, _, lever in ends(plant)), acting[J:], atol=1e-12
    )
    for i, jacobian, _ in ends(plant):
        np.testing.assert_allclose(-jacobian.T @ seen.grasp_wrench[i], acting[:J][plant.slices[i]], atol=1e-12)


def test_an_object_that_hangs_on_slipped_pads_is_in_equilibrium_under_what_the_arms_give() -> None:
    """Millimetres times newtons: 0.02 N·m were missing when the object got the force at its grasp."""
    plant = soft(spatial_cell(2), replace(SLIPPERY, slip_Nm=0.5, damping_ratio=1.0))
    tau = np.zeros(plant.joint_count)
    for arm in plant.spec.names:
        plant.brake(arm, 1e4)
    plant.push(np.array([0.0, 7.0, 0.0, 0.0, 0.0, 0.0]))
    for _ in range(4000):
        plant.advance(tau, 1)
        if plant.observe(tau).slip_m.max() > 8e-3:
            break
    plant.push(np.zeros(6))
    plant.advance(tau, 4000)
    seen = plant.observe(tau)
    assert seen.slip_m.min() > 7e-3
    net = sum(about_origin(seen.grasp_wrench[i], lever) for i, _, lever in ends(plant))
    spec = plant.spec
    np.testing.assert_allclose(net, [*(-spec.object.mass_kg * spec.gravity), 0.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("made", [planar_cell, lambda: spatial_cell(3)], ids=["planar", "spatial"])
def test_slip_never_makes_energy(made: Callable[[], PlantSpec]) -> None:
    """Undriven and without friction and damping, after slips of centimetres and 0.1 to 0.8 rad.

    What is left is that of linearising, 0.2 and 0.5 mJ; it was 11 and 4 mJ when what had slipped kept its direction in
    the world and the object got the force at its grasp.
    """
    plant = soft(made(), GraspSpec(1e4, 50.0, damping_ratio=0.0, slip_N=20.0, slip_Nm=0.5, open_m=1.0))
    tau = np.zeros(plant.joint_count)
    plant.push(np.array([10.0, 30.0, 10.0, 0.5, 1.0, 1.0]))
    plant.advance(tau, 60)
    plant.push(np.zeros(6))
    assert plant.observe(tau).slip_rad.max() > 0.1
    energy = [plant.observe(tau).energy]
    for _ in range(400):
        plant.advance(tau, 1)
        energy.append(plant.observe(tau).energy)
    told = np.array(energy)
    assert (told - np.minimum.accumulate(told)).max() < 1e-3
    assert told[-1] < told[0] - 0.1


def test_giving_way_takes_energy_out_of_the_springs_and_never_adds_any(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = slipped_cell()
    pads, slip, changes = plant._pads, plant._pads.slip, list[float]()

    def watched(opening: Vector, R: Vector) -> tuple[int, ...]:
        before = pads.energy(opening)
        opened = slip(opening, R)
        changes.append(pads.energy(opening) - before)
        return opened

    monkeypatch.setattr(pads, "slip", watched)
    plant.push(np.array([0.0, 9.0, 0.0, 0.0, 0.0, 0.3]))
    plant.advance(np.zeros(plant.joint_count), 60)
    assert max(changes) <= 0.0
    assert min(changes) < -1e-4


def test_a_pad_touches_at_the_end_effector_from_the_substep_after_it_first_gave_way() -> None:
    plant = soft(spatial_cell(2), SLIPPERY)
    plant.push(np.array([0.0, 9.0, 2.0, 0.0, 0.2, 0.0]))
    tau = np.zeros(plant.joint_count)
    while not plant._pads.slip_m[0]:
        assert not plant._openings.touches(0)
        plant.advance(tau, 1)
    plant.advance(tau, 1)
    assert plant._openings.touches(0)


def test_a_pad_that_goes_on_slipping_costs_no_linearisation_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = soft(spatial_cell(2), replace(SLIPPERY, open_m=1.0))
    plant.push(np.array([0.0, 9.0, 2.0, 0.0, 0.2, 0.0]))
    tau, made, linearise = np.zeros(plant.joint_count), list[float](), plant._linearise

    def counted() -> None:
        made.append(plant.t)
        linearise()

    monkeypatch.setattr(plant, "_linearise", counted)
    while not plant._pads.slip_m.all():
        plant.advance(tau, 1)
    plant.advance(tau, 1)
    made.clear()
    for k in range(60):
        before = plant._pads.slip_m.copy()
        plant.advance(tau, 1)
        assert (plant._pads.slip_m > before).any(), k
    assert len(made) < 60


def test_what_has_slipped_turns_with_the_object_over_many_linearisations() -> None:
    spec = replace(planar_cell(viscous(3), names=("left",)), gravity=np.zeros(3))
    plant, tau = soft(spec, GraspSpec(2e3, 2.0, damping_ratio=1.0, slip_N=4.0)), np.zeros(3)
    plant.brake("left", 1e6)
    plant.push(np.array([7.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    plant.advance(tau, 100)
    plant.push(np.zeros(6))
    plant.advance(tau, 500)
    slipped, R = plant._pads.slipped[0, :3].copy(), plant.T_world_object.rotation.copy()
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.8]))
    plant.advance(tau, 1000)
    turn = plant.T_world_object.rotation @ R.T
    assert float(np.linalg.norm(pin.log3(turn))) > 0.3
    assert float(np.linalg.norm(slipped)) > 4e-3
    np.testing.assert_allclose(plant._pads.slipped[0, :3], turn @ slipped, atol=1e-6)


# --- the rate of openings ---------------------------------------------------------------------------------------------


def measured(plant: SoftPlant, q: Vector, T: pin.SE3, slipped: Vector) -> tuple[Vector, Openings]:
    arms = FreeArms(plant.spec)
    arms.terms(q, np.zeros_like(q))
    openings = Openings(arms, [arm.T_object_ee for arm in plant.spec.arms], len(q))
    return openings.measure(T, np.ones((len(plant.spec.arms), 1)), slipped), openings


def test_the_rate_of_a_slipped_opening_is_that_in_axes_that_turn_with_the_object() -> None:
    plant = slipped_cell(moment_Nm=1.0)
    rng, h = np.random.default_rng(2), 1e-6
    q, T, slipped = plant.q, plant.T_world_object, np.ones((2, 6))
    dq, v = rng.normal(size=len(q)), rng.normal(size=6)
    phi, openings = measured(plant, q, T, slipped)
    assert np.linalg.norm(phi[:, 3:], axis=1).max() > 0.05
    ahead = []
    for t in (-h, h):
        moved = pin.SE3(pin.exp3(t * v[3:]) @ T.rotation, T.translation + t * v[:3])
        later = measured(plant, q + t * dq, moved, slipped)[0].reshape(2, 2, 3)
        ahead.append(np.einsum("ij,abj->abi", T.rotation @ moved.rotation.T, later).reshape(2, 6))
    rate = openings.G @ np.concatenate([dq, v])
    np.testing.assert_allclose(rate.reshape(2, 6), (ahead[1] - ahead[0]) / (2.0 * h), atol=1e-7)


def test_without_slip_a_pad_pulls_at_the_grasp_to_the_bit() -> None:
    plant = soft(spatial_cell(2), GraspSpec(2e3, 20.0))
    plant.advance(np.zeros(plant.joint_count), 50)
    q, T, J = plant.q, plant.T_world_object, plant.joint_count
    _, openings = measured(plant, q, T, np.zeros((2, 6)))
    for i, arm in enumerate(plant.spec.arms):
        rows = openings.G[6 * i : 6 * i + 6]
        assert np.array_equal(rows[:3, J + 3 :], pin.skew((T * arm.T_object_ee).translation - T.translation))
        assert np.array_equal(rows[:, J : J + 3], -np.eye(6, 3))
        assert np.array_equal(rows[3:, J + 3 :], -np.eye(3))
        assert not openings.touches(i)
    pulls = np.arange(12.0).reshape(2, 6)
    assert np.array_equal(openings.wrenches(pulls.copy()), pulls)


def test_a_grasp_that_is_open_touches_nothing_whatever_had_slipped_in_it() -> None:
    plant = slipped_cell()
    arms = FreeArms(plant.spec)
    arms.terms(plant.q, plant.dq)
    openings = Openings(arms, [arm.T_object_ee for arm in plant.spec.arms], plant.joint_count)
    closed, slipped = np.array([[1.0], [0.0]]), np.full((2, 6), 1e-3)
    openings.keep(closed)
    openings.measure(plant.T_world_object, closed, slipped)
    assert [openings.touches(i) for i in range(2)] == [True, False]
    assert not openings.G[6:].any()


def test_bounds_that_are_not_reached_change_no_bit() -> None:
    free, bounded = (
        soft(spatial_cell(2), replace(GraspSpec(1e4, 50.0), **bounds))
        for bounds in ({}, {"slip_N": 1e5, "slip_Nm": 1e5, "open_m": 1.0})
    )
    for plant in (free, bounded):
        plant.push(np.array([1.0, 2.0, 0.5, 0.0, 0.1, 0.0]))
        plant.advance(np.full(plant.joint_count, 0.05), 150)
    assert np.array_equal(free.q, bounded.q)
    assert np.array_equal(free.dq, bounded.dq)
    assert np.array_equal(free._phi, bounded._phi)


def test_a_grasp_that_has_slipped_and_is_taken_again_where_it_was_pulls_at_the_grasp() -> None:
    spec = replace(spatial_cell(2), grasp=SLIPPERY)
    plant, fresh = HandledPlant(spec), HandledPlant(spec)
    plant.push(np.array([0.0, 9.0, 2.0, 0.0, 0.2, 0.0]))
    plant.advance(np.zeros(plant.joint_count), 100)
    assert plant._openings.touches(0)
    plant.push(np.zeros(6))
    for one in (plant, fresh):
        one.let_go(np.concatenate([arm.q_start for arm in spec.arms]), spec.object.T_world_object)
        one.take_hold(0)
        one.take_hold(1)
    assert not plant._openings.touches(0)
    assert np.array_equal(plant._openings.G, fresh._openings.G)
