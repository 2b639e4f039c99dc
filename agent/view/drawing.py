"""What a log or a cell says of how its arms and its object look; only the keys that a picture needs are read.

So a log of another release can be shown as long as it names its arms, their places and their URDFs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from agent.config.urdf import urdf_beside
from agent.host.info import CELL_FILE
from agent.view.arm import ArmDrawing
from agent.view.error import ViewError
from agent.view.shapes import Colour

if TYPE_CHECKING:
    from agent.config.files import CellFiles
    from agent.log.read import AnyLog

# blue, vermilion, green, purple: told apart by the colour-blind, and by their greys
ARM_COLOURS: Final[tuple[Colour, ...]] = ((0, 92, 158), (213, 94, 0), (0, 138, 100), (150, 90, 140))


@dataclass(frozen=True, slots=True)
class CellDrawing:
    """What is known of a cell before anything moves."""

    cell: str
    arms: tuple[ArmDrawing, ...]
    object_size_m: tuple[float, float, float]
    gravity: tuple[float, float, float]  # m/s², world

    def arm(self, name: str) -> ArmDrawing:
        """The arm of that name; raises KeyError."""
        return {arm.name: arm for arm in self.arms}[name]


def drawing_of_log(log: AnyLog) -> CellDrawing:
    """From the files attached to a log.  Raises ViewError when they are not there or lack a key."""
    files = log.attachments
    try:
        cell = _toml(files, CELL_FILE)
        return _drawing(cell, [_shape(files, cell, arm) for arm in cell["arms"]])
    except (KeyError, TypeError, ValueError) as error:
        raise ViewError(
            f"{log.path} cannot be shown", found=f"no {error}" if isinstance(error, KeyError) else str(error),
            expected="the cell file, the arm files and the URDFs that a recorder attaches",
            remedy="take a log that `coop record` or `coop run` made",
        ) from error  # fmt: skip


def drawing_of_cell(files: CellFiles) -> CellDrawing:
    """From a cell's own files."""
    shapes = [_Shape(arm.file.urdf, arm.urdf_xml, arm.file.ee_frame) for arm in files.arms]
    return _drawing(tomllib.loads(files.toml.decode()), shapes)


class _Shape(NamedTuple):
    urdf: str
    urdf_xml: str
    ee_frame: str


def _shape(files: Mapping[str, bytes], cell: Mapping[str, Any], arm: Mapping[str, Any]) -> _Shape:
    """Of one arm, from the files of a log, or from the cell itself where the arm has files of its own."""
    name, carried = arm.get("arm_file"), cell.get("embedded", {})
    described = _toml(files, f"{arm['model']}.toml") if name is None else tomllib.loads(carried[name])
    urdf = described["urdf"]
    own = None if name is None else carried.get(urdf_beside(name, urdf))
    return _Shape(urdf, files[urdf].decode() if own is None else own, str(described["ee_frame"]))


def _drawing(cell: Mapping[str, Any], shapes: Sequence[_Shape]) -> CellDrawing:
    arms = tuple(
        ArmDrawing(
            name=str(arm["name"]),
            urdf_xml=shapes[i].urdf_xml,
            urdf=shapes[i].urdf,
            controlled=tuple(arm["controlled"]),
            locked_rad=dict(arm.get("locked_rad", {})),
            p_world_base=_floats(arm["p_world_base_m"], 3),
            quat_world_base=_floats(arm["quat_world_base"], 4),
            ee_frame=shapes[i].ee_frame,
            colour=ARM_COLOURS[i % len(ARM_COLOURS)],
        )
        for i, arm in enumerate(cell["arms"])
    )
    x, y, z = _floats(cell["object"]["size_m"], 3)
    gx, gy, gz = _floats(cell["world"]["gravity_m_per_s2"], 3)
    return CellDrawing(str(cell["name"]), arms, (x, y, z), (gx, gy, gz))


def _toml(files: Mapping[str, bytes], name: str) -> dict[str, Any]:
    return tomllib.loads(files[name].decode())


def _floats(values: Sequence[Any], count: int) -> list[float]:
    if len(values) != count:
        raise ValueError(f"{len(values)} numbers where {count} belong")
    return [float(value) for value in values]
