"""How far the object was from where it should be, and the arms' beliefs from each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Final

import numpy as np

from agent.log.columns import Table
from agent.log.runinfo import RunInfo
from agent.report.arithmetic import NAN, instant_of_most, most, rms
from agent.report.decay import AttitudeDecay, PositionDecay
from agent.report.loss import opened_s
from agent.report.prepared import Prepared
from agent.report.results import PoseErrors
from agent.report.series import Array, PoseSeries, column, same_ticks

GAP_S: Final = 0.1  # without a pose: what happened meanwhile cannot be judged


def pose_errors(series: PoseSeries, info: RunInfo) -> PoseErrors:
    """Errors of one series of poses; NaN throughout when no usable row is left after the transient."""
    position, attitude = series.position_error, series.attitude_error
    usable = np.isfinite(position) & np.isfinite(attitude)
    window = (series.t >= info.transient_s) & (series.t <= info.duration_s)
    followed = usable & series.tracking
    settled = followed & window
    t = series.t[settled]
    gap_s, t_gap_s = _longest_gap(series.t[usable & window], info)
    unusable, not_tracking = int((~usable).sum()), int((window & ~series.tracking).sum())
    in_plane = out_of_plane = NAN
    if info.plane is not None:
        in_plane = most(np.linalg.norm(series.e_p[settled][:, list(info.plane.in_plane)], axis=1))
        out_of_plane = most(np.abs(series.e_p[settled][:, info.plane.normal]))
    return PoseErrors(
        source=series.source,
        rows=int(settled.sum()),
        unusable_rows=unusable,
        not_tracking_rows=not_tracking,
        longest_gap_s=gap_s,
        t_gap_s=t_gap_s,
        whole=not unusable and not not_tracking and gap_s <= GAP_S,
        max_position_error_m=most(position[settled]),
        max_attitude_error_rad=most(attitude[settled]),
        rms_position_error_m=rms(position[settled]),
        rms_attitude_error_rad=rms(attitude[settled]),
        t_max_position_s=instant_of_most(t, position[settled]),
        t_max_attitude_s=instant_of_most(t, attitude[settled]),
        max_in_plane_error_m=in_plane,
        max_out_of_plane_error_m=out_of_plane,
        position=PositionDecay.of(series.t[followed], position[followed]),
        attitude=AttitudeDecay.of(series.t[followed], attitude[followed]),
    )


def complaints(errors: PoseErrors, info: RunInfo) -> list[str]:
    """What a person must know of them."""
    found = []
    if errors.rows == 0:
        found.append(f"no usable row of {errors.source} after the transient of {info.transient_s:g} s")
    if errors.unusable_rows:
        found.append(f"{errors.unusable_rows} rows of {errors.source} hold a pose that is not a number")
    if errors.not_tracking_rows:
        ticks = f"{errors.not_tracking_rows} ticks of {errors.source} after the transient"
        found.append(f"{ticks} did not follow the trajectory and count in no error")
    if errors.longest_gap_s > GAP_S:
        found.append(f"no pose of {errors.source} for {errors.longest_gap_s:.3g} s from {errors.t_gap_s:.2f} s on")
    return found


def _longest_gap(t: Array, info: RunInfo) -> tuple[float, float]:
    """Longest time without one of the instants t (k,) between the end of the transient and that of the run.

    Instants stand for as long as there is mostly between two; one alone that is missing is no gap.  With when it
    begins, s, NaN where there is none; both NaN without an instant.
    """
    if not len(t):
        return NAN, NAN
    lasts_s = float(np.median(np.diff(t))) if len(t) > 1 else 1.0 / info.rate_hz
    begins = np.concatenate([[info.transient_s], t + lasts_s])
    gaps = np.concatenate([t, [info.duration_s]]) - begins
    longest = int(gaps.argmax())
    return (float(gaps[longest]), float(begins[longest])) if gaps[longest] > 1.5 * lasts_s else (0.0, NAN)


def disagreement(run: Prepared) -> float:
    """How far two arms at most believed the object to be apart, after the transient, m."""
    worst = NAN
    for _, _, t, apart_m in apart_by_pair(run):
        worst = float(np.fmax(worst, most(apart_m[t >= run.info.transient_s])))
    return worst


def left_apart(run: Prepared) -> float:
    """How far two arms are at most apart at the end in what they pull to, m: what their shifts leave of that distance.

    NaN where no arm has shifted what it follows.  An arm whose grasp has opened counts no more.
    """
    held = _while_grasped(run)
    shifts = {name: column(rows, "shift", slice(0, 3)) for name, rows in held.items()}
    if not any(shift.any() for shift in shifts.values()):
        return NAN
    worst = NAN
    for one, other in combinations(held, 2):
        a, b = held[one], held[other]
        here, there = same_ticks(a, b, 1.0 / run.info.rate_hz)
        if len(here):
            seen = column(a, "p_object")[here[-1]] - column(b, "p_object")[there[-1]]
            worst = float(np.fmax(worst, np.linalg.norm(seen - shifts[one][here[-1]] + shifts[other][there[-1]])))
    return worst


def apart_by_pair(run: Prepared) -> Iterator[tuple[str, str, Array, Array]]:
    """Names, times (k,) and distances (k,) m of every pair of arms, on the ticks that both have and hold the object."""
    held = _while_grasped(run)
    for one, other in combinations(held, 2):
        a, b = held[one], held[other]
        here, there = same_ticks(a, b, 1.0 / run.info.rate_hz)
        apart = column(a, "p_object")[here] - column(b, "p_object")[there]
        yield one, other, column(a, "t")[here], np.asarray(np.linalg.norm(apart, axis=1))


def _while_grasped(run: Prepared) -> dict[str, Table]:
    """Rows of each arm that have a fresh state, before its grasp opened: an empty gripper sees no object."""
    opened, half_s = opened_s(run), 0.5 / run.info.rate_hz
    return {
        name: rows[column(rows, "t") < opened[name] - half_s] if name in opened else rows
        for name, rows in run.seen.items()
    }
