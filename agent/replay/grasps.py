"""What each arm sees and carries: whose picture of the object is off, and how much of a grip's friction is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.log.columns import Table
from agent.log.read import ColumnLog
from agent.log.when import on_time_of
from agent.modes import Mode
from agent.replay.source import ReplayError
from agent.report.series import attitude_error, grasp_force, nearest, rotation_vector
from agent.safety import Flag

NO_TIME_S = 1e9  # thirty years
NO_POSE = 1e6  # m, and of a quaternion: of a damaged row

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grasp:
    """One arm over the rows in which all of them follow the trajectory and see the object somewhere."""

    arm: str
    rows: int
    offset_m: float  # size of the mean of where it sees the object, from where the object is
    offset_rad: float
    force_max_N: float  # on its grasp
    grip_force_max_N: float | None  # of the cell file

    @property
    def margin_N(self) -> float | None:
        """What the grip could carry beside it; None without a figure of the grip."""
        return None if self.grip_force_max_N is None else self.grip_force_max_N - self.force_max_N


@dataclass(frozen=True, slots=True)
class Grasps:
    """All arms, and what they are compared with."""

    arms: tuple[Grasp, ...]
    truth: bool  # of a simulation; otherwise the mean of what the arms see, and forces as commanded


def grasps(log: ColumnLog, cell: Cell) -> Grasps:
    """Raises ReplayError without a tick in which every arm follows."""
    seen = {name: _tracking(rows) for name, rows in log.agents.items()}
    plant = on_time_of(log.plant, log.agents.values()) if log.plant is not None and len(log.plant) else None
    others = list(seen.values()) if plant is None else [plant]
    at = dict(zip(seen, _same_instants(list(seen.values()), others[0], 1.0 / cell.file.rate_hz), strict=True))
    common: NDArray[np.bool_] = np.all([i >= 0 for i in at.values()], axis=0)
    if not common.any():
        raise ReplayError(
            f"grasps of {log.path}", found="no tick in which every arm follows the trajectory", expected="some",
            remedy="take a run that got as far as TRACK",
        )  # fmt: skip
    every = [_pose(rows, at[name][common]) for name, rows in seen.items()]
    if plant is not None:
        every.append(_pose(plant, np.flatnonzero(common)))
    known: NDArray[np.bool_] = np.all([_known(pose) for pose in every], axis=0)
    if not known.any():
        raise ReplayError(
            f"grasps of {log.path}", found="no tick in which every arm follows with a pose that is a number",
            expected="some", remedy="take another log: this one is damaged",
        )  # fmt: skip
    every = [(p[known], quat[known]) for p, quat in every]
    poses = dict(zip(seen, every[: len(seen)], strict=True))
    p, quat = _mean(poses) if plant is None else every[-1]
    found = []
    for name, (p_arm, quat_arm) in poses.items():
        turned = rotation_vector(attitude_error(quat, quat_arm))
        arm = cell.arm(name)
        found.append(
            Grasp(
                name, int(known.sum()), float(np.linalg.norm((p_arm - p).mean(axis=0))),
                float(np.linalg.norm(turned.mean(axis=0))),
                _force(seen[name], plant, cell.index(name)), arm.entry.grip_force_max_N,
            )
        )  # fmt: skip
    return Grasps(tuple(found), plant is not None)


def _tracking(rows: Table) -> Table:
    fresh = rows["flags"] & np.uint32(Flag.STALE.value) == 0
    chosen: NDArray[np.bool_] = (rows["mode"] == Mode.TRACK) & fresh
    return rows[chosen]


def _same_instants(arms: Sequence[Table], base: Table, period_s: float) -> list[NDArray[np.intp]]:
    """For each arm and row of base the arm's row of that instant, −1 where there is none.

    By the trajectory's time, which hosts whose clocks differ have in common, as the report does; by UTC where one log
    has several motions, whose times come again.
    """
    half_ns = round(0.5e9 * period_s)
    times = [_nanoseconds(rows["t"]) for rows in (base, *arms)]
    if any(np.any(np.diff(t) < 0) for t in times):
        times = [rows["utc_ns"] for rows in (base, *arms)]
    return [nearest(own, times[0], half_ns) for own in times[1:]]


def _nanoseconds(t: Array) -> NDArray[np.int64]:
    """Of a time that is none, or longer than a run can be, as in a damaged row: one long before all others."""
    known = np.where(np.abs(t) < NO_TIME_S, t, -NO_TIME_S)
    return np.rint(known * 1e9).astype(np.int64)


def _pose(rows: Table, at: NDArray[np.intp]) -> tuple[Array, Array]:
    return np.asarray(rows["p_object"][at]), np.asarray(rows["quat_object"][at])


def _known(pose: tuple[Array, Array]) -> NDArray[np.bool_]:
    """(T,) of which there is a pose: NaN is none, nor is a quaternion of zeros, whose largest should be 0.5 or more."""
    p, quat = (np.abs(part).max(axis=1) for part in pose)
    known: NDArray[np.bool_] = (p < NO_POSE) & (quat > 0.1) & (quat < NO_POSE)
    return known


def _mean(poses: Mapping[str, tuple[Array, Array]]) -> tuple[Array, Array]:
    """The mean of near poses; its quaternions are not of length 1."""
    p = np.mean([p for p, _ in poses.values()], axis=0)
    first = next(iter(poses.values()))[1]
    aligned = [quat * np.sign(np.sum(quat * first, axis=1, keepdims=True)) for _, quat in poses.values()]
    return p, np.mean(aligned, axis=0)


def _force(rows: Table, plant: Table | None, number: int) -> float:
    """The largest force on the grasp: the true one, or the one commanded."""
    force = rows.column("wrench_cmd", slice(0, 3)) if plant is None else grasp_force(plant, number)
    with np.errstate(over="ignore"):  # of a damaged row, which counts as none
        size = np.linalg.norm(force, axis=1)
    return float(np.max(size, initial=0.0, where=np.isfinite(size)))
