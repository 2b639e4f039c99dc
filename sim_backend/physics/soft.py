"""The physics of a cell whose grasps give: every arm and the object on their own, joined by springs and dampers.

Between two linearisations the cell is M a + c = τ − D v − Gᵀ W with constant M, c and G; G maps joint velocities and
the object's twist to the rate of the grasps' openings φ, and W = K (φ − s) + C φ̇ (pads.py).  Per substep h

    (M + h/2 D + Gᵀ S G) a = τ + f − D v − c − Gᵀ (K (φ + h/2 φ̇ − s) + C φ̇),   S = κ h² K + h/2 C
    v⁺ = v + h a,   q⁺ = q ⊕ h (v + v⁺)/2,   φ⁺ = φ + h G (v + v⁺)/2

With κ ≥ 1/4 the step is stable at any stiffness: what K adds beyond the trapezoidal rule is a mass and takes no energy
out, C does.  A linearisation lasts `relinearise_s`, or as long as the fastest joint needs for 5 mrad.

Measured on cells that swing freely for 0.4 s at up to 7.5 rad/s, h = 1 ms, pads of 1e2 to 1e6 N/m: the energy grows by
at most 2.3 mJ of 9.7 J (first order in h).  With 1e6 N/m driven joints stay within 2 mrad of the welded plant's.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import Servos
from sim_backend.physics.composition import check_start
from sim_backend.physics.free_arm import FreeArm, swinging_inertia
from sim_backend.physics.joints import dry_friction
from sim_backend.physics.pads import Pads
from sim_backend.physics.plant import Observation
from sim_backend.physics.spec import PlantError, PlantSpec

MAX_TURN_RAD: Final = 5e-3  # of a joint, on one linearisation
FASTEST: Final = 1e4  # rad/s, m/s; faster is divergence


class SoftPlant:
    """The simulated cell with grasps that give.  (J,) arrays hold the controlled joints of all arms, arm after arm.

    Raises PlantError (GraspError) when the cell cannot be built, or an arm does not start on its grasp.
    """

    def __init__(self, spec: PlantSpec) -> None:
        if spec.grasp is None or not spec.arms:
            raise PlantError("grasp", found="none", expected="arms with pads", remedy="use Plant for welded grasps")
        check_start(spec)
        self.spec = spec
        self.servos = Servos([arm.actuator for arm in spec.arms])
        self._dry = dry_friction(spec)
        self._arms = [FreeArm(arm, spec.gravity) for arm in spec.arms]
        ends = np.cumsum([a.n for a in self._arms]).tolist()
        self.slices = tuple(slice(e - a.n, e) for e, a in zip(ends, self._arms, strict=True))
        self.joint_count = J = int(ends[-1])
        self._T = spec.object.T_world_object
        self._q: Vector = np.concatenate([a.q_start for a in spec.arms])
        self._v: Vector = np.zeros(J + 6)  # object's twist last: of its frame, world axes
        self._h = spec.substep_s
        swinging = [swinging_inertia(a, s.q_start) for a, s in zip(self._arms, spec.arms, strict=True)]
        self._pads = Pads(spec.grasp, np.array(swinging), spec.substep_s)
        self._push: Vector = np.zeros(6)
        self._tau_motor: Vector = np.zeros(J)
        self._tau_friction: Vector = np.zeros(J)
        self._substeps = 0
        self._linearise()

    @property
    def t(self) -> float:
        """Time since the start, s."""
        return self._substeps * self._h

    @property
    def q(self) -> Vector:
        """True joint positions (J,) rad, a copy."""
        return self._q.copy()

    @property
    def dq(self) -> Vector:
        """True joint velocities (J,) rad/s, a copy."""
        return self._v[: self.joint_count].copy()

    @property
    def T_world_object(self) -> pin.SE3:
        """True pose of the object."""
        return pin.SE3(self._T)

    def set_velocity(self, v: Vector) -> None:
        """Start in motion: joint velocities (J,), then the object's twist (6,) in object axes, linear first."""
        J, R = self.joint_count, self._T.rotation
        self._v = np.concatenate([v[:J], R @ v[J : J + 3], R @ v[J + 3 :]])
        self._linearise()

    def _linearise(self) -> None:
        """M, c, G and φ at the present pose, and for how many substeps they will do."""
        J, h, v = self.joint_count, self._h, self._v
        N = len(self._arms)
        M, c, G = np.zeros((J + 6, J + 6)), np.zeros(J + 6), np.zeros((N, 6, J + 6))
        self._phi: Vector = np.zeros((N, 6))
        for i, (arm, part) in enumerate(zip(self._arms, self.slices, strict=True)):
            M[part, part], c[part], G[i, :, part], T_world_ee = arm.terms(self._q[part], v[part])
            T_world_grasp = self._T * self.spec.arms[i].T_object_ee
            G[i, :3, J : J + 3] = G[i, 3:, J + 3 :] = -np.eye(3)
            G[i, :3, J + 3 :] = pin.skew(T_world_grasp.translation - self._T.translation)
            turned = pin.log3(T_world_grasp.rotation.T @ T_world_ee.rotation)
            self._phi[i, :3] = T_world_ee.translation - T_world_grasp.translation
            self._phi[i, 3:] = T_world_grasp.rotation @ turned
        M[J:, J:], c[J:] = self._object_terms()
        self._G = (G * self._pads.closed[:, :, None]).reshape(6 * N, J + 6)
        self._Gt = np.ascontiguousarray(self._G.T)
        self._M, self._c = M, c
        self._A = M + (self._Gt * self._pads.implicit.ravel()) @ self._G
        self._pads.turn(self._T.rotation)
        fastest = max(float(np.abs(v[:J]).max()), 1e-9)
        self._left = max(1, math.floor(min(self.spec.relinearise_s, MAX_TURN_RAD / fastest) / h + 1e-9))

    def _object_terms(self) -> tuple[Vector, Vector]:
        """Inertia (6, 6) and bias (6,) of the object, world axes."""
        body, R, w = self.spec.object, self._T.rotation, self._v[-3:]
        m, inertia, r = body.mass_kg, R @ body.inertia @ R.T, R @ body.centre_m
        M, S = np.zeros((6, 6)), pin.skew(r)
        M[:3, :3], M[3:, 3:] = m * np.eye(3), inertia - m * S @ S
        M[:3, 3:], M[3:, :3] = -m * S, m * S
        force = m * (np.cross(w, np.cross(w, r)) - self.spec.gravity)
        return M, np.concatenate([force, np.cross(r, force) + np.cross(w, inertia @ w)])

    def advance(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        """Integrate under commands (J,) that act unchanged; every effect of the motors but their delay is applied.

        Raises PlantError when the motion is no longer finite.
        """
        self.servos.command(tau_cmd_Nm)
        with np.errstate(all="ignore"):  # what overflows is refused below, with more to say than numpy has
            for _ in range(substeps):
                if self._left == 0:
                    self._linearise()
                self._substep()
        np.copyto(self._tau_motor, self.servos.motor_torque(self._v[: self.joint_count]))
        self._substeps += substeps
        if not float(np.abs(self._v).max()) < FASTEST:
            raise PlantError(
                "the motion of the plant",
                found=f"no finite number at t = {self.t:.4f} s",
                expected="finite velocities",
                remedy="the control loop is unstable or substep_s is too long",
            )

    def _substep(self) -> None:
        J, h, v, pads, G = self.joint_count, self._h, self._v, self._pads, self._G
        dq = v[:J]
        motor = self.servos.motor_torque(dq)
        D, f = self._friction(motor, dq)
        inverse = self._inverted(D)
        phi_dot = G.dot(v).reshape(-1, 6)
        W = pads.K * (self._phi + (0.5 * h) * phi_dot - pads.slipped) + pads.C * phi_dot
        b = -self._c - self._Gt.dot(W.ravel())
        b[:J] += motor + f - D * dq
        b[J:] += self._push
        a = inverse.dot(b)
        mean: Vector = v + (0.5 * h) * a
        self._tau_friction = f - D * mean[:J]
        if self._dry is not None:
            self._dry.step(mean[:J])
        self._v = v + h * a
        self._q = self._q + h * mean[:J]
        turn = pin.exp3(h * mean[J + 3 :])
        self._T = pin.SE3(turn @ self._T.rotation, self._T.translation + h * mean[J : J + 3])
        self._phi = self._phi + (h * G.dot(mean)).reshape(-1, 6)
        self._left -= 1
        for grasp in pads.slip(self._phi, self._T.rotation):
            self.release(self.spec.names[grasp])

    def _friction(self, motor: Vector, dq: Vector) -> tuple[Vector, Vector]:
        """(D, f), each (J,): the friction torque is −D (dq + dq⁺)/2 + f."""
        if self._dry is None:
            return self.servos.friction_coefficient(dq), np.zeros_like(dq)
        self._dry.load(motor)
        return self._dry.torque(dq)

    def _inverted(self, D: Vector) -> Vector:
        """Inverse of M + h/2 D + Gᵀ S G."""
        A: Vector = self._A.copy()
        diagonal = np.arange(self.joint_count)
        A[diagonal, diagonal] += 0.5 * self._h * D
        return np.asarray(np.linalg.inv(A), dtype=np.float64)

    def rest(self, substeps: int) -> None:
        """Let time pass while the cell rests on a support."""
        self._substeps += substeps

    def reported(self) -> tuple[Vector, Vector, Vector]:
        """What the servos say: positions (J,) rad, velocities (J,) rad/s, torques (J,) N·m estimated from current."""
        s = self.servos
        return (
            s.reported_position(self._q),
            s.reported_velocity(self._v[: self.joint_count]),
            s.reported_torque(self._tau_motor),
        )

    def observe(self, tau_cmd_Nm: Vector) -> Observation:
        """What is true now, with commands (J,) acting; changes nothing."""
        J, pads, v = self.joint_count, self._pads, self._v
        dq = v[:J].copy()
        self.servos.command(tau_cmd_Nm)
        x, y, z, w = pin.Quaternion(self._T.rotation).coeffs().tolist()
        phi_dot = self._G.dot(v).reshape(-1, 6)
        W = pads.closed * (pads.K * (self._phi - pads.slipped) + pads.C * phi_dot)
        gap = np.where(pads.closed > 0.0, self._phi, np.nan)
        potential = sum(a.potential(self._q[s]) for a, s in zip(self._arms, self.slices, strict=True))
        body = self.spec.object
        potential -= body.mass_kg * float(self.spec.gravity @ self._T.act(body.centre_m))
        return Observation(
            t=self.t,
            p_object=self._T.translation.copy(),
            quat_object=np.array([w, x, y, z]),
            v_object=v[J:].copy(),
            grasp_wrench=W,
            contact_error_m=np.linalg.norm(gap[:, :3], axis=1),
            contact_error_rad=np.linalg.norm(gap[:, 3:], axis=1),
            q=self._q.copy(),
            dq=dq,
            tau_applied=self.servos.motor_torque(dq).copy(),
            tau_friction=self._tau_friction.copy(),
            energy=0.5 * float(v @ self._M @ v) + potential + pads.energy(self._phi),
        )

    def push(self, wrench_world: Vector) -> None:
        """Push the object at its frame's origin from now on: wrench (6,) N, N·m, world axes; zeros end it."""
        self._push = np.array(wrench_world, dtype=np.float64)

    def release(self, arm: str) -> None:
        """Open the grasp of one arm for good: its wrench is zero and its contact error NaN from now on."""
        self._pads.open(self.spec.names.index(arm))
        self._left = 0
        self._G = (self._G.reshape(-1, 6, self.joint_count + 6) * self._pads.closed[:, :, None]).reshape(self._G.shape)

    def brake(self, arm: str, viscous_Nms_rad: float) -> None:
        """Replace the viscous friction of one arm's joints: large for a seized gear, its own value to let go again."""
        joints = self.slices[self.spec.names.index(arm)]
        self.servos.set_viscous(joints, viscous_Nms_rad)
        if self._dry is not None:
            self._dry.set_viscous(joints, viscous_Nms_rad)
