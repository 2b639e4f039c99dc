"""How the arms get along, in numbers: what they noticed of each other, against the limits that their cell sets."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pydantic import ValidationError

from agent.config.schema.coordination import AlignmentSpec, NoticingSpec
from agent.report.series import column

if TYPE_CHECKING:
    from agent.log.columns import Table
    from agent.log.read import AnyLog

BUS: Final = ("bus_timeouts", "bus_corrupt", "bus_alerts", "bus_retries")
NAN: Final = float("nan")


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Limits of the cell file; NaN where it sets none."""

    shift_m: float = NAN
    fast_N: float = NAN
    fast_Nm: float = NAN
    slow_N: float = NAN
    slow_Nm: float = NAN


def thresholds(log: AnyLog) -> Thresholds:
    """What `[controller.alignment]` and `[safety.noticing]` of a log's cell say; NaN for what is off or unreadable."""
    try:
        cell = tomllib.loads(log.attachments["cell.toml"].decode())
        alignment, noticing = _table(cell, "controller", "alignment"), _table(cell, "safety", "noticing")
        aligned, told = AlignmentSpec.model_validate(alignment), NoticingSpec.model_validate(noticing)
        shift_m = aligned.max_m if aligned.enabled else NAN
        if not told.enabled:
            return Thresholds(shift_m)
        return Thresholds(shift_m, told.fast_N, told.fast_Nm, told.slow_N, told.slow_Nm)
    except (KeyError, ValueError, AttributeError, ValidationError):
        return Thresholds()


def _table(cell: dict[str, Any], *keys: str) -> dict[str, Any]:
    found: Any = cell
    for key in keys:
        found = found.get(key, {})
    return dict(found)


def largest(rows: Table, name: str, part: slice) -> float:
    """The largest size of a vector in the rows; NaN where every one is none."""
    sizes = np.linalg.norm(column(rows, name, part), axis=1)
    return float(np.fmax.reduce(sizes)) if len(sizes) else NAN
