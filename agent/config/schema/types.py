"""Kinds of values that every part of the schema uses."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

MISFIT: Final = "misfit"  # type of the problems that `wrong` makes


def _unit_quaternion(value: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.sqrt(sum(x * x for x in value))
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"norm 1 to 1e-6 (its norm is {norm:.9g})")
    return tuple(x / norm for x in value)


def _unit_axis(value: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.sqrt(sum(x * x for x in value))
    if abs(norm - 1.0) > 1e-6:
        raise ValueError(f"an axis of norm 1 (its norm is {norm:.9g})")
    return value


def _three(value: Any) -> Any:
    return [value] * 3 if isinstance(value, (int, float)) else value


Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vec3 = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_unit_quaternion)]
UnitVector = Annotated[Vec3, AfterValidator(_unit_axis)]
PerAxis = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(_three)]


def wrong(key: str, *, found: object, expected: str, remedy: str) -> PydanticCustomError:
    """What a validator raises when values do not fit together: the key that is wrong and what to do."""
    context = {"key": key, "found": str(found), "expected": expected, "remedy": remedy}
    return PydanticCustomError(MISFIT, "{expected}", context)


class Strict(BaseModel):
    """Unknown keys fail, values are frozen and never coerced from text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)
