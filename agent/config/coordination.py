"""How an arm of a cell lives with the others: its alignment, what it senses of them, and what it learns of friction."""

from __future__ import annotations

from agent.config import noticing
from agent.config.cell import Arm, Cell
from agent.config.friction import unfiled
from agent.config.schema.controller import ControllerKind
from agent.control.alignment import Alignment
from agent.control.friction import Friction
from agent.control.friction_factor import FrictionFactor
from agent.control.quaternion import Quat, Vec3
from agent.control.residual import Residual

LEAST_FRICTION = 0.1  # times the file's, whatever the cell states


def alignment(cell: Cell, arm: Arm) -> Alignment | None:
    """Alignment of this arm; None where the cell has it switched off."""
    spec = cell.file.controller.alignment
    if not spec.enabled:
        return None
    return Alignment(
        follows=arm.name != cell.arms[cell.anchor].name,
        ready_per_s=spec.ready_per_s,
        track_per_s=spec.track_per_s,
        return_per_s=spec.return_per_s,
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


def friction_factor(cell: Cell, arm: Arm) -> FrictionFactor | None:
    """What this arm learns of its friction; None where it learns nothing (`unlearned`)."""
    friction = cell.offline(arm).friction
    return None if friction is None or unlearned(cell, arm) else _learner(cell, arm, friction)


def unlearned(cell: Cell, arm: Arm) -> str:
    """Why this arm learns nothing of its friction; empty where it does."""
    controller, friction = cell.file.controller, cell.offline(arm).friction
    if friction is None:
        return "controller.friction_feedforward is off"
    if controller.kind is ControllerKind.ADAPTIVE:
        return "the adaptive law has columns of its own for it"
    if not cell.file.safety.noticing.enabled:
        return "safety.noticing is off"
    if not controller.friction_learning_per_s:
        return "controller.friction_learning_per_s is 0"
    learner = _learner(cell, arm, friction)
    if not learner.usual_W:
        return "the arm's file has no dry friction"
    return "" if learner.least < learner.most else "tolerance.friction says that the arm's file is exact"


def _learner(cell: Cell, arm: Arm, friction: Friction) -> FrictionFactor:
    least, most = cell.tolerance.friction
    most *= 1.0 + unfiled(cell.tolerance, arm.servos)[0]
    return FrictionFactor.of(friction, cell.file.controller.friction_learning_per_s, max(least, LEAST_FRICTION), most)


def start_pose(cell: Cell) -> tuple[Vec3, Quat]:
    """Where the cell says that the object is before the start."""
    return cell.file.p_place_m, cell.file.object.quat_start
