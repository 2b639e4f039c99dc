"""The physics of the cell: arms and object as one closed chain with its own model, moved by commanded torques.

Integration, one evaluation of the dynamics per substep h (drift, kick, drift):

    q_m  = q ⊕ h/2 v
    v_p  = v + h/2 a_previous
    (M(q_m) + h/2 D) a + c(q_m, v_p) = τ_motor − D v + Gᵀ λ,   Jλ: grasps closed, Baumgarte feedback
    v⁺   = v + h a,   q⁺ = q_m ⊕ h/2 v⁺

D(v_p) ≥ 0 is the coefficient of joint friction, so its torque is −D (v + v⁺)/2: it takes energy out at any step
size and any speed scale of the Coulomb sign.  The grasps are 6D constraints; on planar arms they are rank deficient and
pinocchio's proximal solver returns the wrench of least norm (out of plane: none).  Two half drifts with the same
velocity are one whole drift, so positions are carried from midpoint to midpoint and the end of a substep is computed
where somebody sees it; how a motion is divided into calls of `advance` changes no bit of it.

Measured on the paper's cell swinging freely for 2 s without friction at up to 14 rad/s, twice the no-load speed of its
servos: energy error 350, 92, 23 µJ of 1.5 J and grasps open by 22, 5.5, 1.4 µm at h = 2, 1, 0.5 ms, second order, also
when the torques step every 5 ms; semi-implicit Euler, at the same cost, has 52, 26, 13 mJ and 790, 390, 195 µm.  Driven
for 100 s with the friction of the servos, h = 1 ms: grasps within 4 µm.
"""

from __future__ import annotations

import copy
import math

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import Servos
from sim_backend.physics.calendar import Calendar
from sim_backend.physics.chain import Chain
from sim_backend.physics.composition import check_start
from sim_backend.physics.gears import Gears, gears
from sim_backend.physics.joints import dry_friction
from sim_backend.physics.meter import ChainGrasps
from sim_backend.physics.snapshot import Observation, Snapshot
from sim_backend.physics.spec import PlantSpec, diverged

_SCALAR_FIRST = np.array([-1, -4, -3, -2])  # of the object's quaternion at the end of q


