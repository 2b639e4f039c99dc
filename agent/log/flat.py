"""Fields of rows as plain columns with names that say component and unit: `q_shoulder_rad`, `e_v_x_m_per_s`.

What is not there (joints, arms and parameters beyond those in use) gets no column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.log.columns import Column, Table
from agent.telemetry.row.sample import ARM_PARAMETERS, MAX_ARMS, MAX_JOINTS, Field

_SLUGS: Final = (("N·m", "Nm"), ("²", "2"), ("/", "_per_"), ("·", "_"))
_AXES: Final = {3: ("x", "y", "z"), 4: ("w", "x", "y", "z"), 6: ("x", "y", "z", "rx", "ry", "rz")}
_WRENCH: Final = 6
_PER_JOINT: Final = ARM_PARAMETERS // MAX_JOINTS
_OF_BODY: Final = (  # in pinocchio's order, about the origin of the body's frame
    ("mass", "kg"),
    *((f"first moment {axis}", "kg·m") for axis in "xyz"),
    *((f"inertia {axes}", "kg·m²") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
_OF_JOINT: Final = (
    ("rotor inertia", "kg·m²"), ("viscous friction", "N·m·s/rad"), ("Coulomb friction", "N·m"),
    ("breakaway", "N·m"), ("load friction", ""), ("breakaway load", ""),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FlatColumn:
    """One number of each row."""

    name: str
    field: str
    index: int | None  # in the field's array
    unit: str
    doc: str

    def of(self, values: Column) -> Column:
        """The column (k,) out of the field's values."""
        return values if self.index is None else np.asarray(values[:, self.index])


@dataclass(frozen=True, slots=True)
class Members:
    """Names of the arms in the plant's order and of their joints."""

    arms: tuple[str, ...]
    joints: tuple[tuple[str, ...], ...]


def flat_columns(fields: Iterable[Field], member: str, names: Members) -> list[FlatColumn]:
    """The columns of these fields; member: an arm, or the plant."""
    own = dict(zip(names.arms, names.joints, strict=True)).get(member)
    return [column for f in fields for column in _of_field(f, own, names)]


def _of_field(f: Field, joints: tuple[str, ...] | None, names: Members) -> list[FlatColumn]:
    if not f.length:
        return [FlatColumn(_named(f.name, "", f.unit), f.name, None, f.unit, f.doc)]
    if joints is not None and f.name in ("theta_arm", "theta_object"):
        return [_estimate(f, i, joints if f.name == "theta_arm" else ()) for i, _ in _parts(f, joints, names)]
    units = _units(f)
    return [
        FlatColumn(_named(f.name, part, units[i]), f.name, i, units[i], f.doc) for i, part in _parts(f, joints, names)
    ]


def _estimate(f: Field, i: int, joints: tuple[str, ...]) -> FlatColumn:
    """One parameter of an adaptive estimate: of links, then of joints, block after block; without joints the object's.

    Its name is its number, as docs/adaptive.md counts them.
    """
    bodies = len(_OF_BODY) * max(1, len(joints))
    if i < bodies:
        (what, unit), of = _OF_BODY[i % len(_OF_BODY)], f"link {joints[i // len(_OF_BODY)]}" if joints else "the object"
    else:
        block, j = divmod(i - bodies, len(joints))
        (what, unit), of = _OF_JOINT[block], f"joint {joints[j]}"
    return FlatColumn(f"{f.name}_{i}", f.name, i, unit, f"{f.doc}: {what} of {of}")


def _parts(f: Field, joints: tuple[str, ...] | None, names: Members) -> Sequence[tuple[int, str]]:
    """Which numbers of an array are in use, and what each is called."""
    if joints is not None:
        if f.length == MAX_JOINTS:
            return list(enumerate(joints))
        if f.name == "theta_arm":
            return [(i, str(i)) for i in range(min(f.length, _PER_JOINT * len(joints)))]
    else:
        arms = list(enumerate(names.arms))
        if f.length == MAX_ARMS:
            return arms
        if f.length == MAX_ARMS * _WRENCH:
            return [(_WRENCH * a + k, f"{arm}_{axis}") for a, arm in arms for k, axis in enumerate(_AXES[_WRENCH])]
        if f.length == MAX_ARMS * MAX_JOINTS:
            return [(MAX_JOINTS * a + k, f"{arm}_{j}") for a, arm in arms for k, j in enumerate(names.joints[a])]
    axes = _AXES.get(f.length)
    if axes is None or (f.length == len(_AXES[4]) and not f.name.startswith("quat")):
        return [(i, str(i)) for i in range(f.length)]
    return list(enumerate(axes))


def _units(f: Field) -> list[str]:
    """Unit of each number of an array: one for all, one each, or the first for the linear half of every six."""
    units = f.unit.split(", ")
    if len(units) == f.length:
        return units
    if len(units) == 2 and f.length % _WRENCH == 0:
        half = _WRENCH // 2
        return [units[i % _WRENCH // half] for i in range(f.length)]
    return [f.unit] * f.length


def _named(field: str, part: str, unit: str) -> str:
    slug = unit
    for sign, word in _SLUGS:
        slug = slug.replace(sign, word)
    stem = field.removesuffix(f"_{slug}") if slug else field
    return re.sub(r"\W", "_", "_".join(word for word in (stem, part, slug) if word))


def flatten(table: Table, columns: Iterable[FlatColumn]) -> dict[str, Column]:
    """The columns (k,) by name; each field is read once."""
    read: dict[str, Column] = {}
    found = {}
    for column in columns:
        if column.field not in read:
            read = {column.field: table[column.field]}
        found[column.name] = column.of(read[column.field])
    return found
