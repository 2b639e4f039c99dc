"""The physics of a cell whose grasps give: every arm and the object on their own, joined by springs and dampers.

Between two linearisations the cell is M a + c = τ − D v − Gᵀ W with constant M, c and G; G maps joint velocities and
the object's twist to the rate of the grasps' openings φ, and W = K (φ − s) + C φ̇ (pads.py).  Per substep h

    (M + h/2 D + Gᵀ S G) a = τ + f − D v − c − Gᵀ (K (φ + h/2 φ̇ − s) + C φ̇),   S = κ h² K + h/2 C
    v⁺ = v + h a,   q⁺ = q ⊕ h (v + v⁺)/2,   φ⁺ = φ + h G (v + v⁺)/2

With κ ≥ 1/4 the step is stable at any stiffness: what K adds beyond the trapezoidal rule is a mass and takes no energy
out, C does.  A linearisation lasts `relinearise_s`, or as long as the fastest joint, or the object, needs for 5 mrad.

Measured on cells that swing freely for 0.4 s at up to 7.5 rad/s, h = 1 ms, pads of 1e2 to 1e6 N/m: the energy grows by
at most 2.3 mJ of 9.7 J (first order in h).  With 1e6 N/m driven joints stay within 2 mrad of the welded plant's.
"""

from __future__ import annotations

import math
from typing import Final

