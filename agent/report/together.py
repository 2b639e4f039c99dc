"""How the arms get along, in numbers: what they noticed of each other, against the limits that their cell sets."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pydantic import ValidationError

from agent.config.schema.coordination import AlignmentSpec, NoticingSpec
from agent.config.schema.monitors import MonitorsSpec
from agent.host.info import CELL_FILE
from agent.monitors.bounds import Name
from agent.report.arithmetic import NAN
from agent.report.series import column
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.log.columns import Table
    from agent.log.read import AnyLog

CHANNELS: Final = ("fast_N", "fast_Nm", "slow_N", "slow_Nm")
ALONG: Final = ("level_N", "weight_N", "lifted_N", "knock_N", "load_N", "stuck_N")


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Limits of the cell file; NaN where it sets none."""

    shift_m: float = NAN
    fast_N: float = NAN
    fast_Nm: float = NAN
    slow_N: float = NAN
    slow_Nm: float = NAN
    level_N: float = NAN  # against the motion
    weight_N: float = NAN  # down
    lifted_N: float = NAN  # up
    knock_N: float = NAN  # what strikes
    load_N: float = NAN  # down, with what friction bears
    stuck_N: float = NAN  # and with joints that stick
    touch_N: float = NAN  # sudden, up to which it may be a touch


def thresholds(log: AnyLog) -> Thresholds:
    """The limits that a log's run had; NaN for what is off or unreadable.

    Those of noticing are in run.json, because a cell file need not say them.
    """
    try:
        cell = tomllib.loads(log.attachments[CELL_FILE].decode())
        alignment, noticing = _table(cell, "controller", "alignment"), _table(cell, "safety", "noticing")
        aligned, told = AlignmentSpec.model_validate(alignment), NoticingSpec.model_validate(noticing)
        shift_m = aligned.max_m if aligned.enabled else NAN
        limits = (_recorded(log, "noticing") or told.model_dump()) if told.enabled else {}
        along = _recorded(log, "noticing_against")
        touched = _recorded(log, "noticing_touch")
        found = [limits.get(name) for name in CHANNELS] + [along.get(name) for name in ALONG] + [touched.get("most_N")]
        return Thresholds(shift_m, *map(_number, found))
    except (KeyError, ValueError, TypeError, AttributeError, ValidationError):
        return Thresholds()


def load_limit(log: AnyLog) -> float:
    """Share of stall that a servo's load may be in the mean square; NaN for what is off or unreadable."""
    try:
        cell = tomllib.loads(log.attachments[CELL_FILE].decode())
        monitors = MonitorsSpec.model_validate(_table(cell, "safety", "monitors"))
    except (KeyError, ValueError, TypeError, AttributeError, ValidationError):
        return NAN
    return NAN if Name.SERVO_LOAD in monitors.off else monitors.load_share


def _recorded(log: AnyLog, what: str) -> dict[str, Any]:
    try:
        return dict(log.run_info().get(what) or {})
    except Refusal:
        return {}


def _number(value: float | None) -> float:
    return NAN if value is None else float(value)


def _table(cell: dict[str, Any], *keys: str) -> dict[str, Any]:
    found: Any = cell
    for key in keys:
        found = found.get(key, {})
    return dict(found)


def largest(rows: Table, name: str, part: slice) -> float:
    """The largest size of a vector in the rows; NaN where every one is none."""
    sizes = np.linalg.norm(column(rows, name, part), axis=1)
    return float(np.fmax.reduce(sizes)) if len(sizes) else NAN
