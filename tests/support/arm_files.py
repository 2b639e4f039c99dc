"""Arm descriptions of a plant that differs from what the shipped ones say, in a folder of their own."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import configs
from agent.config.cell import Cell, cell_from_toml
from agent.config.edit import Change, apply
from agent.config.schema.arm import ArmFile, ServoJoint

_FIGURES = ("rotor_inertia_kg_m2", "coulomb_Nm", "viscous_Nm_s_per_rad")


def with_true_arms(
    cell: Cell, directory: Path, *, inertia: float = 1.0, factors: Mapping[str, Mapping[str, float]] | None = None
) -> Cell:
    """The same cell, its arms described anew in `directory`.

    inertia multiplies mass, inertia tensor and rotor inertia of everything; factors: by joint, by key of the arm file.
    """
    shutil.copytree(configs.ARMS_DIR, directory, ignore=shutil.ignore_patterns("*.py"), dirs_exist_ok=True)
    for arm in cell.arms:
        urdf = directory / arm.file.urdf
        urdf.write_text(_scaled_urdf(arm.urdf_xml, inertia))
        changes = []
        for servo in arm.file.joints:
            own = dict(factors.get(servo.name, {})) if factors else {}
            own["rotor_inertia_kg_m2"] = own.get("rotor_inertia_kg_m2", 1.0) * inertia
            changes += [_scaled(servo.name, key, getattr(servo, key).value * own.get(key, 1.0)) for key in _FIGURES]
        path = directory / f"{arm.entry.model}.toml"
        path.write_text(apply((configs.ARMS_DIR / path.name).read_text(), changes))
    return cell_from_toml(cell.toml, "the true cell", directory)


def with_figures(cell: Cell, directory: Path, figures: Callable[[ServoJoint], Mapping[str, float]]) -> Cell:
    """The same cell whose arm files in `directory` have these figures, by key, of every joint."""
    shutil.copytree(configs.ARMS_DIR, directory, ignore=shutil.ignore_patterns("*.py"), dirs_exist_ok=True)
    for path in sorted({directory / f"{arm.entry.model}.toml" for arm in cell.arms}):
        joints = ArmFile.model_validate(tomllib.loads(path.read_text())).joints
        changes = [_scaled(joint.name, key, value) for joint in joints for key, value in figures(joint).items()]
        path.write_text(apply(path.read_text(), changes))
    return cell_from_toml(cell.toml, "the cell", directory)


def sticking(joint: ServoJoint) -> Mapping[str, float]:
    """Breakaway half above Coulomb over 0.3 rad/s, of which 5 % of the motor's torque is added."""
    breakaway = 0.5 * joint.coulomb_Nm.value
    return {"breakaway_Nm": breakaway, "stribeck_rad_per_s": 0.3, "load_friction": 0.05}


def pressed_on(joint: ServoJoint) -> Mapping[str, float]:
    """BAM's model M4 of the MX-64 (docs/arms.md): at breakaway half of the motor's torque is friction."""
    breakaway = 0.39 * joint.coulomb_Nm.value
    return {
        "breakaway_Nm": breakaway,
        "stribeck_rad_per_s": 1.52,
        "stribeck_exponent": 1.33,
        "breakaway_load_friction": 0.469,
    }


def _scaled(joint: str, key: str, value: float) -> Change:
    return Change("joints", key, f'{{ value = {value!r}, status = "estimated", source = "of this test" }}', joint)


def _scaled_urdf(text: str, factor: float) -> str:
    def times(match: re.Match[str]) -> str:
        return f'{match[1]}"{float(match[2]) * factor!r}"'

    return re.sub(r"(<mass value=|\bi[xyz][xyz]=)\"([^\"]+)\"", times, text)
