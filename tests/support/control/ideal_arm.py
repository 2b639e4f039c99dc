"""An arm without limits or singularities: three prismatic joints and a spherical wrist, and N of them on one object.

The object's pose and twist are the only state; each arm follows the grasp.  Independent of the plant and of URDF.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from agent.control import known
from agent.control.errors import Gains
from agent.control.law import Offline
from agent.control.models import ArmModel, Scratch
from agent.control.terms import Terms
from agent.control.trajectory import Sinusoid
from drivers.interface import Vector

GRAVITY = np.array([0.3, -9.81, 0.4])


def ideal_model(T_object_ee: pin.SE3, mass_kg: float, rotor_inertia: float) -> ArmModel:
    """ArmModel of a translation joint and a ball joint; the end effector sits at the ball."""
    model = pin.Model()
    carriage = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "carriage")
    ball = model.addJoint(carriage, pin.JointModelSpherical(), pin.SE3.Identity(), "wrist")
    model.appendBodyToJoint(
        carriage, pin.Inertia(mass_kg, np.array([0.0, 0.02, 0.0]), 1e-3 * np.eye(3)), pin.SE3.Identity()
    )
    hand = pin.Inertia(0.3 * mass_kg, np.array([0.03, 0.0, 0.01]), np.diag([2e-3, 3e-3, 2.5e-3]))
    model.appendBodyToJoint(ball, hand, pin.SE3.Identity())
    model.gravity = pin.Motion(GRAVITY, np.zeros(3))
    model.armature = np.full(model.nv, rotor_inertia)
    arm = ArmModel.__new__(ArmModel)  # the constructor reads URDF, which has no ball joint
    arm.model = model
    arm.joints = ("x", "y", "z", "a", "b", "c")
    arm.n = model.nv
    arm.ee_id = model.addFrame(pin.Frame("ee", ball, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    arm.object_id = model.addFrame(pin.Frame("object", ball, arm.ee_id, T_object_ee.inverse(), pin.FrameType.OP_FRAME))
    arm.data = model.createData()
    arm.scratch = Scratch()
    arm.plane_normal, arm.task_basis = None, np.eye(6)
    arm.p_object_ee = T_object_ee.translation.copy()
    arm._p_ee_object = tuple((-T_object_ee.translation).tolist())
    arm.task_is_identity = True
    return arm


@dataclass
class IdealCell:
    """N ideal arms on one object."""

    models: list[ArmModel]
    grasps: list[pin.SE3]
    offlines: list[Offline]
    trajectory: Sinusoid

    def terms(self, t: float, T: pin.SE3, v: Vector) -> list[Terms]:
        """Each agent's tick with the object at T, moving with v (6,) in world axes."""
        return [terms for terms, _ in self._ticks(t, T, v)]

    def _ticks(self, t: float, T: pin.SE3, v: Vector) -> list[tuple[Terms, Vector]]:
        """Terms of each agent with the inverse (6, 6) of its arm's object Jacobian, written down from the geometry."""
        desired, found = self.trajectory.at(t), []
        for model, grasp, offline in zip(self.models, self.grasps, self.offlines, strict=True):
            ee = T * grasp
            R, (x, y, z) = ee.rotation, (ee.translation - T.translation).tolist()
            J_inv = np.zeros((6, 6))  # the carriage goes where the ball goes, the ball turns in its own axes
            J_inv[:3] = ((1, 0, 0, 0, z, -y), (0, 1, 0, -z, 0, x), (0, 0, 1, y, -x, 0))
            J_inv[3:, 3:] = R.T
            q = np.array(pin.SE3ToXYZQUATtuple(ee))
            found.append((known.torque(model, offline, q, J_inv.dot(v), desired), J_inv))
        return found

    def acceleration(self, t: float, T: pin.SE3, v: Vector) -> Vector:
        """Object acceleration (6,) of the coupled dynamics (`eq:coupled dynamics`) under all agents' torques."""
        first = self.offlines[0]
        R = T.rotation
        inertia = R.dot(np.array(first.object_inertia).reshape(3, 3)).dot(R.T)
        M = np.zeros((6, 6))
        M[:3, :3], M[3:, 3:] = first.object_mass_kg * np.eye(3), inertia
        f = np.concatenate([first.object_mass_kg * GRAVITY, -pin.skew(v[3:]).dot(inertia.dot(v[3:]))])
        for terms, J_inv in self._ticks(t, T, v):
            k = terms.kinematics
            dq, Jt_inv = J_inv.dot(v), J_inv.T
            M += Jt_inv.dot(k.B).dot(J_inv)
            f += Jt_inv.dot(terms.tau_cmd - k.C.dot(dq) - k.g + k.B.dot(J_inv.dot(k.dJ.dot(dq))))
        return np.linalg.solve(M, f)

    def step(self, t: float, T: pin.SE3, v: Vector, h: float) -> tuple[pin.SE3, Vector]:
        """One step of a fourth-order Runge–Kutta method on SE(3)."""

        def moved(twist: Vector, dt: float) -> pin.SE3:
            return pin.SE3(pin.exp3(dt * twist[3:]) @ T.rotation, T.translation + dt * twist[:3])

        a1 = self.acceleration(t, T, v)
        v2 = v + 0.5 * h * a1
        a2 = self.acceleration(t + 0.5 * h, moved(v, 0.5 * h), v2)
        v3 = v + 0.5 * h * a2
        a3 = self.acceleration(t + 0.5 * h, moved(v2, 0.5 * h), v3)
        v4 = v + h * a3
        a4 = self.acceleration(t + h, moved(v3, h), v4)
        mean = (v + 2 * v2 + 2 * v3 + v4) / 6
        return moved(mean, h), v + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6


def random_cell(rng: np.random.Generator) -> IdealCell:
    """One to four arms, random grasps, load shares and gains, and a random motion."""
    count = int(rng.integers(1, 5))
    shares = rng.dirichlet(np.ones(count))
    k_p, k_eps = rng.uniform(2.0, 4.0, 2)
    inertia = np.diag(rng.uniform(0.01, 0.02, 3))
    grasps = [pin.SE3(pin.SE3.Random().rotation, rng.uniform(-0.2, 0.2, 3)) for _ in range(count)]
    models = [ideal_model(g, rng.uniform(0.3, 0.8), rng.uniform(0.0, 0.05)) for g in grasps]
    offlines = []
    for share in shares:
        k_v = (*(rng.uniform(3.0, 6.0),) * 3, *(rng.uniform(0.1, 0.2),) * 3)
        gains = Gains((k_p,) * 3, (k_eps,) * 3, (k_p,) * 3, (k_eps,) * 3, k_v)
        offlines.append(Offline(gains, float(share), 0.5, tuple(inertia.ravel().tolist()), tuple(GRAVITY.tolist())))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    trajectory = Sinusoid(
        tuple(rng.uniform(-0.3, 0.3, 3)), tuple(rng.uniform(-0.1, 0.1, 3)), (1.0, 0.0, 0.0, 0.0), tuple(axis),
        float(rng.uniform(-0.5, 0.5)), float(rng.uniform(6.0, 12.0)),
    )  # fmt: skip
    return IdealCell(models, grasps, offlines, trajectory)
