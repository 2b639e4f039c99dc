"""A validated cell: the files, the arms' models, the offline data of each agent."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import tomli_w

import configs
from agent.config import adaptive, trajectory
from agent.config.reading import ConfigError, override, parse, read_file, shipped_cells, shown, validate
from agent.config.schema.arm import ArmFile, ServoJoint
from agent.config.schema.cell import Arm as ArmEntry
from agent.config.schema.cell import CellFile
from agent.config.schema.controller import ControllerKind
from agent.config.schema.types import nearest
from agent.config.urdf import text_of_urdf
from agent.control.adaptation import Adaptation
from agent.control.errors import Gains
from agent.control.friction import Friction
from agent.control.internal_force import agent_wrench
from agent.control.law import Offline
from agent.control.models import ArmModel, ModelError
from agent.control.posture import Posture
from agent.control.quaternion import Vec3
from agent.control.trajectory import Trajectory, Vec6
from drivers.dynamixel.servo.table import SERVOS, ServoModel
from drivers.interface import Vector

__all__ = ["Arm", "Cell", "ConfigError", "cell_from_toml", "load_arm_file", "load_cell", "placement"]


@dataclass(frozen=True)
class Arm:
    """One arm of the cell with everything its files say, resolved."""

    entry: ArmEntry
    file: ArmFile
    toml: bytes  # of the arm file
    urdf_xml: str
    servos: tuple[ServoJoint, ...]  # of the controlled joints, in order

    @property
    def name(self) -> str:
        """Name in the cell."""
        return self.entry.name

    @property
    def n(self) -> int:
        """Number of controlled joints."""
        return len(self.entry.controlled)

    @property
    def baud(self) -> int:
        """Speed of the arm's bus, bit/s: the cell's, or else what the arm file says."""
        settings = self.entry.dynamixel
        return settings.baud if settings is not None and settings.baud is not None else self.file.baud

    @property
    def servo_models(self) -> tuple[ServoModel, ...]:
        """Servo type of each controlled joint."""
        return tuple(SERVOS[s.servo] for s in self.servos)

    @property
    def tau_stall_Nm(self) -> Vector:
        """(n,) stall torque of each joint, all its servos together."""
        return np.array([SERVOS[s.servo].stall_torque_Nm * len(s.ids) for s in self.servos])

    @property
    def rotor_inertia(self) -> Vector:
        """(n,) reflected rotor inertia, kg·m²."""
        return np.array([s.rotor_inertia_kg_m2.value for s in self.servos])

    @property
    def T_world_base(self) -> pin.SE3:
        """Base pose in the world."""
        return placement(self.entry.p_world_base_m, self.entry.quat_world_base)

    @property
    def T_object_ee(self) -> pin.SE3:
        """Grasp pose: end effector in the object frame."""
        return placement(self.entry.p_object_ee_m, self.entry.quat_object_ee)


@dataclass(frozen=True)
class Cell:
    """The whole cell, with the exact bytes it came from."""

    file: CellFile
    arms: tuple[Arm, ...]
    toml: bytes
    fingerprint: str  # SHA-256 of the cell file, the arm files and the URDFs

    @property
    def config_id(self) -> int:
        """First 32 bits of the fingerprint; stands in every log row."""
        return int(self.fingerprint[:8], 16)

    @property
    def gravity(self) -> Vector:
        """(3,) m/s², world axes."""
        return np.array(self.file.world.gravity_m_per_s2)

    @property
    def period_ns(self) -> int:
        """Control period."""
        return round(1e9 / self.file.rate_hz)

    @property
    def T_world_object_start(self) -> pin.SE3:
        """Pose of the object before the run."""
        return placement(self.file.object.p_start_m, self.file.object.quat_start)

    def arm(self, name: str) -> Arm:
        """The arm of that name.  Raises ConfigError."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise ConfigError(
            f"arm of cell {self.file.name}",
            found=repr(name),
            expected=" or ".join(a.name for a in self.arms),
            remedy="name one of the cell's arms",
        )

    def trajectory(self) -> Trajectory:
        """The desired motion of the object."""
        return trajectory.build(self.file)

    def model(self, arm: Arm) -> ArmModel:
        """A new rigid-body model of the arm, with its own scratch memory.  Raises ModelError."""
        try:
            return ArmModel(
                arm.urdf_xml,
                arm.entry.controlled,
                arm.entry.locked_rad,
                arm.T_world_base,
                arm.file.ee_frame,
                arm.T_object_ee,
                arm.rotor_inertia,
                self.gravity,
            )
        except ModelError as error:
            raise ModelError(
                f"{error.what}, arm {arm.name} ({arm.file.urdf})",
                found=error.found,
                expected=error.expected,
                remedy=error.remedy,
            ) from error

    def offline(self, arm: Arm) -> Offline:
        """What the agent of this arm knows beside its own joints.  Raises AdaptationError."""
        c, entry, obj = self.file.controller, arm.entry, self.file.object
        gains = Gains(
            k_p=c.k_p_per_s,
            k_eps=c.k_eps_rad_per_s,
            k_p_rate=c.k_p_rate_per_s or c.k_p_per_s,
            k_eps_rate=c.k_eps_rate_rad_per_s or c.k_eps_rad_per_s,
            k_v=(*entry.k_v_N_s_per_m, *(entry.k_v_Nm_s_per_rad or entry.k_v_N_s_per_m)),
        )
        friction = None
        if c.friction_feedforward:
            friction = Friction(
                coulomb_Nm=tuple(s.coulomb_Nm.value for s in arm.servos),
                viscous_Nm_s_per_rad=tuple(s.viscous_Nm_s_per_rad.value for s in arm.servos),
                smooth_rad_per_s=c.friction_smooth_rad_per_s,
            )
        return Offline(
            gains=gains,
            load_share=entry.load_share,
            object_mass_kg=obj.mass_kg,
            object_inertia=tuple(x for row in obj.inertia_kg_m2.matrix() for x in row),  # type: ignore[arg-type]
            gravity=self.file.world.gravity_m_per_s2,
            friction=friction,
            posture=_posture(entry),
            internal_wrench=self._internal_wrench(arm),
            adaptation=self._adaptation(arm),
        )

    def _internal_wrench(self, arm: Arm) -> Vec6 | None:
        """This agent's part of the internal wrenches, about the object's centre; None when none is wanted."""
        if all(a.entry.internal_wrench_N_Nm is None for a in self.arms):
            return None
        return agent_wrench(self.arms.index(arm), *self.internal_wrenches_desired())

    def internal_wrenches_desired(self) -> tuple[list[Vec3], list[Vec6]]:
        """Grasp points and desired wrenches f̂ of all arms, at the end effectors, object axes."""
        points = [a.entry.p_object_ee_m for a in self.arms]
        return points, [a.entry.internal_wrench_N_Nm or (0.0,) * 6 for a in self.arms]

    def _adaptation(self, arm: Arm) -> Adaptation | None:
        if self.file.controller.kind is not ControllerKind.ADAPTIVE:
            return None
        period_s = 1.0 / self.file.rate_hz
        return adaptive.build(self.file.controller, self.model(arm), arm.servos, self.file.object, arm.name, period_s)


