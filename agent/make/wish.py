"""What a person wants of a cell, in words as they are given to `coop new`, read strictly."""

from __future__ import annotations

import enum
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import configs
from agent.config.files import load_own_arm_file
from agent.config.reading import ConfigError, shown
from agent.config.schema.types import IN_WORDS, LENGTHS_M, MASSES_KG, MOMENTS_KG_M2, NAME_PATTERN, nearest

Vec3 = tuple[float, float, float]
FACES: Final[dict[str, Vec3]] = {  # outward normals, object axes; the names of arms that hold there
    "-x": (-1.0, 0.0, 0.0), "+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
}  # fmt: skip
NAMES: Final = {"-x": "left", "+x": "right", "+y": "back", "-y": "front"}
FILE: Final = ".toml"  # ends the path of an arm file
WORDS: Final = ("face", "down", "base", "pose", "share", "name", "inset")
DOWN_SPATIAL_DEG: Final = 60.0  # of six joints: the hand reaches the side from above; arms in a plane hold level
QUATERNION_OFF: Final = 1e-2  # a norm this far from 1 is no rounding
INSET_M: Final = 0.015  # how deep the fingers reach over the face


class WishError(ConfigError):
    """What is wanted cannot be."""


class ShapeKind(enum.StrEnum):
    """What the object is like, for its inertia."""

    BOX = "box"
    BAR = "bar"  # a box, too: long in x
    CYLINDER = "cylinder"  # its axis is x, its radius half the smaller of the other sides


class MotionKind(enum.StrEnum):
    """What the object is to do."""

    LIFT = "lift"
    CARRY = "carry"
    SINUSOID = "sinusoid"
    WAYPOINTS = "waypoints"


@dataclass(frozen=True, slots=True)
class ArmWish:
    """One arm: what it is and where it holds."""

    name: str
    model: str
    face: str
    down_deg: float | None = None
    inset_m: float = INSET_M
    base: tuple[float, float, float, float] | None = None  # x, y, z in m, yaw in degrees; None: to be proposed
    pose: tuple[float, ...] | None = None  # p and quat of the end effector, object axes, in place of face
    share: float | None = None
    arm_file: Path | None = None  # of this arm's own figures; None: the one of its model that ships


@dataclass(frozen=True, slots=True)
class ObjectWish:
    """The object."""

    mass_kg: float
    size_m: Vec3
    shape: ShapeKind = ShapeKind.BOX
    inertia_kg_m2: Vec3 | None = None

    def require_possible(self) -> None:
        """Raise WishError, by the option that says so, for what no cell may have as its object."""
        of_inertia = "moments of inertia by --mass and --size" if self.inertia_kg_m2 is None else "--inertia"
        for option, unit, values, (least, most) in (
            ("--mass", "kg", (self.mass_kg,), MASSES_KG),
            ("--size", "m", self.size_m, LENGTHS_M),
            (of_inertia, "kg·m²", self.moments(), MOMENTS_KG_M2),
        ):
            if not all(least <= x <= most for x in values):
                found = ",".join(f"{x:g}" for x in values)
                raise WishError(option, found=found, expected=f"{least:g} to {most:g} {unit}", remedy="correct it")

    def moments(self) -> Vec3:
        """Principal moments of a solid of uniform density, or those given."""
        if self.inertia_kg_m2 is not None:
            return self.inertia_kg_m2
        m, (a, b, c) = self.mass_kg, self.size_m
        if self.shape is ShapeKind.CYLINDER:
            r = 0.5 * min(b, c)
            across = m * (3.0 * r * r + a * a) / 12.0
            return 0.5 * m * r * r, across, across
        return m * (b * b + c * c) / 12.0, m * (a * a + c * c) / 12.0, m * (a * a + b * b) / 12.0


@dataclass(frozen=True, slots=True)
class MotionWish:
    """The motion, relative to the start."""

    kind: MotionKind
    by_m: Vec3 = (0.0, 0.0, 0.05)
    time_s: float = 5.0  # of one way, or of a period
    points: tuple[tuple[float, Vec3], ...] = ()  # t, position less the start


@dataclass(frozen=True, slots=True)
class Wish:
    """All of it."""

    name: str
    arms: tuple[ArmWish, ...]
    object: ObjectWish
    motion: MotionWish
    height_m: float | None = None  # of the object's centre at the start, above the table; None: to be proposed
    rate_hz: float = 200.0
    folder: Path = Path()  # where the cell file is to stand


