"""The files of a cell, read, validated and fingerprinted, for processes that compute no dynamics (no pinocchio)."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import configs
from agent.config import trajectory
from agent.config.embed import embed
from agent.config.reading import (
    CHANGED,
    ConfigError,
    parse,
    read_file,
    refuse_all,
    shipped_cells,
    shown,
    validate,
)
from agent.config.rewrite import rewritten
from agent.config.schema.arm import ArmFile, ServoJoint
from agent.config.schema.cell import CellFile
from agent.config.schema.member import Arm as ArmEntry
from agent.config.schema.tolerance import Tolerance
from agent.config.schema.types import nearest
from agent.config.urdf import text_of_urdf, urdf_beside
from agent.config.urdf_joints import moving
from agent.control.trajectory import Trajectory
from drivers.dynamixel.servo.models import SERVOS, ServoModel
from drivers.interface import Vector


@dataclass(frozen=True)
class ArmFiles:
    """One arm of the cell with everything its files say, resolved."""

    entry: ArmEntry
    file: ArmFile
    toml: bytes  # of the arm file
    urdf_xml: str
    servos: tuple[ServoJoint, ...]  # of the controlled joints, in order
    own_urdf: bool = False  # from beside the cell's own arm file, not one that ships

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


@dataclass(frozen=True)
class CellFiles:
    """The whole cell, with the exact bytes it came from."""

    file: CellFile
    arms: tuple[ArmFiles, ...]
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
    def tolerance(self) -> Tolerance:
        """How far reality may be from these files."""
        return self.file.tolerance

    @property
    def inertia_error(self) -> float:
        """Part by which the arms' inertia may be off: what is checked for, or what is stated of masses if more."""
        return max(self.file.safety.inertia_error, self.tolerance.masses)

    @property
    def period_ns(self) -> int:
        """Control period."""
        return round(1e9 / self.file.rate_hz)

    @property
    def anchor(self) -> int:
        """Place of the arm that aligns itself with none; the others do with it."""
        name = self.file.controller.alignment.anchor
        return 0 if name is None else self.index(name)

    def index(self, name: str) -> int:
        """Place of the arm of that name among the cell's arms.  Raises ConfigError."""
        names = [arm.name for arm in self.arms]
        if name not in names:
            raise ConfigError(
                f"arm of cell {self.file.name}",
                found=repr(name),
                expected=" or ".join(names),
                remedy="name one of the cell's arms",
            )
        return names.index(name)

    def trajectory(self) -> Trajectory:
        """The desired motion of the object."""
        return trajectory.build(self.file)


def load_files(cell: Path, overrides: Sequence[str] = ()) -> CellFiles:
    """Read and validate a cell file and what it names, or the cell that ships under that name where there is no file.

    overrides: "key.path=value" with TOML values.  Raises ConfigError, whose text names key, value found, what is
    allowed and what to do.
    """
    path = cell_path(cell)
    raw, source = read_file(path), path.name
    document = parse(raw, path)
    if overrides:
        source += CHANGED
        raw = rewritten(raw.decode(), overrides).encode()
        document = parse(raw, path)
    return files_from_toml(embed(raw, document, path), source)


def cell_path(cell: Path) -> Path:
    """The file that is meant: this one, or that of the shipped cell of this name.  Raises ConfigError."""
    name = str(cell)
    if cell.name != name or not name or cell.is_file():
        return cell
    shipped = shipped_cells()
    if name in shipped:
        return configs.CELLS_DIR / f"{name}.toml"
    if os.path.lexists(cell):
        return cell  # a folder, a pipe: whoever reads it says so
    raise ConfigError(
        f"cell {shown(name)}",
        found="no such file, and no cell of that name that ships",
        expected="a cell file, or one of " + ", ".join(shipped),
        remedy=nearest(name.removesuffix(".toml"), shipped) or "give the path of a cell file",
    )


def files_from_toml(raw: bytes, source: str, arms_dir: Path = configs.ARMS_DIR) -> CellFiles:
    """Validate the bytes of a cell file; arm files are taken from `arms_dir`.

    Raises ConfigError, and TrajectoryError for data that are not a motion.
    """
    file = validate(CellFile, parse(raw, Path(source)), source)
    trajectory.build(file)
    digest = hashlib.sha256(raw)
    arms: list[ArmFiles] = []
    problems: list[ConfigError] = []
    for entry in file.arms:
        try:
            arms.append(_arm(entry, file.embedded, source, arms_dir))
            digest.update(arms[-1].toml)
            digest.update(arms[-1].urdf_xml.encode())
        except ConfigError as error:
            problems.append(error)
    refuse_all(problems)
    return CellFiles(file, tuple(arms), raw, digest.hexdigest())


