"""Whether the motion itself stays within what holds the arms; where it does not, they hold before it has been carried.

What the arms do as the files say is compared with the bounds of their monitors and with `safety.tracking_error_max_*`,
which half a step of every encoder must not reach.  Real arms are refused: they would hold an object in mid-air.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.control.models import ArmModel
from agent.monitors.bounds import Bounds, Name
from agent.verify.finding import Finding, Verdict
from agent.verify.path import Path
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import Vector

HALF_STEP_RAD: Final = 0.5 * TICK_RAD


class _Asked(NamedTuple):
    """What the motion takes and what there is of it."""

    what: str
    where: str
    takes: float
    most: float
    unit: str
    remedy: str


def asked(
    cell: Cell, each: Sequence[Bounds], models: Sequence[ArmModel], paths: Sequence[Path], instants: Sequence[float]
) -> list[Finding]:
    """What the motion takes more of than arms may give before they hold; nothing where it stays within.

    each, models, paths: one per arm, at these instants, s.
    """
    found = [x for arm, b, path in zip(cell.arms, each, paths, strict=True) for x in _of_arm(cell, arm.name, b, path)]
    found += [*_box(cell, each[0], instants), *_seen(cell, models, paths)]
    verdict = Verdict.REFUSED if cell.file.driver is DriverKind.DYNAMIXEL else Verdict.WARNING
    return [
        Finding(
            f"motion against monitors: {x.what}", x.where, f"{x.takes:.3g} {x.unit}", f"≤ {x.most:.3g}", verdict,
            x.remedy,
        )
        for x in found
        if not x.takes <= x.most
    ]  # fmt: skip


def _of_arm(cell: Cell, arm: str, b: Bounds, path: Path) -> Iterator[_Asked]:
    """The worst joint of each monitor that is on."""
    angles, ranges = np.array(path.q), np.array(b.position_rad)
    beyond = np.maximum(0.0, np.maximum(angles.max(axis=0) - ranges[:, 1], ranges[:, 0] - angles.min(axis=0)))
    warmed = math.sqrt(-math.expm1(-cell.file.duration_s / b.load_time_s))  # of what a mean over so long gets to
    slower, none = "move more slowly or less far", np.zeros(len(b.joints))
    each = (
        (Name.SPEED, path.dq_peak, np.array(b.speed_rad_per_s), "rad/s", f"{slower}, or raise speed_share"),
        (Name.POWER, path.power_peak, np.array(b.power_W), "W", f"{slower}, or raise power_share"),
        (Name.POSITION, beyond, none, "rad beyond its range", "keep from limits, or lower position_margin_rad"),
        (
            Name.LOAD, 100.0 * warmed * path.tau_rms / np.array(b.stall_Nm), none + 100.0 * b.load_share,
            "% of stall in the mean", "a lighter object or a pose with less load, or raise load_share",
        ),
    )  # fmt: skip
    for name, takes, most, unit, remedy in each:
        if name in b.watched:
            worst = int(np.argmax(takes - most))
            of = f"{name.value} of {b.joints[worst]}"
            yield _Asked(of, arm, float(takes[worst]), float(most[worst]), unit, f"{remedy} of safety.monitors")


def _box(cell: Cell, b: Bounds, instants: Sequence[float]) -> Iterator[_Asked]:
    """How far the desired object leaves the workspace, one for each axis; nothing where nobody watches it."""
    if Name.WORKSPACE not in b.watched:
        return
    places = np.array([cell.file.p_place_m, *(cell.trajectory().at(t).p for t in instants)])
    box = np.array(b.workspace_m)
    for axis, out_m in zip("xyz", np.max([box[:, 0] - places, places - box[:, 1]], axis=(0, 1)).tolist(), strict=True):
        yield _Asked(
            f"workspace along {axis}", "cell", max(0.0, out_m), 0.0, "m outside",
            "give safety.monitors.workspace_m that has the whole motion in it, or leave it out",
        )  # fmt: skip


def _seen(cell: Cell, models: Sequence[ArmModel], paths: Sequence[Path]) -> Iterator[_Asked]:
    """What half a step of all encoders makes of the object's place and attitude."""
    sizes = np.array([_of_steps(model, q) for model, path in zip(models, paths, strict=True) for q in path.q])
    least_m, least_rad = sizes.max(axis=0).tolist()
    safety = cell.file.safety
    for key, takes, most, unit in (
        ("tracking_error_max_m", least_m, safety.tracking_error_max_m, "m"),
        ("tracking_error_max_rad", least_rad, safety.tracking_error_max_rad, "rad"),
    ):
        yield _Asked(
            f"half a step of encoders and {key}", "cell", takes, most, unit,
            f"raise safety.{key}: an arm sees no error that small",
        )  # fmt: skip


def _of_steps(model: ArmModel, q: Vector) -> tuple[float, float]:
    """m, rad: the quadratic sum over the joints."""
    columns = HALF_STEP_RAD * model.task_basis.T @ model.jacobian(q)
    return float(np.linalg.norm(columns[:3])), float(np.linalg.norm(columns[3:]))
