"""What the gripper of an arm said while the arm held the object, from the log's health texts, about one a second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from agent.modes import Mode
from agent.report.quantity import Better, Unit

if TYPE_CHECKING:
    from agent.log.columns import Table
    from agent.log.servos import ServoTable

HOLDING: Final = (Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.FLOAT, Mode.STAND)


@dataclass(frozen=True, slots=True)
class GripResults:
    """A gripper while its arm held the object."""

    width_cmd_m: Annotated[float, Unit("m", Better.NEITHER)]  # told last; NaN of a gripper that keeps its place
    width_min_m: Annotated[float, Unit("m", Better.NEITHER)]
    width_max_m: Annotated[float, Unit("m", Better.NEITHER)]
    force_min_N: Annotated[float, Unit("N", Better.HIGHER)]  # of each finger, by current or PWM
    force_max_N: Annotated[float, Unit("N", Better.NEITHER)]
    force_limit_N: Annotated[float, Unit("N", Better.NEITHER)]  # that its effort limit allows, at the last width


def grip_results(rows: Table, table: ServoTable | None) -> GripResults | None:
    """None of an arm without servos, or whose gripper says nothing."""
    if table is None or not len(table) or not len(rows):
        return None
    at = np.searchsorted(np.asarray(rows["utc_ns"], dtype=np.int64), table.utc_ns, side="right") - 1
    holds = np.isin(np.asarray(rows["mode"])[np.maximum(at, 0)], [int(mode) for mode in HOLDING]) & (at >= 0)
    said = holds & np.isfinite(table.grip_width_m)
    if not said.any():
        return None
    width, force = table.grip_width_m[said], table.grip_force_N[said]
    return GripResults(
        width_cmd_m=float(table.grip_width_cmd_m[said][-1]),
        width_min_m=float(width.min()),
        width_max_m=float(width.max()),
        force_min_N=float(np.fmin.reduce(force)),
        force_max_N=float(np.fmax.reduce(force)),
        force_limit_N=float(table.grip_force_max_N[said][-1]),
    )