def arm_wishes(texts: Sequence[str]) -> tuple[ArmWish, ...]:
    """Of "MODEL [WORD=VALUE]..." each; faces and names that are not given are dealt out.

    An arm file may stand in place of its model.  Raises WishError, and ConfigError for a file that is none.
    """
    if not 1 <= len(texts) <= len(FACES):
        raise WishError("arms", found=len(texts), expected=f"1 to {len(FACES)}", remedy="give --arm MODEL for each")
    parsed = [_words(text) for text in texts]
    taken = [words.get("face", "") for _, words in parsed]
    free = iter([face for face in FACES if face not in taken])
    found = [_arm(model, words, words.get("face") or next(free)) for model, words in parsed]
    names = [arm.name for arm in found]
    if len(set(names)) < len(names):
        raise WishError(
            "arms", found=", ".join(names), expected="names that differ", remedy="give each a face, or name=..."
        )
    return tuple(found)


def _words(text: str) -> tuple[str, dict[str, str]]:
    model, *rest = text.split() or [""]
    described = sorted(path.stem for path in configs.ARMS_DIR.glob("*.toml"))
    if model not in described and not model.endswith(FILE):
        first = 'name a described arm, or its file, first, and put words apart by spaces: --arm "wx250s face=-x"'
        raise WishError(
            f"arm {shown(text)}", found=f"a model {model!r}", expected=f"{', '.join(described)} or an arm file (.toml)",
            remedy=first if "=" in model else nearest(model, described) or first,
        )  # fmt: skip
    words: dict[str, str] = {}
    for word in rest:
        key, separator, value = word.partition("=")
        if key not in WORDS or not separator or not value:
            raise WishError(
                f"arm {shown(text)}", found=repr(word), expected=", ".join(f"{w}=..." for w in WORDS),
                remedy=nearest(key, WORDS) or "see `coop new -h`",
            )  # fmt: skip
        if key in words:
            raise WishError(
                f"arm {shown(text)}", found=f"{key}= twice", expected=f"one {key}=", remedy="leave one of them out"
            )
        words[key] = value
    return model, words


def _arm(named: str, words: dict[str, str], face: str) -> ArmWish:
    what, file = f"arm {named}", Path(named) if named.endswith(FILE) else None
    model = named if file is None else load_own_arm_file(file).model
    if face not in FACES:
        raise WishError(
            f"face of {what}", found=face, expected=" or ".join(FACES), remedy="name a side, or give pose=..."
        )
    down = _one(words, "down", what, -45.0, 90.0)
    share = _one(words, "share", what, 0.0, 1.0)
    inset = _one(words, "inset", what, -0.1, 0.2)
    base, pose = words.get("base"), words.get("pose")
    x = None if base is None else numbers(base, 4, f"base of {what}", "x,y,z,yaw in m and degrees")
    p = None if pose is None else numbers(pose, 7, f"pose of {what}", "x,y,z,qw,qx,qy,qz in object axes")
    if p is not None and abs(math.hypot(*p[3:]) - 1.0) > QUATERNION_OFF:
        raise WishError(
            f"pose of {what}", found=f"a quaternion of norm {math.hypot(*p[3:]):g}", expected="norm 1, w x y z",
            remedy="correct it; 1,0,0,0 is not turned",
        )  # fmt: skip
    called = name(words.get("name", NAMES[face]), f"name of {what}", "give name=... in such letters")
    return ArmWish(
        called, model, face, down, INSET_M if inset is None else inset,
        None if x is None else (x[0], x[1], x[2], x[3]), p, share, file,
    )  # fmt: skip


def _one(words: dict[str, str], key: str, what: str, low: float, high: float) -> float | None:
    if key not in words:
        return None
    (value,) = numbers(words[key], 1, f"{key} of {what}", f"{low:g} to {high:g}")
    if not low <= value <= high:
        raise WishError(f"{key} of {what}", found=f"{value:g}", expected=f"{low:g} to {high:g}", remedy="correct it")
    return value


def name(text: str, what: str, remedy: str) -> str:
    """A name as cell files have it.  Raises WishError."""
    if not re.fullmatch(NAME_PATTERN, text):
        raise WishError(what, found=shown(repr(text)), expected=IN_WORDS[NAME_PATTERN], remedy=remedy)
    return text


def vector(text: str, what: str) -> Vec3:
    """Of "x,y,z".  Raises WishError."""
    x, y, z = numbers(text, 3, what, "x,y,z")
    return x, y, z


def numbers(text: str, count: int, what: str, expected: str) -> tuple[float, ...]:
    """So many finite numbers between commas.  Raises WishError."""
    try:
        found = tuple(float(word) for word in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise WishError(what, found=shown(repr(text)), expected=expected, remedy="separate numbers by commas")
    return found


def points_of(texts: Iterable[str]) -> tuple[tuple[float, Vec3], ...]:
    """Way-points "t,dx,dy,dz", the start before them.  Raises WishError."""
    found = [numbers(text, 4, "way-point", "t,dx,dy,dz in s and m") for text in texts]
    return tuple((t, (x, y, z)) for t, x, y, z in found)
