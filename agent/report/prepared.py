"""A log made ready for figures and metrics: the run's rows by arm, the true pose, what the grasps carried.

Rows stay where the log has them; a series is worked out when it is asked for, so that one arm's is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from agent.log.columns import Table
from agent.log.runinfo import RunArm, RunInfo, read_info
from agent.log.when import by_one_clock, on_time_of
from agent.report.series import (
    Array,
    PoseSeries,
    column,
    going_on,
    grasp_wrenches,
    in_run,
    internal_wrenches,
    is_stale,
    meant_by_shares,
    nearest,
    pose_by_arm,
    pose_by_plant,
)
from agent.telemetry.row.event import HOLDS

if TYPE_CHECKING:
    from agent.log.read import AnyLog

_BLOCK_ROWS: Final = 1 << 15
_ASKED_WITHIN_NS: Final = 20_000_000  # of a row of the plant the row of an arm


@dataclass(frozen=True, slots=True)
class GraspForces:
    """What the simulation's grasps carried, one row per plant tick, arms in the order of the run."""

    t: Array
    plant: Table
    internal_force: Array  # (k, N) size of the part that moves nothing, N
    unasked_force: Array  # (k, N) the same less what load share and internal wrench asked of each arm
    internal_moment: Array  # (k, N) N·m; NaN without grasp offsets


@dataclass(frozen=True, slots=True)
class Prepared:
    """What report and figures work from; arms without a row of the motion are in `info.arms` and perhaps in `whole`."""

    log: AnyLog
    info: RunInfo
    whole: Mapping[str, Table]  # every row of an arm that has one: its wait for the start, and what came behind the end
    rows: Mapping[str, Table]  # of the motion, per arm with at least one
    seen: Mapping[str, Table]  # those with a fresh state
    true: PoseSeries | None
    grasps: GraspForces | None
    missing: tuple[str, ...]  # what the log cannot tell, and why

    @property
    def arms(self) -> list[RunArm]:
        """The arms that have rows of the motion, in the order of the run."""
        return [arm for arm in self.info.arms if arm.name in self.rows]

    def pose(self, arm: str) -> PoseSeries:
        """The object as that arm sees it."""
        return pose_by_arm(arm, self.seen[arm])


@np.errstate(over="ignore", invalid="ignore")  # poses of a run that went astray: what is no number counts as none
def prepare(log: AnyLog) -> Prepared:
    """Find the rows of the run, match the plant's with the arms'.  A poor log is prepared too: `missing` says why."""
    info = read_info(log)
    described = [arm.name for arm in info.arms]
    wrong = dict.fromkeys((*log.problems, *log.unjudged))
    missing = [*info.notes, *wrong, *_mended(log), *_parted(log), *_losses(log, described), *_strangers(log)]
    in_order = sorted(log.agents, key=lambda name: described.index(name) if name in described else len(described))
    tables = by_one_clock({name: Table.of(log.agents[name]) for name in in_order})
    whole = {name: tables[name] for name in described if len(tables.get(name, ()))}
    rows = {name: own for name, every in whole.items() if len(own := in_run(every, info))}
    missing += [_without_motion(log, name, whole) for name in described if name not in rows]
    stale = {name: is_stale(own) for name, own in rows.items()}
    count = sum(int(own.sum()) for own in stale.values())
    missing += [f"{count} cycles brought no fresh joint state and count in no error"] if count else []
    seen = {name: own[~stale[name]] for name, own in rows.items()}
    true = grasps = None
    if log.plant is None or not len(log.plant):
        missing.append("no simulation in the log: no true object pose, realised internal force or realised load share")
    else:
        plant = in_run(on_time_of(Table.of(log.plant), tables.values()), info)
        true, note = pose_by_plant(going_on(seen, info), plant, 1.0 / info.rate_hz)
        missing += [note] if note else []
        grasps = _grasp_forces(plant, info, rows, missing)
    return Prepared(log, info, whole, rows, seen, true, grasps, tuple(missing))


def _without_motion(log: AnyLog, name: str, whole: Mapping[str, Table]) -> str:
    """That an arm has no row of the motion, and what it says of why."""
    if name not in whole:
        return f"no row of the arm {name}"
    why = next((e.text for e in log.events if e.source == name and e.text.startswith(HOLDS)), "")
    return f"no row of the arm {name} is of the motion" + (f": {name} {why}" if why else "")


def _mended(log: AnyLog) -> list[str]:
    """What was wrong with a log before it was mended: what was left out then is not in it."""
    problems = log.metadata.get("recovery", {}).get("problems", "").splitlines()
    return [f"the log was mended, and before that: {problem}" for problem in problems]


