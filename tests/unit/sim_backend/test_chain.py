"""The solver of the closed chain against pinocchio's other one, on states of cells that move."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.chain import Chain
from sim_backend.physics.plant import Plant
from sim_backend.physics.spec import PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell

CELLS: dict[str, Callable[[], PlantSpec]] = {
    "two planar arms": planar_cell,
    "one six-joint arm": lambda: spatial_cell(1),
    "two six-joint arms": lambda: spatial_cell(2),
    "four six-joint arms": lambda: spatial_cell(4),
    "eight six-joint arms": lambda: spatial_cell(8),
}
COUNT = 12
State = tuple[Vector, Vector, Vector]  # q (nq,), v (nv,), tau (nv,)


@pytest.fixture(params=CELLS.values(), ids=CELLS.keys())
def spec(request: pytest.FixtureRequest) -> PlantSpec:
    made: PlantSpec = request.param()
    return made


def states(spec: PlantSpec) -> Iterator[State]:
    """States of the cell under random torques, each far from the one before."""
    plant, rng = Plant(spec), np.random.default_rng(1)
    for _ in range(COUNT):
        torque = rng.normal(scale=0.4, size=plant.joint_count)
        plant.advance(torque, 15)
        yield plant._q, plant._v.copy(), np.concatenate([torque, np.zeros(6)])


class Reference:
    """`constraintDynamics` on the same composition."""

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self.forces = pin.StdVec_RigidConstraintData()
        for grasp in chain.grasps:
            self.forces.append(grasp.createData())
        self.data = chain.model.createData()
        pin.initConstraintDynamics(chain.model, self.data, chain.grasps, self.forces)

    def solve(self, q: Vector, v: Vector, tau: Vector) -> tuple[Vector, Vector]:
        """Acceleration (nv,) and the wrench of each arm on the object, one row each."""
        grasps, forces = self.chain.grasps, self.forces
        a = pin.constraintDynamics(self.chain.model, self.data, q, v, tau, grasps, forces, self.chain.proximal)
        return a.copy(), np.array([force.contact_force.vector for force in forces])


def assert_same(chain: Chain, reference: Reference, state: State) -> None:
    a, wrenches = reference.solve(*state)
    np.testing.assert_allclose(chain.acceleration(*state), a, atol=1e-9 * max(1.0, np.abs(a).max()))
    found = [grasp.wrench.vector for grasp in chain.grasp_states]
    np.testing.assert_allclose(found, wrenches, atol=1e-9 * max(1.0, np.abs(wrenches).max()))


def test_second_call_with_another_input_agrees_with_constraint_dynamics(spec: PlantSpec) -> None:
    chain = Chain(spec)
    reference = Reference(chain)
    for state in states(spec):
        assert_same(chain, reference, state)


def test_result_is_the_same_bit_for_bit_whatever_was_solved_before(spec: PlantSpec) -> None:
    used = Chain(spec)
    for state in states(spec):
        fresh = Chain(spec)
        assert used.acceleration(*state).tobytes() == fresh.acceleration(*state).tobytes()
        for grasp, expected in zip(used.grasp_states, fresh.grasp_states, strict=True):
            assert grasp.wrench.vector.tobytes() == expected.wrench.vector.tobytes()


def test_arms_that_let_go_are_solved_as_free_ones() -> None:
    spec = spatial_cell(3)
    chain = Chain(spec)
    state = next(states(spec))
    chain.acceleration(*state)
    chain.close((0, 2))
    assert_same(chain, Reference(chain), state)
    assert [grasp.arm for grasp in chain.grasp_states] == [0, 2]
    chain.close(())
    assert chain.grasp_states == []
    np.testing.assert_allclose(
        chain.acceleration(*state), pin.aba(chain.model, chain.model.createData(), *state), atol=1e-9
    )


def test_wrench_is_that_on_the_object_in_the_axes_of_the_grasp() -> None:
    """Newton and Euler for the object alone, from its acceleration and the wrenches of all grasps."""
    spec = spatial_cell(3)
    chain = Chain(spec)
    for q, v, tau in states(spec):
        a = pin.Motion(np.array(chain.acceleration(q, v, tau)[-6:]))
        twist, T = pin.Motion(v[-6:]), pin.XYZQUATToSE3(q[-7:])
        body = pin.Inertia(spec.object.mass_kg, np.zeros(3), np.array(spec.object.inertia))
        gravity = pin.Motion(T.rotation.T @ spec.gravity, np.zeros(3))
        needed = body * (a - gravity) + twist.cross(body * twist)
        total = sum((spec.arms[g.arm].T_object_ee.act(g.wrench) for g in chain.grasp_states), pin.Force.Zero())
        np.testing.assert_allclose(total.vector, needed.vector, atol=1e-7)
