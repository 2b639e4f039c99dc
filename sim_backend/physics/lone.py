"""One arm on its own, holding nothing: the dynamics that a real arm has while its object is simulated elsewhere.

The integration of plant.py without its grasps: drift, kick, drift with friction as an implicit coefficient.  Its joints
have end stops, as what falls or is pushed must come to lie where a hand, or its servos, can lead it back from.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import Servos
from sim_backend.physics.free_arm import FreeArms
from sim_backend.physics.gears import gears
from sim_backend.physics.joints import dry_friction
from sim_backend.physics.spec import PlantSpec, diverged
from sim_backend.physics.stops import EndStops


class LoneArm:
    """One arm of a cell, by its place in `spec.arms`, from its start pose on; arrays are (n,), controlled joints.

    Raises PlantError as `arm_model`.
    """

    def __init__(self, spec: PlantSpec, arm: int) -> None:
        alone = replace(spec, arms=(spec.arms[arm],), happenings=())
        self.name = alone.arms[0].name
        self.substep_s = spec.substep_s
        self.servos = Servos([alone.arms[0].actuator])
        self._dry, self._gears = dry_friction(alone), gears(alone)
        self._free, self._touched = FreeArms(alone), FreeArms(alone)
        self._rotor_inertia = np.array(self._free.model.armature)
        self.q: Vector = np.array(alone.arms[0].q_start)
        inertia = np.diag(self._touched.terms(self.q, np.zeros_like(self.q))[0])
        model = self._free.model
        self._stops = EndStops(model.lowerPositionLimit, model.upperPositionLimit, inertia, spec.substep_s)
        self.dq: Vector = np.zeros_like(self.q)
        self._a: Vector = np.zeros_like(self.q)
        self._wrench: Vector | None = None
        self.t = 0.0

    def touch(self, wrench_world: Vector) -> None:
        """Push at the end effector from now on: wrench (6,) N, N·m, world axes; zeros end it."""
        self._wrench = np.array(wrench_world, dtype=np.float64) if np.any(wrench_world) else None

    def brake(self, viscous_Nms_rad: float) -> None:
        """Replace the viscous friction of its joints: large for a seized gear."""
        joints = slice(0, len(self.q))
        self.servos.set_viscous(joints, viscous_Nms_rad)
        if self._dry is not None:
            self._dry.set_viscous(joints, viscous_Nms_rad)

    def end_effector(self) -> pin.SE3:
        """Its true pose, world."""
        self._touched.terms(self.q, self.dq)
        return pin.SE3(self._touched.end_effector(0)[1])

    def rest(self) -> None:
        """Let one substep pass on a support."""
        self.t += self.substep_s

    def advance(self, tau_Nm: Vector) -> None:
        """Let one substep pass under motor commands (n,).  Raises PlantError when the motion is no longer finite."""
        if self._gears is not None and self._gears.meets:
            self.dq = self.dq + self._gears.meet(self.dq, self._jump)[0]
        h, dq, model, geared = self.substep_s, self.dq, self._free.model, self._gears
        self.servos.command(tau_Nm)
        q_mid, dq_mid = self.q + 0.5 * h * dq, dq + 0.5 * h * self._a
        motor = given = self.servos.motor_torque(dq if geared is None else geared.speed)
        if geared is not None:
            motor = geared.passed(given)
        if self._dry is None:
            friction, constant = self.servos.friction_coefficient(dq_mid), np.zeros_like(dq)
        else:
            self._dry.load(motor)
            friction, constant = self._dry.torque(dq)
        stops = self._stops.torque(self.q)
        if stops is not None:
            friction, constant = friction + stops[0], constant + stops[1]
        if geared is None:
            model.armature = self._rotor_inertia + 0.5 * h * friction
        else:
            model.armature = geared.inertia + geared.ahead_s * friction
        tau = motor + constant - friction * dq + self._touch(q_mid)
        self._a = np.array(pin.aba(model, self._free.data, q_mid, dq_mid, tau))
        self.dq = dq + h * self._a
        self.q = q_mid + 0.5 * h * self.dq
        self.t += h
        if geared is not None:
            geared.step(given, self.dq, self._a)
        if self._dry is not None:
            self._dry.step(self.dq - 0.5 * h * self._a)
        if not math.isfinite(float(self.dq.dot(self.dq))):
            raise diverged(f"the motion of arm {self.name} on its own", self.t)

    def _jump(self, given: Vector) -> Vector:
        """Change (n,) of its speeds by momenta (n,) N·m·s that are given to its joints at once."""
        assert self._gears is not None
        M = self._touched.terms(self.q, self.dq)[0] + np.diag(self._gears.added)
        return np.asarray(np.linalg.solve(M, given), dtype=np.float64)

    def _touch(self, q: Vector) -> Vector:
        """Joint torques (n,) of what pushes at the end effector."""
        if self._wrench is None:
            return np.zeros_like(q)
        self._touched.terms(q, self.dq)
        tau: Vector = self._touched.end_effector(0)[0].T @ self._wrench
        return tau
