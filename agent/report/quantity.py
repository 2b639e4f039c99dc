"""Units in the annotations of result records, and what follows from them: flat names, plain JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, get_type_hints


class Better(Enum):
    """Which of two values of a figure is the better one."""

    LOWER = "lower"
    HIGHER = "higher"
    NEITHER = "neither"


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of a figure and which way is better, in the annotation of its field."""

    unit: str
    better: Better = Better.LOWER


@dataclass(frozen=True, slots=True)
class Quantity:
    """One figure by itself, as `coop compare` uses it; NaN = not measured."""

    value: float
    unit: str
    better: Better


@cache
def units_of(record: type) -> dict[str, Unit]:
    """Name of each marked field of a dataclass, with its mark."""
    hints = get_type_hints(record, include_extras=True)
    return {
        name: mark
        for name, hint in hints.items()
        for mark in getattr(hint, "__metadata__", ())
        if isinstance(mark, Unit)
    }


def flatten(thing: Any, prefix: str = "") -> Iterator[tuple[str, Quantity]]:
    """Every marked figure in a tree of dataclasses and mappings, with its dotted name."""
    if isinstance(thing, Mapping):
        for key, value in thing.items():
            yield from flatten(value, f"{prefix}{key}.")
    elif is_dataclass(thing) and not isinstance(thing, type):
        units = units_of(type(thing))
        for f in fields(thing):
            value = getattr(thing, f.name)
            if f.name in units:
                yield f"{prefix}{f.name}", Quantity(float(value), units[f.name].unit, units[f.name].better)
            else:
                yield from flatten(value, f"{prefix}{f.name}.")


def json_ready(thing: Any) -> Any:
    """The same tree in what JSON has: mappings, lists, strings, numbers; what is not finite becomes null."""
    if isinstance(thing, Mapping):
        return {str(k): json_ready(v) for k, v in thing.items()}
    if is_dataclass(thing) and not isinstance(thing, type):
        return {f.name: json_ready(getattr(thing, f.name)) for f in fields(thing)}
    if isinstance(thing, list | tuple):
        return [json_ready(v) for v in thing]
    if isinstance(thing, float) and not math.isfinite(thing):
        return None
    return thing
