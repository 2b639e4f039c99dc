"""Poses of logs in which every arm holds the object, slowly moved: joint angles of all arms at one time, thinned out.

Each is the mean over a short time, in which the encoders' grid and their noise average out and the arms move so little
that it does no harm.  An arm's rows may lie in several logs, as where each host has its own.  Every fourth block of
poses is held out from the fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.calibrate.chain import CalibrateError, Matrix
from agent.config.cell import Cell
from agent.log.columns import Table
from agent.modes import Mode
from agent.safety import Flag
from drivers.interface import Vector

WINDOW_S: Final = 0.1  # of readings in one pose
TURN_MAX_RAD: Final = 0.05  # of a joint within it
APART_RAD: Final = 0.01  # of some joint between two poses
MOST: Final = 400
LEAST: Final = 24
READINGS_LEAST: Final = 3  # of every arm in a window
BLOCKS: Final = 16  # of poses; of four, one is held out
HOLDING: Final = (Mode.READY, Mode.TRACK, Mode.HOLD, Mode.FLOAT, Mode.STAND)


@dataclass(frozen=True, eq=False)
class Poses:
    """Joint angles of all arms at k times."""

    t: Vector  # (k,) s since the first
    q: tuple[Matrix, ...]  # (k, n) of each arm, as reported
    held_out: NDArray[np.bool_]  # (k,)

    def some(self, chosen: NDArray[np.bool_]) -> list[Matrix]:
        """Joint angles of the chosen poses (k,)."""
        return [q[chosen] for q in self.q]


def poses_of(logs: Sequence[Mapping[str, Table]], cell: Cell) -> Poses:
    """Poses of the rows of some logs, by arm.  Raises CalibrateError where arms are missing, or there are too few."""
    absent = [arm.name for arm in cell.arms if not any(len(agents.get(arm.name, ())) for agents in logs)]
    if absent:
        raise CalibrateError(
            f"arms of cell {cell.file.name}", found=f"no rows of {', '.join(absent)}", expected="rows of every arm",
            remedy="record all arms while they hold the object; arms of two hosts may lie in two logs, given together",
        )  # fmt: skip
    readings = [_readings([agents[arm.name] for agents in logs if arm.name in agents], arm.n) for arm in cell.arms]
    if not all(len(utc) for utc, _ in readings):
        raise _too_few(0)
    origin = max(int(utc[0]) for utc, _ in readings)
    windows = [_windows(utc - origin, q) for utc, q in readings]
    common = _in_all([number for number, _ in windows])
    q = [mean[np.searchsorted(number, common)] for number, mean in windows]
    chosen = _apart(np.concatenate(q, axis=1))
    if len(chosen) < LEAST:
        raise _too_few(len(chosen))
    return Poses(
        WINDOW_S * common[chosen].astype(np.float64), tuple(angles[chosen] for angles in q), held_out(len(chosen))
    )


def held_out(count: int) -> NDArray[np.bool_]:
    """Which of so many poses, in their order, are held out."""
    block: NDArray[np.bool_] = (np.arange(count) * BLOCKS // max(count, 1)) % 4 == 2
    return block


def _readings(tables: Sequence[Table], n: int) -> tuple[NDArray[np.int64], Matrix]:
    """Times and joint angles of the fresh rows in which an arm holds the object, in their order in time."""
    times, angles = [], []
    for rows in tables:
        holds = np.isin(rows["mode"], [int(mode) for mode in HOLDING])
        fresh = rows["flags"] & np.uint32(Flag.STALE.value) == 0
        chosen = rows[holds & fresh]
        times.append(np.asarray(chosen["utc_ns"], dtype=np.int64))
        angles.append(np.asarray(chosen.column("q_measured", slice(0, n))))
    utc, q = np.concatenate(times), np.concatenate(angles)
    order = np.argsort(utc, kind="stable")
    return utc[order], q[order]


def _windows(since_ns: NDArray[np.int64], q: Matrix) -> tuple[NDArray[np.int64], Matrix]:
    """Numbers (w,) of the windows that are ones to use, rising, and the mean angles (w, n) of each."""
    numbers, place = np.unique(since_ns // round(1e9 * WINDOW_S), return_inverse=True)
    readings = np.bincount(place)
    means = np.stack([np.bincount(place, column) / readings for column in q.T], axis=1)
    lowest, highest = np.full(means.shape, np.inf), np.full(means.shape, -np.inf)
    np.minimum.at(lowest, place, q)
    np.maximum.at(highest, place, q)
    good = (readings >= READINGS_LEAST) & ((highest - lowest).max(axis=1) <= TURN_MAX_RAD)
    return numbers[good], means[good]


def _in_all(numbers: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Windows that every arm has."""
    common = numbers[0]
    for others in numbers[1:]:
        common = np.intersect1d(common, others)
    return common


def _apart(q: Matrix) -> NDArray[np.intp]:
    """Windows (w, n) of which each differs from the one before, at most MOST of them."""
    chosen: list[int] = []
    for i in range(len(q)):
        if not chosen or np.abs(q[i] - q[chosen[-1]]).max() >= APART_RAD:
            chosen.append(i)
    every = max(1, -(-len(chosen) // MOST))
    return np.array(chosen[::every], dtype=np.intp)


def _too_few(count: int) -> CalibrateError:
    return CalibrateError(
        "poses in the log", found=f"{count}, in which all arms hold the object and some joint has moved",
        expected=f"at least {LEAST}, {APART_RAD:g} rad apart", remedy="move the object slowly and farther, for longer",
    )  # fmt: skip