class Plant:
    """The simulated cell.  (J,) arrays hold the controlled joints of all arms, arm after arm (`slices`).

    Raises PlantError (GraspError) when the cell cannot be built, or an arm does not start on its grasp.
    """

    def __init__(self, spec: PlantSpec) -> None:
        check_start(spec)
        self.spec = spec
        self.servos = Servos([arm.actuator for arm in spec.arms])
        self._dry, self._gears = dry_friction(spec), gears(spec)
        self._chain = Chain(spec)
        # observe() has its own: it can be called at any time, any number of times, and changes no bit of the motion.
        self._observer = Chain(spec)
        self.slices = self._chain.composition.slices
        self.joint_count = J = sum(len(arm.controlled) for arm in spec.arms)
        self._q: Vector = np.array(self._chain.composition.q_start)
        self._q_mid = self._q  # of the last substep: q ⊖ h/2 v
        nv = self._chain.model.nv
        self._v: Vector = np.zeros(nv)
        self._v_mid, self._tau, self._scratch = np.zeros((3, nv))  # v_mid: v + h/2 a, what the next substep predicts
        self._h = np.full(nv, spec.substep_s)  # arrays: numpy multiplies by a Python float at half the speed
        self._half = 0.5 * self._h
        self._rotor_inertia = np.array(self._chain.composition.rotor_inertia[:J])
        self._armature = self._chain.model.armature[:J]  # a view: what is written here reaches the next evaluation
        self._R_object_ee = [np.array(arm.T_object_ee.rotation) for arm in spec.arms]
        self._no_gaps = np.full((2, len(spec.arms)), np.nan)  # of grasps that are open
        self._push = np.zeros(6)
        self._pushed = False
        self._tau_motor = np.zeros(J)
        self._tau_dry = np.zeros(J)  # of the last substep, where friction has presliding
        self._substeps = 0
        self.calendar = Calendar(spec.happenings, spec.substep_s)
        self._meter: ChainGrasps | None = None
        self._kept: Snapshot | None = None  # the last one

    @property
    def t(self) -> float:
        """Time since the start, s."""
        return self._substeps * self.spec.substep_s

    @property
    def q(self) -> Vector:
        """True joint positions (J,) rad, a copy."""
        return self._q[: self.joint_count].copy()

    @property
    def dq(self) -> Vector:
        """True joint velocities (J,) rad/s, a copy."""
        return self._v[: self.joint_count].copy()

    @property
    def T_world_object(self) -> pin.SE3:
        """True pose of the object."""
        return pin.XYZQUATToSE3(self._q[-7:])

    def set_velocity(self, v: Vector) -> None:
        """Start in motion: joint velocities (J,), then the object's twist (6,) in object axes, linear first.

        The caller answers for its agreement with the grasps; what disagrees is taken out by the stabilisation.
        """
        self._v[:] = self._v_mid[:] = v
        if self._gears is not None:
            self._gears.along(self.dq)
        self._q_mid = pin.integrate(self._chain.model, self._q, -self._half * self._v)

    def advance(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        """Integrate under commands (J,) that act unchanged; every effect of the motors but their delay is applied.

        Raises PlantError when the motion is no longer finite.
        """
        for count in self.calendar.stretches(self, self._substeps, substeps):
            self._integrate(tau_cmd_Nm, count)

    def _integrate(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        J, h, half, half_joint = self.joint_count, self._h, self._half, self._half[: self.joint_count]
        servos, model, acceleration = self.servos, self._chain.model, self._chain.acceleration
        rotor_inertia, armature, ahead = self._rotor_inertia, self._armature, half_joint
        q_mid, v, v_mid, tau, scratch = self._q_mid, self._v, self._v_mid, self._tau, self._scratch
        dq, dq_mid, tau_joint, scratch_joint = v[:J], v_mid[:J], tau[:J], scratch[:J]
        integrate, multiply, add, subtract = pin.integrate, np.multiply, np.add, np.subtract
        dry, geared, meter = self._dry, self._gears, self._meter
        servos.command(tau_cmd_Nm)
        with np.errstate(all="ignore"):  # what overflows is refused below, with more to say than numpy has
            for _ in range(substeps):
                if geared is None:
                    q_mid = integrate(model, q_mid, multiply(v, h, scratch))
                    motor = servos.motor_torque(dq)
                else:
                    q_mid = (
                        self._meet(q_mid, geared) if geared.meets else integrate(model, q_mid, multiply(v, h, scratch))
                    )
                    given = servos.motor_torque(geared.speed)
                    motor, rotor_inertia, ahead = geared.passed(given), geared.inertia, geared.ahead_s
                    np.copyto(armature, rotor_inertia)
                if dry is not None:
                    dry.load(motor)
                    friction, constant = dry.torque(dq)
                    add(rotor_inertia, multiply(friction, ahead, scratch_joint), armature)
                    tau_joint[:] = motor + constant - friction * dq
                elif servos.has_friction:
                    friction = servos.friction_coefficient(dq_mid)
                    add(rotor_inertia, multiply(friction, ahead, scratch_joint), armature)
                    subtract(motor, multiply(friction, dq, scratch_joint), tau_joint)
                else:
                    tau_joint[:] = motor
                if self._pushed:
                    tau[J:] = _in_object_axes(self._push, q_mid)
                a = acceleration(q_mid, v_mid, tau)
                if meter is not None:
                    meter.observe(q_mid[:J], dq_mid, a[:J], armature, tau_joint)
                add(v, multiply(a, h, scratch), v)
                if dry is not None:
                    mean = dq - half_joint * a[:J]
                    acted = mean if geared is None else dq - (h[:J] - ahead) * a[:J]
                    self._tau_dry = constant - friction * acted
                    dry.step(mean)
                if geared is not None:
                    geared.step(given, dq, a[:J])
                add(v, multiply(a, half, v_mid), v_mid)
            self._q_mid, self._q = q_mid, integrate(model, q_mid, multiply(v, half, scratch))
        np.copyto(self._tau_motor, servos.motor_torque(dq if geared is None else geared.speed))
        self._substeps += substeps
        if not math.isfinite(v.dot(v)):
            raise diverged("the motion of the plant", self.t)

    def _meet(self, q_mid: Vector, gears: Gears) -> Vector:
        """Middle of the next substep, after q_mid of the last one and teeth that meet between the two."""
        chain, J, v = self._chain, self.joint_count, self._v
        q = pin.integrate(chain.model, q_mid, self._half * v)
        dv, given = gears.meet(v[:J], lambda given: chain.jump(q, v, given, gears.inertia))
        if self._meter is not None:
            self._meter.strike(q[:J], dv[:J], gears.added, given, self.spec.substep_s)
        v += dv
        self._v_mid += dv
        q_next: Vector = pin.integrate(chain.model, q, self._half * v)
        return q_next

    def rest(self, substeps: int) -> None:
        """Let time pass while the cell rests on a support."""
        self._substeps += substeps

    def reported(self) -> Vector:
        """What the servos say, (3, J): positions rad, velocities rad/s, torques N·m estimated from current."""
        J = self.joint_count
        return self.servos.reported(self._q[:J], self._v[:J], self._tau_motor)

    def meter_grasps(self) -> None:
        """Sum up the torques of the grasps from now on, which takes some time."""
        self._meter = self._meter or ChainGrasps(self.spec)

    def grasp_torque(self) -> Vector:
        """Mean torque (J,) N·m of the grasps on the joints since the last call; zeros unless metered."""
        return np.zeros(self.joint_count) if self._meter is None else self._meter.take()

    def observe(self, tau_cmd_Nm: Vector) -> Observation:
        """What is true now, with commands (J,) acting; changes nothing."""
        return self.snapshot(tau_cmd_Nm).observation()

    def snapshot(self, tau_cmd_Nm: Vector) -> Snapshot:
        """What `observe` would say now, at the cost of a copy; asking it takes as long as several substeps."""
        t, q, v, tau_cmd_Nm = self.t, self._q, self._v.copy(), tau_cmd_Nm.copy()
        tau_dry, push, geared = self._tau_dry, self._push.copy() if self._pushed else None, copy.copy(self._gears)
        self._kept = Snapshot(lambda: self._observation(t, q, v, tau_cmd_Nm, tau_dry, push, geared))
        return self._kept

    def _observation(
        self,
        t: float,
        q: Vector,
        v: Vector,
        tau_cmd_Nm: Vector,
        tau_dry: Vector,
        push: Vector | None,
        geared: Gears | None,
    ) -> Observation:
        J, chain, servos = self.joint_count, self._observer, self.servos
        dq = v[:J].copy()
        servos.command(tau_cmd_Nm)
        tau_motor = servos.motor_torque(dq if geared is None else geared.speed).copy()
        tau_friction = -servos.friction_coefficient(dq) * dq if self._dry is None else tau_dry.copy()
        tau = np.zeros(len(v))
        np.add(tau_motor if geared is None else geared.passed(tau_motor), tau_friction, tau[:J])
        if geared is not None:
            chain.model.armature[:J] = geared.inertia
        if push is not None:
            tau[J:] = _in_object_axes(push, q)
        chain.acceleration(q, v, tau)
        R_world_object = pin.XYZQUATToSE3(q[-7:]).rotation
        wrench, gap_m, gap_rad = self._grasp_state(R_world_object)
        v_object = np.empty(6)
        R_world_object.dot(v[-6:-3], v_object[:3])
        R_world_object.dot(v[-3:], v_object[3:])
        return Observation(
            t=t,
            p_object=q[-7:-4].copy(),
            quat_object=q[_SCALAR_FIRST],
            v_object=v_object,
            grasp_wrench=wrench,
            contact_error_m=gap_m,
            contact_error_rad=gap_rad,
            slip_m=np.zeros(len(gap_m)),
            slip_rad=np.zeros(len(gap_m)),
            q=q[:J].copy(),
            dq=dq,
            tau_applied=tau_motor,
            tau_friction=tau_friction,
            energy=pin.computeKineticEnergy(chain.model, chain.data, q, v)
            + pin.computePotentialEnergy(chain.model, chain.data, q)
            + (0.0 if geared is None else geared.energy),
        )

    def _grasp_state(self, R_world_object: Vector) -> tuple[Vector, Vector, Vector]:
        """Wrenches (N, 6) on the object, world axes, and gaps (N,) m, (N,) rad, of the observer's last evaluation."""
        wrench, (gap_m, gap_rad) = np.zeros((len(self.spec.arms), 6)), self._no_gaps.copy()
        for i, _, force, moment, p_ee, R_ee in self._observer.grasp_states:
            R_world_grasp = R_world_object.dot(self._R_object_ee[i])
            R_world_grasp.dot(-force, wrench[i, :3])
            R_world_grasp.dot(-moment, wrench[i, 3:])
            turned = pin.log3(R_ee)
            gap_m[i] = math.sqrt(p_ee.dot(p_ee))
            gap_rad[i] = math.sqrt(turned.dot(turned))
        return wrench, gap_m, gap_rad

    def push(self, wrench_world: Vector) -> None:
        """Push the object at its frame's origin from now on: wrench (6,) N, N·m, world axes; zeros end it."""
        self._push[:] = wrench_world
        self._pushed = bool(np.any(self._push))
        self._tau[self.joint_count :] = 0.0

    def release(self, arm: str) -> None:
        """Open the grasp of one arm for good: its wrench is zero and its contact error NaN from now on."""
        self._settle()
        closed = tuple(i for i in self._chain.closed if self.spec.names[i] != arm)
        self._chain.close(closed)
        self._observer.close(closed)

    def brake(self, arm: str, viscous_Nms_rad: float) -> None:
        """Replace the viscous friction of one arm's joints: large for a seized gear, its own value to let go again."""
        self._settle()
        joints = self.slices[self.spec.names.index(arm)]
        self.servos.set_viscous(joints, viscous_Nms_rad)
        if self._dry is not None:
            self._dry.set_viscous(joints, viscous_Nms_rad)

    def _settle(self) -> None:
        """Work out the last snapshot, before something is changed that it has not kept."""
        if self._kept is not None:
            self._kept.observation()


def _in_object_axes(wrench_world: Vector, q: Vector) -> Vector:
    """A wrench (6,) on the object, from world axes to those of the object at q."""
    R_object_world = pin.XYZQUATToSE3(q[-7:]).rotation.T
    return np.concatenate([R_object_world.dot(wrench_world[:3]), R_object_world.dot(wrench_world[3:])])