def _arm(entry: ArmEntry, embedded: Mapping[str, str], source: str, arms_dir: Path) -> ArmFiles:
    """One arm with what its files say.  Raises ConfigError."""
    if entry.arm_file is None:
        arm_file, arm_bytes = load_arm_file(entry.model, f"model of arm {entry.name} in {source}", arms_dir)
        own = None
    else:
        arm_file, arm_bytes = _own_arm_file(entry, entry.arm_file, embedded, source)
        own = embedded.get(urdf_beside(entry.arm_file, arm_file.urdf))
    beside = "" if entry.arm_file is None else f"no such URDF ships: put it beside {entry.arm_file}"
    urdf = read_file(arms_dir / arm_file.urdf, beside) if own is None else own.encode()
    urdf_xml = text_of_urdf(urdf, arm_file.urdf)
    by_name = {j.name: j for j in arm_file.joints}
    unknown = [j for j in (*entry.controlled, *entry.locked_rad) if j not in by_name]
    if unknown:
        raise ConfigError(
            f"joints of arm {entry.name} in {source}",
            found=", ".join(unknown),
            expected=f"joints of {entry.model}: {', '.join(by_name)}",
            remedy="correct `controlled` or `locked_rad`",
        )
    _refuse_unlike_joints(entry, arm_file, urdf_xml)
    servos = tuple(by_name[j] for j in entry.controlled)
    _refuse_weak_servos(entry, servos, source)
    return ArmFiles(entry, arm_file, arm_bytes, urdf_xml, servos, own is not None)


def _refuse_unlike_joints(entry: ArmEntry, arm_file: ArmFile, urdf_xml: str) -> None:
    """Raise ConfigError where the joints that move are not those of the servos, or do not turn as these do."""
    kinds, served = moving(urdf_xml), [joint.name for joint in arm_file.joints]
    what = f"joints of arm {entry.name} ({arm_file.urdf})"
    alone = [joint for joint in kinds if joint not in served]
    if alone and kinds.keys() >= set(served):  # else it is another arm's URDF, or names differ
        raise ConfigError(
            what, found=f"{', '.join(alone)}, without a servo",
            expected="a [[joints]] entry of the arm file for each joint that moves",
            remedy="give it one, or make it `fixed` in the URDF",
        )  # fmt: skip
    slides = [joint for joint in served if kinds.get(joint) == "prismatic"]
    if slides:
        raise ConfigError(
            what, found=f"{', '.join(slides)}, which slides", expected="joints that turn, as their servos do",
            remedy="make them `revolute`",
        )  # fmt: skip


def _own_arm_file(entry: ArmEntry, name: str, embedded: Mapping[str, str], source: str) -> tuple[ArmFile, bytes]:
    """The file that an arm of the cell names, from the cell's bytes.  Raises ConfigError."""
    what = f"arm_file of arm {entry.name} in {source}"
    if name not in embedded:
        raise ConfigError(
            what, found=f"{shown(name)}, whose text is not in the cell's bytes", expected="its text under [embedded]",
            remedy="load the cell from its file, beside which the arm file stands",
        )  # fmt: skip
    raw = embedded[name].encode()
    file = _arm_file(raw, name)
    if file.model != entry.model:
        raise ConfigError(
            what, found=f"{shown(name)}, a file of a {file.model}", expected=f"one of a {entry.model}, as `model` says",
            remedy="name the file of this arm, or correct `model`",
        )  # fmt: skip
    return file, raw


def load_arm_file(model: str, what: str, arms_dir: Path = configs.ARMS_DIR) -> tuple[ArmFile, bytes]:
    """The description of an arm model and its exact bytes; what: who asks for it.  Raises ConfigError."""
    path = arms_dir / f"{model}.toml"
    if not path.is_file():
        raise ConfigError(
            what,
            found=repr(model),
            expected=" or ".join(sorted(p.stem for p in arms_dir.glob("*.toml"))) or f"an arm file in {arms_dir}",
            remedy="name a described arm; a file of your own goes by `arm_file`, --arm-file",
        )
    raw = read_file(path)
    return _arm_file(raw, path.name), raw


def load_own_arm_file(path: Path) -> ArmFile:
    """An arm file of one's own.  Raises ConfigError."""
    return _arm_file(read_file(path, "give the path of an arm file; those that ship go by their model"), path.name)


@lru_cache(maxsize=8)  # arms of one kind
def _arm_file(raw: bytes, name: str) -> ArmFile:
    """The arm file of these bytes.  Raises ConfigError."""
    return validate(ArmFile, parse(raw, Path(name)), name)


def _refuse_weak_servos(entry: ArmEntry, servos: Sequence[ServoJoint], source: str) -> None:
    for servo in servos:
        if not SERVOS[servo.servo].modes:
            raise ConfigError(
                f"controlled joint {servo.name} of arm {entry.name} in {source}",
                found=f"a {servo.servo}, which takes no torque, current or PWM command",
                expected="a servo with current or PWM mode",
                remedy="lock this joint instead (locked_rad)",
            )
