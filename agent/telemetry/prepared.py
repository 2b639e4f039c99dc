"""A log made ready for figures and metrics: the run's rows, poses and true pose, each worked out once.  Never draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.runinfo import RunArm, RunInfo, read_info
from agent.telemetry.series import (
    Array,
    PoseSeries,
    column,
    grasp_wrenches,
    in_run,
    internal_wrenches,
    pose_by_arm,
    pose_by_plant,
)

if TYPE_CHECKING:
    from agent.telemetry.read import RunLog


@dataclass(frozen=True, slots=True)
class GraspForces:
    """What the simulation's grasps carried, one row per plant tick, arms in the order of the run."""

    t: Array
    wrenches: Array  # (k, N, 6) of each arm on the object at its end effector, world axes
    internal: Array  # (k, N, 6) the part that moves nothing; moments NaN without grasp offsets


@dataclass(frozen=True, slots=True)
class Prepared:
    """What report and figures work from; arms without a row are in `info.arms` only."""

    log: RunLog
    info: RunInfo
    rows: Mapping[str, NDArray[np.void]]  # of the run itself, per arm with at least one row
    poses: Mapping[str, PoseSeries]  # the object as each arm sees it
    true: PoseSeries | None
    grasps: GraspForces | None
    missing: tuple[str, ...]  # what the log cannot tell, and why

    @property
    def arms(self) -> list[RunArm]:
        """The arms that have rows, in the order of the run."""
        return [arm for arm in self.info.arms if arm.name in self.rows]


def prepare(log: RunLog) -> Prepared:
    """Work out every series that the report needs.  Never raises for a poor log: `missing` says what is absent."""
    info = read_info(log)
    missing = list(info.notes)
    described = [arm.name for arm in info.arms]
    found = {name: in_run(log.agents[name], info) for name in described if name in log.agents}
    rows = {name: own for name, own in found.items() if len(own)}
    missing += [f"no row of the arm {name}" for name in described if name not in rows]
    poses = {name: pose_by_arm(name, own) for name, own in rows.items()}
    true = grasps = None
    if log.plant is None or not len(log.plant):
        missing.append("no simulation in the log: no true object pose, realised internal force or realised load share")
    else:
        plant = in_run(log.plant, info)
        true = _true_pose(plant, info, list(poses.values()), missing)
        grasps = _grasp_forces(plant, info, missing)
    return Prepared(log, info, rows, poses, true, grasps, tuple(missing))


def _true_pose(
    plant: NDArray[np.void], info: RunInfo, poses: list[PoseSeries], missing: list[str]
) -> PoseSeries | None:
    try:
        series = pose_by_plant(poses, plant, 1.0 / info.rate_hz)
    except ValueError as mismatch:
        missing.append(f"the true object pose cannot be used: {mismatch}")
        return None
    if series is None and poses:
        missing.append("no tick is in both the plant's and an arm's log: errors are by the arms' own kinematics")
    return series


def _grasp_forces(plant: NDArray[np.void], info: RunInfo, missing: list[str]) -> GraspForces:
    offsets = _grasp_offsets(info)
    if offsets is None:
        missing.append("moments of the realised internal wrench need the grasp offsets of every arm")
    wrenches = grasp_wrenches(plant, len(info.arms))
    internal = internal_wrenches(wrenches, column(plant, "quat_object"), offsets)
    return GraspForces(column(plant, "t"), wrenches, internal)


def _grasp_offsets(info: RunInfo) -> Array | None:
    offsets = [arm.p_object_ee_m for arm in info.arms if arm.p_object_ee_m is not None]
    return np.array(offsets) if offsets and len(offsets) == len(info.arms) else None