def _posture(entry: ArmEntry) -> Posture | None:
    p = entry.posture
    return None if p is None else Posture(tuple(p.q_rad), p.stiffness_Nm_per_rad, p.damping_Nm_s_per_rad)


def placement(p_m: Sequence[float], quat: Sequence[float]) -> pin.SE3:
    """SE3 of a position and a scalar-first unit quaternion."""
    return pin.SE3(pin.Quaternion(*quat), np.array(p_m))


def load_cell(cell: Path, overrides: Sequence[str] = ()) -> Cell:
    """Read and validate a cell file, or the cell that ships under that name where there is no such file.

    overrides: "key.path=value" with TOML values.  Raises ConfigError, whose text names key, value found, what is
    allowed and what to do.
    """
    path = cell_path(cell)
    raw = read_file(path)
    document = parse(raw, path)
    if overrides:
        for text in overrides:
            override(document, text)
        raw = tomli_w.dumps(document).encode()
    return cell_from_toml(trajectory.embed(raw, document, path), path.name)


def cell_path(cell: Path) -> Path:
    """The file that is meant: this one, or that of the shipped cell of this name.  Raises ConfigError."""
    name = str(cell)
    if cell.name != name or not name or cell.is_file():
        return cell
    shipped = shipped_cells()
    if name in shipped:
        return configs.CELLS_DIR / f"{name}.toml"
    raise ConfigError(
        f"cell {shown(name)}",
        found="no such file, and no cell of that name that ships",
        expected="a cell file, or one of " + ", ".join(shipped),
        remedy=nearest(name.removesuffix(".toml"), shipped) or "give the path of a cell file",
    )


def cell_from_toml(raw: bytes, source: str, arms_dir: Path = configs.ARMS_DIR) -> Cell:
    """Validate the bytes of a cell file; arm files are taken from `arms_dir`.

    Raises ConfigError, and TrajectoryError for data that are not a motion.
    """
    file = validate(CellFile, parse(raw, Path(source)), source)
    trajectory.build(file)
    digest = hashlib.sha256(raw)
    arms = []
    for entry in file.arms:
        arm_file, arm_bytes = load_arm_file(entry.model, f"model of arm {entry.name} in {source}", arms_dir)
        urdf = read_file(arms_dir / arm_file.urdf)
        urdf_xml = text_of_urdf(urdf, arm_file.urdf)
        digest.update(arm_bytes)
        digest.update(urdf)
        by_name = {j.name: j for j in arm_file.joints}
        unknown = [j for j in (*entry.controlled, *entry.locked_rad) if j not in by_name]
        if unknown:
            raise ConfigError(
                f"joints of arm {entry.name} in {source}",
                found=", ".join(unknown),
                expected=f"joints of {entry.model}: {', '.join(by_name)}",
                remedy="correct `controlled` or `locked_rad`",
            )
        servos = tuple(by_name[j] for j in entry.controlled)
        _refuse_weak_servos(entry, servos, source)
        arms.append(Arm(entry, arm_file, arm_bytes, urdf_xml, servos))
    return Cell(file, tuple(arms), raw, digest.hexdigest())


def load_arm_file(model: str, what: str, arms_dir: Path = configs.ARMS_DIR) -> tuple[ArmFile, bytes]:
    """The description of an arm model and its exact bytes; what: who asks for it.  Raises ConfigError."""
    path = arms_dir / f"{model}.toml"
    if not path.is_file():
        raise ConfigError(
            what,
            found=repr(model),
            expected=" or ".join(sorted(p.stem for p in arms_dir.glob("*.toml"))),
            remedy="name a described arm, or describe yours beside them",
        )
    raw = read_file(path)
    return validate(ArmFile, parse(raw, path), path.name), raw


def _refuse_weak_servos(entry: ArmEntry, servos: Sequence[ServoJoint], source: str) -> None:
    for servo in servos:
        if not SERVOS[servo.servo].modes:
            raise ConfigError(
                f"controlled joint {servo.name} of arm {entry.name} in {source}",
                found=f"a {servo.servo}, which takes no torque, current or PWM command",
                expected="a servo with current or PWM mode",
                remedy="lock this joint instead (locked_rad)",
            )
