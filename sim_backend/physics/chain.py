"""Forward dynamics of the closed chain by pinocchio's `lcaba`, and the wrenches in the grasps that are closed.

A result is a function of the call's arguments alone, bit for bit.  `lcaba` eliminates one arm after the other, so its
cost grows with their number; `constraintDynamics` factorises the system of all grasps at once.  Two traits of
pinocchio 4.1 are dealt with here (docs/decisions/0008-closed-chain-solver.md): `lcaba` reads the accelerations
`data.oa` that the call before it left there, and its `contact_force` has the opposite sign of `constraintDynamics`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.composition import Composition, compose
from sim_backend.physics.spec import PlantSpec


class GraspState(NamedTuple):
    """A closed grasp at the last evaluation, in the axes of the grasp on the object, at its origin.

    Its arrays are views of pinocchio's memory, taken once: asking for them takes longer than what they are for.
    """

    arm: int
    state: pin.RigidConstraintData  # whose memory that is
    force: Vector  # (3,) N of the object on the arm, as `lcaba` counts
    moment: Vector  # (3,) N·m
    p_ee: Vector  # (3,) m, of the end effector: the gap
    R_ee: Vector  # (3, 3)

    @property
    def wrench(self) -> pin.Force:
        """Of the arm on the object."""
        return pin.Force(-self.force, -self.moment)


class Chain:
    """A composition with pinocchio's working memory, and the grasps that are closed: all of them at first.

    Raises PlantError as `compose`.
    """

    def __init__(self, spec: PlantSpec) -> None:
        self.composition: Composition = compose(spec)
        self.model = self.composition.model
        self.proximal = pin.ProximalSettings(
            spec.proximal_accuracy, spec.proximal_accuracy, spec.proximal_mu, spec.proximal_iterations
        )
        self._no_acceleration = pin.StdVec_Motion()
        for _ in range(self.model.njoints):
            self._no_acceleration.append(pin.Motion.Zero())
        self.close(tuple(range(len(spec.arms))))

    def close(self, arms: tuple[int, ...]) -> None:
        """Hold the object with these arms and no others."""
        self.closed = arms
        self.grasps = pin.StdVec_RigidConstraintModel()
        self.states = pin.StdVec_RigidConstraintData()
        for i in arms:
            self.grasps.append(self.composition.grasps[i])
            self.states.append(self.composition.grasps[i].createData())
        self.data = self.model.createData()
        pin.computeJointMinimalOrdering(self.model, self.data, self.grasps)
        self.grasp_states = [_views(arm, self.states[i]) for i, arm in enumerate(arms)]

    def acceleration(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """View (nv,) of pinocchio's buffer; the next call overwrites it."""
        self.data.oa = self._no_acceleration  # what the last call left here would enter this one
        a: Vector = pin.lcaba(self.model, self.data, q, v, tau, self.grasps, self.states, self.proximal)
        return a

    def jump(self, q: Vector, v: Vector, given: Vector, rotor_inertia: Vector) -> Vector:
        """Change (nv,) of the velocities by momenta (J,) N·m·s given to the joints at once, which have these rotors."""
        tau = np.zeros(self.model.nv)
        self.model.armature[: len(given)] = rotor_inertia
        before = self.acceleration(q, v, tau).copy()
        tau[: len(given)] = given
        changed: Vector = self.acceleration(q, v, tau) - before
        return changed


def _views(arm: int, state: pin.RigidConstraintData) -> GraspState:
    wrench, T_grasp_ee = state.contact_force, state.c1Mc2
    return GraspState(arm, state, wrench.linear, wrench.angular, T_grasp_ee.translation, T_grasp_ee.rotation)
