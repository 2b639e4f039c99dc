"""The simulated cell in another engine, MuJoCo: its dynamics, integrator and friction in the place of ours.

The specification is that of our plant, and the servos' own effects (steps, saturation, zeros) are ours; bodies come
from the same URDF, read by MuJoCo.  Friction is its Coulomb and viscous one: no breakaway, no part that grows with
load.  A pad is nine struts between end effector and object, so that damping is integrated implicitly; a weld is a
stiff pad.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any, Final

import mujoco
import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from drivers.pads import damping, swinging_inertia
from sim_backend.physics.actuator import Servos
from sim_backend.physics.calendar import Calendar
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import ArmSpec, GraspSpec, PlantSpec, diverged

WELD: Final = GraspSpec(stiffness_N_per_m=1e6, stiffness_Nm_per_rad=1e3)
ASIDE_M: Final = 2.0  # from the grasp to the struts that twist alone loads
STRUT_M: Final = 10.0  # so long that it does not turn
THROUGH: Final = 3  # struts through the grasp, one for each axis; of the others each axis has a pair
STRUTS: Final = 9
STEP_RAD: Final = 0.7  # of the fastest oscillation in a step: springs are integrated explicitly
STEPS_MIN: Final = 4  # in a substep of ours
FRICTION_SOLREF: Final = (0.004, 1.0)  # s; with the engine's own 20 ms a joint at rest creeps


class MujocoPlant:
    """What a study's run asks of a plant.  Raises PlantError when the motion is no longer finite."""

    def __init__(self, spec: PlantSpec) -> None:
        self.spec = spec
        self.servos = Servos([arm.actuator for arm in spec.arms])
        self.slices: list[slice] = []
        names: list[str] = []
        pads = spec.grasp or WELD
        stiffness = np.array([pads.stiffness_N_per_m] * 3 + [pads.stiffness_Nm_per_rad] * 3)
        self._steps_each = steps_of(spec, stiffness)
        world = _world(spec, spec.substep_s / self._steps_each)
        body = _add_object(world, spec)
        for arm in spec.arms:
            self.slices.append(slice(len(names), len(names) + len(arm.controlled)))
            names += [f"{arm.name}/{joint}" for joint in arm.controlled]
            _add_arm(world, arm)
            _add_struts(world, body, arm)
        self.joint_count = len(names)
        self._model = model = world.compile()
        self._data = mujoco.MjData(model)
        self._q = np.array([model.joint(name).qposadr[0] for name in names])
        self._v = np.array([model.joint(name).dofadr[0] for name in names])
        self._object_q, self._object_v = model.joint("object").qposadr[0], model.joint("object").dofadr[0]
        self._data.qpos[self._q] = np.concatenate([arm.q_start for arm in spec.arms])
        mujoco.mj_forward(model, self._data)
        for arm, joints in zip(spec.arms, self.slices, strict=True):
            self._tune(arm, joints, stiffness, pads.damping_ratio)
        self._motor = np.zeros(self.joint_count)
        self._substeps = 0
        self.calendar = Calendar(spec.happenings, spec.substep_s)

    def _tune(self, arm: ArmSpec, joints: slice, stiffness: Vector, ratio: float) -> None:
        """Stiffness and damping of an arm's struts, at rest as they are now."""
        model, data, own = self._model, self._data, self._v[joints]
        jacobian, inertia = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(f"{arm.name}/strut0").id)
        mujoco.mj_fullM(model, data, inertia)
        mobility = jacobian[:, own] @ np.linalg.solve(inertia[np.ix_(own, own)], jacobian[:, own].T)
        damped = damping(stiffness, swinging_inertia(mobility), ratio)
        for i, strut in enumerate(self._struts(arm)):
            for values, of_pad in ((model.tendon_stiffness, stiffness), (model.tendon_damping, damped)):
                aside = of_pad[-1] / ASIDE_M**2  # what all pairs of one direction resist a shift with
                values[strut] = max(0.0, of_pad[0] - aside) if i < THROUGH else aside / 2.0
            model.tendon_lengthspring[strut] = data.ten_length[strut]

    def _struts(self, arm: ArmSpec) -> list[int]:
        return [self._model.tendon(f"{arm.name}/strut{i}").id for i in range(STRUTS)]

    def rest(self, substeps: int) -> None:
        """Let time pass while the cell rests on a support."""
        self._substeps += substeps

    def advance(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        """Integrate under commands (J,) that act unchanged."""
        for count in self.calendar.stretches(self, self._substeps, substeps):
            self._integrate(tau_cmd_Nm, count)

    def _integrate(self, tau_cmd_Nm: Vector, substeps: int) -> None:
        model, data = self._model, self._data
        self.servos.command(tau_cmd_Nm)
        for _ in range(substeps * self._steps_each):
            data.qfrc_applied[self._v] = self.servos.motor_torque(data.qvel[self._v])
            mujoco.mj_step(model, data)
        self._substeps += substeps
        self._motor = self.servos.motor_torque(data.qvel[self._v]).copy()
        if not np.isfinite(data.qvel).all():
            raise diverged("the motion in MuJoCo", self._substeps * self.spec.substep_s)

    def reported(self) -> Vector:
        """What the servos say, (3, J): positions, velocities, torques."""
        return self.servos.reported(self._data.qpos[self._q], self._data.qvel[self._v], self._motor)

    def observe(self, _: Vector) -> Observation:
        """What is true at the end of the last step, whatever is commanded now."""
        data, at, unknown = self._data, self._object_q, np.full(len(self.spec.arms), np.nan)
        v = data.qvel[self._object_v : self._object_v + 6]
        quat = data.qpos[at + 3 : at + 7].copy()
        return Observation(
            t=self._substeps * self.spec.substep_s,
            p_object=data.qpos[at : at + 3].copy(),
            quat_object=quat,
            v_object=np.concatenate([v[:3], pin.Quaternion(*quat).matrix() @ v[3:]]),
            grasp_wrench=np.array([self._wrench(arm) for arm in self.spec.arms]),
            contact_error_m=unknown,
            contact_error_rad=unknown,
            slip_m=unknown,
            slip_rad=unknown,
            q=data.qpos[self._q].copy(),
            dq=data.qvel[self._v].copy(),
            tau_applied=self._motor.copy(),
            tau_friction=data.qfrc_constraint[self._v] + data.qfrc_damper[self._v],
            energy=math.nan,
        )

    def _wrench(self, arm: ArmSpec) -> Vector:
        """(6,) of an arm's struts on the object, about its grasp, world axes."""
        model, data, wrench = self._model, self._data, np.zeros(6)
        grasp = data.site(f"{arm.name}/grasp").xpos
        for i, strut in enumerate(self._struts(arm)):
            stretch = float(data.ten_length[strut]) - float(np.ravel(model.tendon_lengthspring[strut])[0])
            size = model.tendon_stiffness[strut] * stretch + model.tendon_damping[strut] * data.ten_velocity[strut]
            end = data.site(f"{arm.name}/object{i}").xpos
            along = data.site(f"{arm.name}/strut{i}").xpos - end
            force = float(size) / np.linalg.norm(along) * along
            wrench[:3] += force
            wrench[3:] += np.cross(end - grasp, force)
        return wrench

    def brake(self, arm: str, viscous_Nms_rad: float) -> None:
        """Replace the viscous friction of one arm's joints."""
        self._model.dof_damping[self._v[self.slices[self.spec.names.index(arm)]]] = viscous_Nms_rad

    def push(self, wrench_world: Vector) -> None:
        """Push the object: not here."""
        raise NotImplementedError(wrench_world)

    def release(self, arm: str) -> None:
        """Open the grasp of one arm for good."""
        for strut in self._struts(self.spec.arms[self.spec.names.index(arm)]):
            self._model.tendon_stiffness[strut] = self._model.tendon_damping[strut] = 0.0


def steps_of(spec: PlantSpec, stiffness: Vector) -> int:
    """Steps of the engine in a substep of ours, for pads of this stiffness (6,)."""
    body = spec.object
    lightest = np.concatenate([[body.mass_kg] * 3, [float(np.linalg.eigvalsh(body.inertia)[0])] * 3])
    fastest_rad_s = math.sqrt(len(spec.arms) * float((stiffness / lightest).max()))
    return max(STEPS_MIN, math.ceil(spec.substep_s * fastest_rad_s / STEP_RAD))


def _world(spec: PlantSpec, step_s: float) -> Any:
    world = mujoco.MjSpec()
    world.compiler.degree = False
    world.option.gravity = spec.gravity
    world.option.timestep = step_s
    world.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    world.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return world


def _quat(rotation: Vector) -> list[float]:
    quat = pin.Quaternion(rotation)
    return [quat.w, quat.x, quat.y, quat.z]


def _add_object(world: Any, spec: PlantSpec) -> Any:
    what, inertia = spec.object, spec.object.inertia
    body = world.worldbody.add_body(name="object", pos=what.p_world, quat=what.quat_world)
    body.add_freejoint(name="object")
    body.mass, body.ipos, body.explicitinertial = what.mass_kg, what.centre_m, True
    body.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    return body


def _weigh(link: Any, masses: Mapping[str, float], carried: float) -> None:
    """Make a link and all behind it as heavy as they are; carried: factor of the joint before it."""
    times = next((masses[joint.name] for joint in link.joints if joint.name in masses), carried)
    link.mass *= times
    link.inertia *= times
    link.fullinertia *= times
    for behind in link.bodies:
        _weigh(behind, masses, times)


def _add_arm(world: Any, arm: ArmSpec) -> None:
    base, read = arm.T_world_base, mujoco.MjSpec.from_string(_locked(arm.urdf_xml, arm.locked_rad))
    _weigh(read.worldbody, dict(zip(arm.controlled, arm.masses.tolist(), strict=True)), 1.0)
    frame = world.worldbody.add_frame(pos=base.translation, quat=_quat(base.rotation))
    world.attach(read, prefix=f"{arm.name}/", frame=frame)
    friction = arm.actuator if arm.friction is None else arm.friction
    for i, name in enumerate(arm.controlled):
        joint = world.joint(f"{arm.name}/{name}")
        joint.armature = arm.rotor_inertia[i]
        joint.damping[0] = friction.viscous_Nms_rad[i]
        joint.frictionloss = friction.coulomb_Nm[i]
        joint.solref_friction = FRICTION_SOLREF
        joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE


def _locked(urdf_xml: str, locked_rad: Mapping[str, float]) -> str:
    """The URDF without shapes, its locked joints fixed where they are."""
    robot = ET.fromstring(urdf_xml)
    for link in robot.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in robot.iter("joint"):
        angle = locked_rad.get(joint.get("name", ""))
        axis, origin = joint.find("axis"), joint.find("origin")
        if angle is None or axis is None or joint.get("type") == "fixed":
            continue
        if origin is None:
            origin = ET.SubElement(joint, "origin")
        along, rpy, xyz = (
            np.array([float(number) for number in text.split()])
            for text in (axis.get("xyz", "1 0 0"), origin.get("rpy", "0 0 0"), origin.get("xyz", "0 0 0"))
        )
        turned = pin.rpy.rpyToMatrix(*rpy)
        if joint.get("type") == "prismatic":
            xyz = xyz + turned @ along * angle
        else:
            turned = turned @ pin.exp3(angle * along / np.linalg.norm(along))
        origin.set("xyz", " ".join(f"{number:.17g}" for number in xyz))
        origin.set("rpy", " ".join(f"{number:.17g}" for number in pin.rpy.matrixToRpy(turned)))
        joint.set("type", "fixed")
    compiler = ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler")
    compiler.attrib |= {"fusestatic": "false", "balanceinertia": "false", "inertiafromgeom": "false"}
    return ET.tostring(robot, encoding="unicode")


def _add_struts(world: Any, body: Any, arm: ArmSpec) -> None:
    """Along each axis of the end effector one strut through the grasp and a pair beside it."""
    effector, grasp = world.body(f"{arm.name}/{arm.ee_frame}"), arm.T_object_ee
    body.add_site(name=f"{arm.name}/grasp", pos=grasp.translation)
    for i in range(STRUTS):
        beside = (0.0, 1.0, -1.0)[i // THROUGH] * ASIDE_M * np.eye(3)[(i + 1) % 3]
        effector.add_site(name=f"{arm.name}/strut{i}", pos=beside)
        body.add_site(name=f"{arm.name}/object{i}", pos=grasp.act(beside + STRUT_M * np.eye(3)[i % 3]))
        strut = world.add_tendon(name=f"{arm.name}/strut{i}")
        strut.wrap_site(f"{arm.name}/strut{i}")
        strut.wrap_site(f"{arm.name}/object{i}")
