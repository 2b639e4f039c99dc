"""Kinds of values that every part of the schema uses, each with the range in which it can be meant.

The ranges are wide: they refuse a slip of the decimal point or of the unit, not a bold choice.  Masses, moments
and lengths have least values, with which the figures of a check stay finite.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

MISFIT: Final = "misfit"  # type of the problems that `wrong` makes
AS_LIST: Final = Field(strict=False)  # a tuple is written as a list, an enumeration as its text


def wrong(key: str, *, found: object, expected: str, remedy: str) -> PydanticCustomError:
    """What a validator raises when a value, or several together, cannot be: the key that is wrong and what to do.

    key: below the place of the validator; empty when it is that place itself.
    """
    context = {"key": key, "found": str(found), "expected": expected, "remedy": remedy}
    return PydanticCustomError(MISFIT, "{expected}", context)


def nearest(name: str, known: Iterable[str]) -> str:
    """A question about the known name that is most like this one; empty when none is like it."""
    found = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {found[0]}?" if found else ""


def _unit_quaternion(value: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"norm 1 to 1e-6 (its norm is {norm:.9g})")
    return tuple(x / norm for x in value)


def _unit_axis(value: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"an axis of norm 1 (its norm is {norm:.9g})")
    return value


def _three(value: Any) -> Any:
    if not isinstance(value, (int, float, list, tuple)):
        raise ValueError("a number, or a list of three: x, y, z")
    return [value] * 3 if isinstance(value, (int, float)) else value


def _printable(value: str) -> str:
    if not value.isprintable() or not value.strip():
        raise ValueError("text that can be printed")
    return value


Label = Annotated[str, Field(min_length=1, max_length=128), AfterValidator(_printable)]  # of a joint, a frame, a port
Share = Annotated[float, Field(ge=0.0, le=1.0)]
LENGTHS_M: Final = (1e-6, 10.0)
Length = Annotated[float, Field(ge=LENGTHS_M[0], le=LENGTHS_M[1])]
Coordinate = Annotated[float, Field(ge=-100.0, le=100.0)]  # m
Speed = Annotated[float, Field(gt=0.0, le=100.0)]  # m/s or rad/s
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]  # rad; several turns may be meant
Attitude = Annotated[float, Field(gt=0.0, le=math.pi)]  # rad, size of an attitude error
MASSES_KG: Final = (1e-6, 100.0)
Mass = Annotated[float, Field(ge=MASSES_KG[0], le=MASSES_KG[1])]
MOMENTS_KG_M2: Final = (1e-12, 100.0)
Moment = Annotated[float, Field(ge=MOMENTS_KG_M2[0], le=MOMENTS_KG_M2[1])]
Instant = Annotated[float, Field(ge=0.0, le=1e6)]  # s; a million seconds are eleven days
LinearStiffness = Annotated[float, Field(ge=10.0, le=1e8)]  # N/m, of a grasp
AngularStiffness = Annotated[float, Field(ge=0.01, le=1e6)]  # N·m/rad
Duration = Annotated[float, Field(ge=0.01, le=1e6)]  # s, of something that moves
Gain = Annotated[float, Field(gt=0.0, le=1e5)]
Effort = Annotated[float, Field(ge=-1e4, le=1e4)]  # N, N·m
Smoothing = Annotated[float, Field(ge=1e-4, le=10.0)]  # rad/s, in which a friction changes its sign
Factor = Annotated[float, Field(ge=0.0, le=1e6)]
NAME_PATTERN: Final = r"^[a-z][a-z0-9_]{0,31}$"
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
STEM_PATTERN: Final = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
FileStem = Annotated[str, Field(pattern=STEM_PATTERN)]
HOST_PATTERN: Final = r"^[A-Za-z0-9][A-Za-z0-9.-]{0,252}$"
PORT_PATTERN: Final = r"^\S+$"
IN_WORDS: Final = {  # what a text of that pattern is, for a person
    NAME_PATTERN: "a to z, then a to z, 0 to 9 and _, 32 at most",
    STEM_PATTERN: "a letter or digit, then letters, digits, _ . and -, 64 at most",
    HOST_PATTERN: "a letter or digit, then letters, digits, . and -, 253 at most",
    PORT_PATTERN: "no blank in it",
}
Vec3 = Annotated[tuple[Coordinate, Coordinate, Coordinate], AS_LIST]
Wrench = Annotated[tuple[Effort, Effort, Effort, Effort, Effort, Effort], AS_LIST]
Quaternion = Annotated[tuple[float, float, float, float], AS_LIST, AfterValidator(_unit_quaternion)]
UnitVector = Annotated[tuple[float, float, float], AS_LIST, AfterValidator(_unit_axis)]
PerAxis = Annotated[
    tuple[Gain, Gain, Gain],
    AS_LIST,
    BeforeValidator(_three, json_schema_input_type=Gain | tuple[Gain, Gain, Gain]),
]


def _first_format(value: int) -> int:
    if value != 1:
        raise wrong("", found=value, expected="1, the one there is", remedy="take a version that knows this format")
    return value


Format = Annotated[int, AfterValidator(_first_format)]


class Strict(BaseModel):
    """Unknown keys fail; values are frozen and finite, and never made from text or from another kind of number.

    A whole number stands for the real one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def default(cls) -> Self:
        """All defaults, as they stand: to validate them builds a validator for each part while the schema loads."""
        return cls.model_construct()