def _parted(log: AnyLog) -> list[str]:
    """Whether the run goes on in another log, so that this one has not all of it, though nothing is lost."""
    told = log.metadata.get("completeness", {})
    parted = any(key.endswith(".end") and end == "continued" for key, end in told.items())
    return (
        ["the run goes on in the next log, which the recorder began by itself: here is a part of it"] if parted else []
    )


def _losses(log: AnyLog, arms: Sequence[str]) -> list[str]:
    """What the recorder says was lost, and where; that no row of one of these arms came is told of with the arm."""
    told = log.metadata.get("completeness", {})
    places = {"lost_in_ring": "in the ring", "lost_on_the_way": "on the way", "lost_on_disk": "on the disk"}
    counts = {(member, place): told.get(f"{member}.{key}", "0") for member in log.gaps for key, place in places.items()}
    lost = [f"{count} rows of {member} were lost {place}" for (member, place), count in counts.items() if count != "0"]
    if not told and not log.complete:
        lost.append(
            "nothing in the log says whether rows are missing (`completeness`), so it does not count as complete"
        )
    never = {member for member in log.gaps if _sent_nothing(told, member)}
    lost += [
        f"no row of {member} came" if member in never else f"{member} had not ended when the recorder did"
        for member in log.gaps
        if told.get(f"{member}.end") == "open" and not (member in never and member in arms)
    ]
    awaited = {member: told.get(f"{member}.awaited", "0") for member in log.gaps}
    return lost + [
        f"{count} rows of {member} had not come when the next log began, which has them if they came late"
        for member, count in awaited.items()
        if count != "0"
    ]


def _sent_nothing(told: Mapping[str, str], member: str) -> bool:
    """Whether not one row of it came, neither to this log nor to one before it."""
    return told.get(f"{member}.rows_expected") == told.get(f"{member}.rows_before") == "0"


def _strangers(log: AnyLog) -> list[str]:
    """What the recorder kept out because it was not of this cell, or of another publisher than the arm's own."""
    told = log.metadata.get("completeness", {})
    reasons = {key.removeprefix("rejected."): count for key, count in told.items() if key.startswith("rejected.")}
    harmless = {"another_run", "too_many_texts"}
    return [
        f"{count} messages that do not belong to this run were left out: {why.replace('_', ' ')}"
        for why, count in reasons.items()
        if why not in harmless
    ]


def _grasp_forces(plant: Table, info: RunInfo, rows: Mapping[str, Table], missing: list[str]) -> GraspForces:
    offsets, t = _grasp_offsets(info), column(plant, "t")
    asked = np.stack([_asked_force(rows.get(arm.name), t) for arm in info.arms], axis=1)
    if offsets is None:
        missing.append("moments of the realised internal wrench need the grasp offsets of every arm")
    shares = [arm.load_share for arm in info.arms]
    if not np.isfinite(shares).all():
        shares = [1.0 / len(shares)] * len(shares)
    normal = None if info.plane_normal is None else np.array(info.plane_normal)
    sizes = np.empty((3, len(plant), len(info.arms)))
    at = 0
    for block in plant.blocks(_BLOCK_ROWS):
        wrenches = grasp_wrenches(block, len(info.arms))
        internal = internal_wrenches(wrenches, column(block, "quat_object"), offsets)
        here = slice(at, at + len(block))
        force, moment = internal[:, :, :3], internal[:, :, 3:]
        unasked = force - asked[here] - meant_by_shares(wrenches, shares, normal)
        sizes[:, here] = [np.linalg.norm(part, axis=2) for part in (force, unasked, moment)]
        at += len(block)
    return GraspForces(t, plant, *sizes)


def _asked_force(rows: Table | None, t: Array) -> Array:
    """(k, 3) force of the internal wrench that an arm was to give at these times, N, world axes."""
    if rows is None or not len(rows):
        return np.zeros((len(t), 3))
    asked = np.nan_to_num(column(rows, "wrench_internal", slice(0, 3)))
    if not asked.any():
        return np.zeros((len(t), 3))
    when, wanted = (np.rint(1e9 * x).astype(np.int64) for x in (column(rows, "t"), t))
    at = nearest(when, wanted, _ASKED_WITHIN_NS)
    return np.where((at >= 0)[:, None], asked[at], 0.0)


def _grasp_offsets(info: RunInfo) -> Array | None:
    offsets = [arm.p_object_ee_m for arm in info.arms if arm.p_object_ee_m is not None]
    return np.array(offsets) if offsets and len(offsets) == len(info.arms) else None
