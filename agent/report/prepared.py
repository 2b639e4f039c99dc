"""A log made ready for figures and metrics: the run's rows, poses and true pose, each worked out once.  Never draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from agent.log.runinfo import RunArm, RunInfo, read_info
from agent.report.series import (
    Array,
    PoseSeries,
    column,
    grasp_wrenches,
    in_run,
    internal_wrenches,
    is_stale,
    on_time_of,
    pose_by_arm,
    pose_by_plant,
)

if TYPE_CHECKING:
    from agent.log.read import RunLog


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
    missing = [*info.notes, *log.problems, *_losses(log)]
    described = [arm.name for arm in info.arms]
    found = {name: in_run(log.agents[name], info) for name in described if name in log.agents}
    rows = {name: own for name, own in found.items() if len(own)}
    missing += [f"no row of the arm {name}" for name in described if name not in rows]
    stale = sum(int(is_stale(own).sum()) for own in rows.values())
    missing += [f"{stale} cycles brought no fresh joint state and count in no error"] if stale else []
    seen = {name: own[~is_stale(own)] for name, own in rows.items()}
    poses = {name: pose_by_arm(name, own) for name, own in seen.items()}
    true = grasps = None
    if log.plant is None or not len(log.plant):
        missing.append("no simulation in the log: no true object pose, realised internal force or realised load share")
    else:
        plant = in_run(on_time_of(log.plant, list(seen.values())), info)
        true, note = pose_by_plant([(poses[name], seen[name]) for name in seen], plant, 1.0 / info.rate_hz)
        missing += [note] if note else []
        grasps = _grasp_forces(plant, info, missing)
    return Prepared(log, info, rows, poses, true, grasps, tuple(missing))


def _losses(log: RunLog) -> list[str]:
    """What the recorder says was lost, and where."""
    told = log.metadata.get("completeness", {})
    places = {"lost_in_ring": "in the ring", "lost_on_the_way": "on the way", "lost_on_disk": "on the disk"}
    counts = {(member, place): told.get(f"{member}.{key}", "0") for member in log.gaps for key, place in places.items()}
    return [f"{count} rows of {member} were lost {place}" for (member, place), count in counts.items() if count != "0"]


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
