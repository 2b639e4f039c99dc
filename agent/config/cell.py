"""A validated cell: its files, the arms' models, and the offline data of each agent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

import configs
from agent.config import adaptive
from agent.config.files import ArmFiles, CellFiles, files_from_toml, load_arm_file, load_files
from agent.config.friction import joint_friction, unfiled
from agent.config.reading import ConfigError
from agent.config.schema.cell import CellFile
from agent.config.schema.controller import ControllerKind
from agent.config.schema.member import Arm as ArmEntry
from agent.config.schema.tolerance import PLANAR_JOINTS
from agent.control.adaptation import Adaptation
from agent.control.errors import Gains
from agent.control.friction import Friction
from agent.control.internal_force import agent_wrench
from agent.control.law import Offline
from agent.control.models import ArmModel, ModelError
from agent.control.posture import Posture
from agent.control.quaternion import Vec3
from agent.control.trajectory import Vec6

__all__ = ["Arm", "Cell", "ConfigError", "cell_from_toml", "load_arm_file", "load_cell", "placement"]


@dataclass(frozen=True)
class Arm(ArmFiles):
    """One arm of the cell with everything its files say, resolved."""

    @property
    def T_world_base(self) -> pin.SE3:
        """Base pose in the world."""
        return placement(self.entry.p_world_base_m, self.entry.quat_world_base)

    @property
    def T_object_ee(self) -> pin.SE3:
        """Grasp pose: end effector in the object frame."""
        return placement(self.entry.p_object_ee_m, self.entry.quat_object_ee)

    @property
    def rest_rad(self) -> dict[str, float]:
        """How joints lie while the arm rests, those of which cell or arm file says it."""
        return {**self.file.sleep_rad, **self.entry.rest_rad}


@dataclass(frozen=True)
class Cell(CellFiles):
    """The whole cell, with the exact bytes it came from."""

    arms: tuple[Arm, ...]

    @property
    def T_world_object_start(self) -> pin.SE3:
        """Pose of the object before the run."""
        return placement(self.file.p_place_m, self.file.object.quat_start)

    @property
    def planar(self) -> bool:
        """Whether every arm moves in a plane."""
        return all(arm.n <= PLANAR_JOINTS for arm in self.arms)

    def arm(self, name: str) -> Arm:
        """The arm of that name.  Raises ConfigError."""
        return self.arms[self.index(name)]

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
            k_v=(*entry.k_v_N_s_per_m, *entry.k_v_Nm_s_per_rad),
        )
        friction = None
        if c.friction_feedforward:
            friction = Friction(tuple(joint_friction(s) for s in arm.servos), c.friction_smooth_rad_per_s)
        return Offline(
            gains=gains,
            load_share=entry.load_share,
            object_mass_kg=obj.mass_kg,
            object_inertia=tuple(x for row in obj.inertia_kg_m2.matrix() for x in row),  # type: ignore[arg-type]
            gravity=self.file.world.gravity_m_per_s2,
            friction=friction,
            posture=_posture(entry),
            internal_wrench=self.internal_wrench(arm),
            adaptation=self._adaptation(arm),
        )

    def internal_wrench(self, arm: Arm) -> Vec6 | None:
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
    """Read and validate a cell file, or the cell that ships under that name; overrides: "key.path=value", TOML values.

    Raises ConfigError, whose text names key, value found, what is allowed and what to do.
    """
    return _cell(load_files(cell, overrides))


def cell_from_toml(raw: bytes, source: str, arms_dir: Path = configs.ARMS_DIR) -> Cell:
    """Validate the bytes of a cell file; arm files are taken from `arms_dir`.

    Raises ConfigError, and TrajectoryError for data that are not a motion.
    """
    return _cell(files_from_toml(raw, source, arms_dir))


def _cell(files: CellFiles) -> Cell:
    arms = tuple(Arm(a.entry, a.file, a.toml, a.urdf_xml, a.servos, a.own_urdf) for a in files.arms)
    for arm in arms:
        _require_breakaway(files.file, arm)
    return Cell(files.file, arms, files.toml, files.fingerprint)


def _require_breakaway(file: CellFile, arm: Arm) -> None:
    """Refuse a speed over which an arm's breakaway falls off that has none.  Raises ConfigError."""
    reality = file.simulation.reality
    real = None if reality is None else reality.arms.get(arm.name)
    if reality is None or real is None or real.stribeck_rad_per_s is None or real.breakaway_Nm:
        return
    filed = any(joint.breakaway_Nm or joint.breakaway_load for joint in map(joint_friction, arm.servos))
    drawn = reality.seed is not None and unfiled(file.tolerance, arm.servos)[0] > 0.0
    if not (filed or drawn):
        raise ConfigError(
            f"simulation.reality.arms.{arm.name}.stribeck_rad_per_s",
            found=f"{real.stribeck_rad_per_s:g}, of no breakaway",
            expected="breakaway that falls off over it, here or in the arm file",
            remedy="give breakaway_Nm as well, or leave it out",
        )  # fmt: skip
