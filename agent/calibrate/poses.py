"""Poses of a log in which every arm holds the object, slowly moved: joint angles of all arms at one time, thinned out.

Each is the mean over a short time, in which the encoders' grid and their noise average out and the arms move so little
that it does no harm.  Every fourth block of poses is held out from the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
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


def poses_of(agents: Mapping[str, Table], cell: Cell) -> Poses:
    """Poses of a log's rows, by arm.  Raises CalibrateError where arms are missing, or there are too few poses."""
    absent = [arm.name for arm in cell.arms if arm.name not in agents]
    if absent:
        raise CalibrateError(
            f"arms of cell {cell.file.name}", found=f"no rows of {', '.join(absent)}", expected="rows of every arm",
            remedy="record all arms while they hold the object",
        )  # fmt: skip
    readings = [_readings(agents[arm.name], arm.n) for arm in cell.arms]
    if not all(len(utc) for utc, _ in readings):
        raise _too_few(0)
    origin = max(int(utc[0]) for utc, _ in readings)
    windows = [_windows(utc - origin, q) for utc, q in readings]
    count = min(len(mean) for mean, _ in windows)
    good = np.all([fine[:count] for _, fine in windows], axis=0)
    q = [mean[:count] for mean, _ in windows]
    chosen = _apart(np.concatenate(q, axis=1), np.flatnonzero(good))
    if len(chosen) < LEAST:
        raise _too_few(len(chosen))
    return Poses(WINDOW_S * chosen.astype(np.float64), tuple(angles[chosen] for angles in q), held_out(len(chosen)))


def held_out(count: int) -> NDArray[np.bool_]:
    """Which of so many poses, in their order, are held out."""
    block: NDArray[np.bool_] = (np.arange(count) * BLOCKS // max(count, 1)) % 4 == 2
    return block


def _readings(rows: Table, n: int) -> tuple[NDArray[np.int64], Matrix]:
    """Times and joint angles of the fresh rows in which an arm holds the object."""
    holds = np.isin(rows["mode"], [int(mode) for mode in HOLDING])
    fresh = rows["flags"] & np.uint32(Flag.STALE.value) == 0
    chosen = rows[holds & fresh]
    return np.asarray(chosen["utc_ns"]), np.asarray(chosen.column("q_measured", slice(0, n)))


def _windows(since_ns: NDArray[np.int64], q: Matrix) -> tuple[Matrix, NDArray[np.bool_]]:
    """Mean angles (w, n) of each window from zero on, and whether it is one to use."""
    after = since_ns >= 0
    number, q = since_ns[after] // round(1e9 * WINDOW_S), q[after]
    if not len(number):
        return np.zeros((0, q.shape[1])), np.zeros(0, dtype=bool)
    windows = int(number[-1]) + 1
    readings = np.bincount(number, minlength=windows)
    means = [np.bincount(number, column, windows) / np.maximum(readings, 1) for column in q.T]
    lowest, highest = np.full((windows, q.shape[1]), np.inf), np.full((windows, q.shape[1]), -np.inf)
    np.minimum.at(lowest, number, q)
    np.maximum.at(highest, number, q)
    return np.stack(means, axis=1), (readings >= READINGS_LEAST) & ((highest - lowest).max(axis=1) <= TURN_MAX_RAD)


def _apart(q: Matrix, good: NDArray[np.intp]) -> NDArray[np.intp]:
    """Good windows of which each differs from the one before, at most MOST of them."""
    chosen: list[int] = []
    for i in good.tolist():
        if not chosen or np.abs(q[i] - q[chosen[-1]]).max() >= APART_RAD:
            chosen.append(i)
    every = max(1, -(-len(chosen) // MOST))
    return np.array(chosen[::every], dtype=np.intp)


def _too_few(count: int) -> CalibrateError:
    return CalibrateError(
        "poses in the log", found=f"{count}, in which all arms hold the object and some joint has moved",
        expected=f"at least {LEAST}, {APART_RAD:g} rad apart", remedy="move the object slowly and farther, for longer",
    )  # fmt: skip