import eigenpy
import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import Servos
from sim_backend.physics.calendar import Calendar
from sim_backend.physics.composition import check_start
from sim_backend.physics.free_arm import FreeArms
from sim_backend.physics.free_body import FreeBody
from sim_backend.physics.gears import gears
from sim_backend.physics.joints import dry_friction
from sim_backend.physics.meter import GraspMeter
from sim_backend.physics.openings import Openings
from sim_backend.physics.pads import KAPPA, Pads
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import PlantError, PlantSpec, diverged

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
        self._dry, self._gears = dry_friction(spec), gears(spec)
        self._arms = FreeArms(spec)
        self.slices = self._arms.slices
        self.joint_count = J = self.slices[-1].stop
        self._T = spec.object.T_world_object
        self._q: Vector = np.concatenate([a.q_start for a in spec.arms])
        self._h = spec.substep_s
        self._pads = Pads(spec.grasp, self._arms.swinging(self._q), [arm.pads for arm in spec.arms])
        self._push: Vector = np.zeros(6)
        self._tau_motor, self._joint = np.zeros((2, J))
        self._acted: tuple[Vector, Vector | None] = (np.zeros(J), None)  # friction of the last substep
        self._make_room(J + 6)
        self._body = FreeBody(spec.object, spec.gravity)
        self._openings = Openings(self._arms, [a.T_object_ee for a in spec.arms], J)
        self._substeps = 0
        self.calendar = Calendar(spec.happenings, spec.substep_s)
        self._behind = False  # pose and openings are of an earlier substep
        self._meter: GraspMeter | None = None
        self._linearise()

    def _make_room(self, nv: int) -> None:
        """Arrays of a substep, written in place; nv: joints and twist."""
        self._v, self._b, self._c, self._mean, self._moved = np.zeros((5, nv))  # twist last: of the frame, world axes
        self._dq = self._v[: self.joint_count]
        self._half = np.full(nv, 0.5 * self._h)
        self._M, self._A = np.zeros((nv, nv)), np.zeros((nv, nv), order="F")
        self._diagonal = np.einsum("ii->i", self._A)[: self.joint_count]

    @property
    def t(self) -> float:
        """Time since the start, s."""
        return self._substeps * self._h

    @property
    def q(self) -> Vector:
        """True joint positions (J,) rad, a copy."""
        self._arrive()
        return self._q.copy()

    @property
    def dq(self) -> Vector:
        """True joint velocities (J,) rad/s, a copy."""
        return self._v[: self.joint_count].copy()

    @property
    def T_world_object(self) -> pin.SE3:
        """True pose of the object."""
        self._arrive()
        return pin.SE3(self._T)

    def set_velocity(self, v: Vector) -> None:
        """Start in motion: joint velocities (J,), then the object's twist (6,) in object axes, linear first."""
        self._arrive()
        J, R = self.joint_count, self._T.rotation
        self._v[:] = np.concatenate([v[:J], R @ v[J : J + 3], R @ v[J + 3 :]])
        if self._gears is not None:
            self._gears.along(self.dq)
        self._linearise()

    def _linearise(self) -> None:
        """M, c, G and φ at the present pose, and for how many substeps they will do."""
        J, h, v, pads, M, G = self.joint_count, self._h, self._v, self._pads, self._M, self._openings.G
        T = self._T
        pads.turn(T.rotation)
        M[:J, :J], self._c[:J] = self._arms.terms(self._q, v[:J])
        self._c[J:] = self._body.terms(T.rotation, v[J + 3 :], M[J:, J:]) - self._push
        self._phi = self._phi0 = self._openings.measure(T, pads.closed, pads.slipped)
        GtK, GtC = G.T * pads.K.ravel(), G.T * pads.C.ravel()
        stiff, damped = GtK.dot(G), GtC.dot(G)
        self._stiff = h * stiff
        self._drag = 0.5 * h * stiff + damped
        self._A0 = M + KAPPA * h * h * stiff + 0.5 * h * damped
        self._pull = self._c + GtK.dot((self._phi - pads.slipped).ravel())
        self._q0, self._T0 = self._q, T
        self._moved[:] = 0.0
        turning = max(map(abs, (*v[:J].tolist(), *v[J + 3 :].tolist(), 1e-9)))
        self._left = max(1, math.floor(min(self.spec.relinearise_s, MAX_TURN_RAD / turning) / h + 1e-9))

    def advance(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        """Integrate under commands (J,) that act unchanged; every effect of the motors but their delay is applied.

        Raises PlantError when the motion is no longer finite.
        """
        for count in self.calendar.stretches(self, self._substeps, substeps):
            self._integrate(tau_cmd_Nm, count)

    def _integrate(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        self.servos.command(tau_cmd_Nm)
        with np.errstate(all="ignore"):  # what overflows is refused below, with more to say than numpy has
            for _ in range(substeps):
                if self._left == 0:
                    self._arrive()
                    self._linearise()
                self._substep()
                self._left -= 1
                if self._pads.slips:
                    self._slip()
        np.copyto(self._tau_motor, self.servos.motor_torque(self._dq if self._gears is None else self._gears.speed))
        self._substeps += substeps
        if not float(self._v.dot(self._v)) < FASTEST**2:
            raise diverged("the motion of the plant", self.t)

    def _substep(self) -> None:
        """One substep on the present linearisation; `_pull` carries c + Gᵀ K (φ − s) along."""
        J, v, A, b, dq, half = self.joint_count, self._v, self._A, self._b, self._dq, self._half
        gears = self._gears
        if gears is not None and gears.meets:
            v += gears.meet(dq, self._jump)[0]
        motor = given = self.servos.motor_torque(dq if gears is None else gears.speed)
        if gears is not None:
            motor = gears.passed(given)
        D, f = self._friction(motor, dq)
        np.copyto(A, self._A0)
        np.multiply(D, half[:J] if gears is None else gears.ahead_s, self._joint)
        self._diagonal += self._joint
        if gears is not None:
            self._diagonal += gears.added
        np.dot(self._drag, v, b)
        np.add(b, self._pull, b)
        np.subtract(motor, np.multiply(D, dq, self._joint), self._joint)
        if f is not None:
            np.add(self._joint, f, self._joint)
        b[:J] -= self._joint
        step = eigenpy.LLT(A).solve(b)  # −a
        np.multiply(step, half, step)
        mean = np.subtract(v, step, self._mean)
        np.subtract(mean, step, v)
        self._pull += self._stiff.dot(mean)
        self._moved += mean
        self._behind = True
        self._acted = D, f
        if self._meter is not None:  # _joint holds τ_motor + f − D v; the acceleration is −2 step / h
            pulled = self._M[:J].dot(step) * (-2.0 / self._h) + self._c[:J]
            if gears is not None:
                pulled -= (gears.added + D * (gears.ahead_s - half[:J])) * step[:J] * (2.0 / self._h)
            self._meter.add(pulled - self._joint - D * step[:J])
        if gears is not None:
            gears.step(given, dq, step[:J] * (-2.0 / self._h))
        if self._dry is not None:
            self._dry.step(mean[:J])

    def _jump(self, given: Vector) -> Vector:
        """Change of v by momenta (J,) that are given to the joints at once, in which pads take no part."""
        assert self._gears is not None
        J, dv = self.joint_count, np.zeros_like(self._v)
        dv[:J] = np.linalg.solve(self._M[:J, :J] + np.diag(self._gears.added), given)
        return dv

    def _friction(self, motor: Vector, dq: Vector) -> tuple[Vector, Vector | None]:
        """(D, f), each (J,): the friction torque is −D (dq + dq⁺)/2 + f; no f: zero."""
        if self._dry is None:
            return self.servos.friction_coefficient(dq), None
        self._dry.load(motor)
        return self._dry.torque(dq)

    def _arrive(self) -> None:
        """Bring pose and openings, which a substep leaves behind, to the present."""
        if not self._behind:
            return
        self._behind = False
        J, moved = self.joint_count, self._h * self._moved
        self._q = self._q0 + moved[:J]
        turn = pin.exp3(moved[J + 3 :])
        self._T = pin.SE3(turn.dot(self._T0.rotation), self._T0.translation + moved[J : J + 3])
        self._phi = self._phi0 + self._openings.G.dot(moved).reshape(self._phi0.shape)

    def _slip(self) -> None:
        """Let springs beyond their bound give way, and grasps that have slipped too far open."""
        self._arrive()
        pads, before = self._pads, self._pads.slipped.copy()
        opened = pads.slip(self._phi, self._T0.rotation)  # openings are in the linearisation's axes
        gave = pads.slipped - before
        if not gave.any():
            return
        self._pull -= (self._openings.G.T * pads.K.ravel()).dot(gave.ravel())
        if not all(map(self._openings.touches, np.flatnonzero(gave.any(axis=1)).tolist())):
            self._left = 0
        for grasp in opened:
            self.release(self.spec.names[grasp])

    def rest(self, substeps: int) -> None:
        """Let time pass while the cell rests on a support."""
        self._substeps += substeps

    def reported(self) -> Vector:
        """What the servos say, (3, J): positions rad, velocities rad/s, torques N·m estimated from current."""
        self._arrive()
        return self.servos.reported(self._q, self._dq, self._tau_motor)

    def meter_grasps(self) -> None:
        """Sum up the torques of the grasps from now on, which takes some time."""
        self._meter = self._meter or GraspMeter(self.joint_count)

    def grasp_torque(self) -> Vector:
        """Mean torque (J,) N·m of the grasps on the joints since the last call; zeros unless metered."""
        return np.zeros(self.joint_count) if self._meter is None else self._meter.take()

    def observe(self, tau_cmd_Nm: Vector) -> Observation:
        """What is true now, with commands (J,) acting; changes nothing."""
        self._arrive()
        J, pads, v = self.joint_count, self._pads, self._v
        D, f = self._acted
        dq, friction = v[:J].copy(), -D * self._mean[:J]
        self.servos.command(tau_cmd_Nm)
        pulls = pads.K * (self._phi - pads.slipped) + pads.C * self._openings.G.dot(v).reshape(-1, 6)
        W = self._openings.wrenches(pads.closed * pulls)
        gap_m, gap_rad = self._openings.gaps(self._phi, pads.closed)
        potential, gears = self._arms.potential(self._q) + self._body.potential(self._T), self._gears
        energy = 0.5 * float(v @ self._M @ v) + potential + pads.energy(self._phi)
        if gears is not None:
            energy += 0.5 * float(gears.added @ dq**2) + gears.energy
        return Observation(
            t=self.t,
            p_object=self._T.translation.copy(),
            quat_object=pin.Quaternion(self._T.rotation).coeffs()[[3, 0, 1, 2]],
            v_object=v[J:].copy(),
            grasp_wrench=W,
            contact_error_m=gap_m,
            contact_error_rad=gap_rad,
            slip_m=pads.slip_m,
            slip_rad=pads.slip_rad,
            q=self._q.copy(),
            dq=dq,
            tau_applied=self.servos.motor_torque(dq if gears is None else gears.speed).copy(),
            tau_friction=friction if f is None else friction + f,
            energy=energy,
        )

    def push(self, wrench_world: Vector) -> None:
        """Push the object at its frame's origin from now on: wrench (6,) N, N·m, world axes; zeros end it."""
        before, self._push = self._push, np.array(wrench_world, dtype=np.float64)
        self._pull[self.joint_count :] += before - self._push

    def release(self, arm: str) -> None:
        """Open the grasp of one arm for good: its wrench is zero and its contact error NaN from now on."""
        self._pads.open(self.spec.names.index(arm))
        self._left = 0
        self._openings.keep(self._pads.closed)

    def brake(self, arm: str, viscous_Nms_rad: float | Vector) -> None:
        """Replace the viscous friction of one arm's joints: large for a seized gear, its own value to let go again."""
        joints = self.slices[self.spec.names.index(arm)]
        self.servos.set_viscous(joints, viscous_Nms_rad)
        if self._dry is not None:
            self._dry.set_viscous(joints, viscous_Nms_rad)
