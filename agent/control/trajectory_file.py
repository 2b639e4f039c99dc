"""Timed poses from the text of a CSV file, refused line by line when they cannot be a motion; opens no file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from agent.control.quaternion import Quat, Vec3, angle_between
from agent.control.trajectory_spline import PoseSpline, TrajectoryError

COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
BYTE_ORDER_MARK = "\ufeff"
LATEST_S, FARTHEST_M = 1e6, 100.0
UNIT_TOLERANCE = 1e-3  # files round; the quaternion is normalised within this
_SAMPLES_PER_ROW = 4  # of the spline between the rows
_STRAY_M = 1e-3  # what the spline may leave the rows by when nothing moves


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """What is still a motion; faster is a jump."""

    m_per_s: float
    rad_per_s: float


def read(text: str, source: str, limits: SpeedLimits) -> PoseSpline:
    """The motion through the poses of `text`; `source` names it in refusals.

    First line: the column names t_s,x_m,y_m,z_m,qw,qx,qy,qz.  Empty lines and lines that begin with # are
    skipped.  The motion begins and ends at rest.  Raises TrajectoryError naming the line.
    """
    if text.startswith(BYTE_ORDER_MARK):
        raise TrajectoryError(
            source, found="a byte order mark before the first line", expected="CSV in UTF-8",
            remedy="save it as UTF-8 without BOM",
        )  # fmt: skip
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), start=1)]
    lines = [(i, line) for i, line in lines if line and not line.startswith("#")]
    header = tuple(c.strip() for c in lines[0][1].split(",")) if lines else ()
    if header != COLUMNS:
        raise TrajectoryError(
            f"columns of {source}",
            found=",".join(header) or "nothing",
            expected=",".join(COLUMNS),
            remedy="make the first line exactly that",
        )
    rows = [_row(f"line {i} of {source}", line) for i, line in lines[1:]]
    if len(rows) < 2:
        raise TrajectoryError(
            f"rows of {source}", found=len(rows), expected="at least 2 poses", remedy="give a first and a last pose"
        )
    for (i, _), before, after in zip(lines[2:], rows, rows[1:], strict=False):
        _refuse_jump(f"line {i} of {source}", before, after, limits)
    spline = PoseSpline([r[0] for r in rows], [r[1] for r in rows], [r[2] for r in rows])
    _refuse_swinging_spline(source, spline, rows, limits)
    return spline


_Row = tuple[float, Vec3, Quat]


def _row(where: str, line: str) -> _Row:
    cells = line.split(",")
    if len(cells) != len(COLUMNS):
        raise TrajectoryError(
            where, found=f"{len(cells)} values", expected=f"{len(COLUMNS)}", remedy=f"give {','.join(COLUMNS)}"
        )
    try:
        t, x, y, z, *quat = (float(c) for c in cells)
        if "_" in line:  # 0_5 is a number to Python, and 5
            raise ValueError(line)
    except ValueError as error:
        raise TrajectoryError(where, found=str(error), expected="numbers", remedy="correct that line") from error
    if not 0.0 <= t <= LATEST_S or not all(abs(c) <= FARTHEST_M for c in (x, y, z)):  # NaN is refused as well
        raise TrajectoryError(
            where,
            found=line,
            expected=f"finite numbers, t_s ≥ 0 and at most {LATEST_S:g}, positions within {FARTHEST_M:g} m",
            remedy="correct or remove that line",
        )
    norm = math.hypot(*quat)
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        raise TrajectoryError(
            f"quaternion in {where}",
            found=f"norm {norm:.6g}",
            expected=f"1 to {UNIT_TOLERANCE:g}, scalar first",
            remedy="normalise it, and check the order qw,qx,qy,qz",
        )
    w, i, j, k = (c / norm for c in quat)
    return t, (x, y, z), (w, i, j, k)


def _refuse_jump(where: str, before: _Row, after: _Row, limits: SpeedLimits) -> None:
    dt = after[0] - before[0]
    if not dt > 0.0:
        raise TrajectoryError(
            f"time in {where}",
            found=f"{after[0]:g} s after {before[0]:g} s",
            expected="times that increase",
            remedy="put the rows in order, one per instant",
        )
    way, turn = math.dist(before[1], after[1]), angle_between(before[2], after[2])
    if way > limits.m_per_s * dt or turn > limits.rad_per_s * dt:
        raise TrajectoryError(
            f"jump in {where}",
            found=f"{way * 1e3:.3g} mm and {turn * 1e3:.3g} mrad within {dt:.3g} s",
            expected=f"at most {limits.m_per_s:g} m/s and {limits.rad_per_s:g} rad/s",
            remedy="smooth the file, or raise speed_max_m_per_s or speed_max_rad_per_s",
        )


def _refuse_swinging_spline(source: str, spline: PoseSpline, rows: list[_Row], limits: SpeedLimits) -> None:
    """Rows that do not begin and end at rest, or are rough, make the spline swing out between them."""
    longest = max(math.dist(a[1], b[1]) for a, b in pairwise(rows)) + _STRAY_M
    for before, after in pairwise(rows):
        for k in range(_SAMPLES_PER_ROW):
            t = before[0] + (after[0] - before[0]) * k / _SAMPLES_PER_ROW
            d = spline.at(t)
            linear, angular, away = math.hypot(*d.v[:3]), math.hypot(*d.v[3:]), math.dist(d.p, before[1])
            if linear > 2.0 * limits.m_per_s or angular > 2.0 * limits.rad_per_s or away > longest:
                raise TrajectoryError(
                    f"motion between the rows of {source} at {t:.4g} s",
                    found=f"{away * 1e3:.3g} mm from the row before, at {linear:.3g} m/s and {angular:.3g} rad/s",
                    expected=f"≤ {longest * 1e3:.3g} mm, twice {limits.m_per_s:g} m/s and {limits.rad_per_s:g} rad/s",
                    remedy="let the file begin and end at rest, space its times evenly, and smooth it",
                )
