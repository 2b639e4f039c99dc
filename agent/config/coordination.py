"""How an arm of a cell lives with the others: its alignment and its sense of what acts on it."""

from __future__ import annotations

from agent.config import noticing
from agent.config.cell import Arm, Cell
from agent.control.alignment import Alignment
from agent.control.quaternion import Quat, Vec3
from agent.control.residual import Residual


def alignment(cell: Cell, arm: Arm) -> Alignment | None:
    """Alignment of this arm; None where the cell has it switched off."""
    spec = cell.file.controller.alignment
    if not spec.enabled:
        return None
    return Alignment(
        follows=arm.name != cell.arms[cell.anchor].name,
        ready_per_s=spec.ready_per_s,
        track_per_s=spec.track_per_s,
        dead_zone_m=spec.dead_zone_m,
        dead_zone_rad=spec.dead_zone_rad,
        max_m=spec.max_m,
        max_rad=spec.max_rad,
    )


def residual(cell: Cell, arm: Arm) -> Residual | None:
    """What this arm senses; None where the cell has it switched off.  Raises ConfigError."""
    spec = cell.file.safety.noticing
    if not spec.enabled:
        return None
    limits, along = noticing.thresholds(cell), noticing.against(cell)
    return Residual(
        period_s=1.0 / cell.file.rate_hz,
        delay_periods=cell.file.delay_periods,
        limits=limits,
        rate_per_s=spec.rate_per_s,
        slow_per_s=noticing.slow_rate(cell),
        against=along,
        knock=noticing.knock(cell, along),
        touch=noticing.touch(cell, limits),
        bearing=noticing.bearing(cell, arm),
    )


def start_pose(cell: Cell) -> tuple[Vec3, Quat]:
    """Where the cell says that the object is before the start."""
    return cell.file.p_place_m, cell.file.object.quat_start
