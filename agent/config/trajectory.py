"""From `[trajectory]` of a cell to the motion itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from agent.config.reading import ConfigError, read_file, shown
from agent.config.schema.cell import CellFile
from agent.config.schema.trajectory import FourierSpec, PoseFileSpec, RestToRestSpec, SinusoidSpec
from agent.control.trajectory import Sinusoid, Trajectory
from agent.control.trajectory_ease import Eased
from agent.control.trajectory_file import SpeedLimits, read
from agent.control.trajectory_fourier import Fourier, Term
from agent.control.trajectory_lift import Lifted
from agent.control.trajectory_rest import RestToRest
from agent.control.trajectory_spline import PoseSpline, TrajectoryError

SAMPLES_PER_SHORTEST_PERIOD: Final = 8
SAMPLES_PER_MOVE: Final = 8
SAMPLES_HIDDEN: Final = 25
QUICKEST: Final = 3  # parts of a spline, in translation and in rotation


def build(file: CellFile) -> Trajectory:
    """The desired motion of the object, from where it stands on.  Raises TrajectoryError."""
    motion, session = _carried(file), file.session
    return motion if session is None else Lifted(motion, file.p_place_m, file.object.quat_start, session.lift_s)


def _carried(file: CellFile) -> Trajectory:
    """The motion of `[trajectory]`."""
    t = file.trajectory
    if isinstance(t, SinusoidSpec):
        motion = Sinusoid(t.p_centre_m, t.p_amplitude_m, t.quat_centre, t.axis, t.angle_rad, t.period_s)
        return Eased(motion, t.ramp_s) if t.ramp_s else motion
    if isinstance(t, RestToRestSpec):
        return RestToRest(t.p_from_m, t.quat_from, t.p_to_m, t.quat_to, t.move_s, t.wait_s, t.and_back)
    if isinstance(t, PoseFileSpec):
        return _from_embedded(t, file.embedded)
    if isinstance(t, FourierSpec):
        x, y, z, roll, pitch, yaw = ([Term(*term) for term in axis] for axis in t.axes())
        return Fourier(
            t.p_centre_m, t.quat_centre, (x, y, z, roll, pitch, yaw), t.base_period_s, t.fade_s, t.motion_s
        )  # fmt: skip
    return PoseSpline([p.t_s for p in t.points], [p.p_m for p in t.points], [p.quat for p in t.points])


def waypoint_times(file: CellFile, end_s: float, at_most: int) -> tuple[list[float], int]:
    """Instants up to end_s that a check must not miss between its samples, and how many there are of them in all.

    Where there are more than at_most (≥ 2), it is so many of them, evenly.
    """
    t, motion = file.trajectory, _carried(file)
    later_s = 0.0 if file.session is None else file.session.lift_s
    if isinstance(motion, PoseSpline):
        times = [time + later_s for time in motion.times_s if time + later_s <= end_s]
        chosen = np.unique(np.linspace(0, len(times) - 1, min(len(times), at_most)).round().astype(int))
        return [times[k] for k in chosen], len(times)
    if isinstance(t, FourierSpec):
        highest = max(number for axis in t.axes() for number, _, _ in axis)
        end_s = min(end_s - later_s, t.motion_s)
        count = math.ceil(SAMPLES_PER_SHORTEST_PERIOD * highest * end_s / t.base_period_s) + 1
        return np.linspace(later_s, later_s + end_s, min(count, at_most)).tolist(), count
    return [], 0


def sample_times(file: CellFile, motion: Trajectory, steps: int) -> list[float]:
    """Instants, s, ascending, at which to look at the motion of this file as far as a run goes.

    They are even steps, and samples of what these would miss or hardly see.
    """
    end_s = min(motion.period_s, file.duration_s)
    parts = [
        np.linspace(begin_s, begin_s + length_s, SAMPLES_HIDDEN).tolist()
        for begin_s, length_s in _hidden(motion, end_s, end_s / steps)
    ]
    hidden = [time for part in parts for time in part if time <= file.duration_s]
    return sorted({*np.linspace(0.0, end_s, steps + 1).tolist(), *hidden})


def _hidden(motion: Trajectory, end_s: float, step_s: float) -> list[tuple[float, float]]:
    """Begin and length, s, of the parts of a motion up to end_s that steps of step_s hide."""
    shortest_s = SAMPLES_PER_MOVE * step_s
    if isinstance(motion, Lifted):
        lift_s = motion.lift_s
        carried = _hidden(motion.inner, end_s - lift_s, step_s)
        lift = [(0.0, lift_s)] if lift_s < shortest_s else []
        return lift + [(lift_s + begin_s, length_s) for begin_s, length_s in carried]
    if isinstance(motion, RestToRest) and motion.move_s < shortest_s:
        begins = [motion.wait_s, 2.0 * motion.wait_s + motion.move_s][: 1 + motion.and_back]
        return [(begin_s, motion.move_s) for begin_s in begins]
    if isinstance(motion, Eased) and motion.ramp_s > motion.inner.period_s:  # its full speed comes late
        return [(motion.ramp_s, motion.inner.period_s)]
    if isinstance(motion, PoseSpline):
        return motion.quickest(QUICKEST, end_s, step_s)
    return []


def text_of_file(name: str, cell_path: Path) -> str:
    """Text of the file of poses that a cell names.  Raises TrajectoryError."""
    try:
        return read_file(cell_path.parent / name).decode()
    except (ConfigError, UnicodeDecodeError) as error:
        raise TrajectoryError(
            f"trajectory file {shown(name)}",
            found=error.found if isinstance(error, ConfigError) else "not UTF-8 text",
            expected="a readable CSV file",
            remedy="give the path relative to the cell file",
        ) from error


def _from_embedded(spec: PoseFileSpec, embedded: dict[str, str]) -> PoseSpline:
    if spec.path not in embedded:
        raise TrajectoryError(
            f"trajectory file {shown(spec.path)}",
            found="not in the cell's bytes",
            expected="its text under [embedded]",
            remedy="load the cell from its file, beside which the CSV file stands",
        )
    return read(embedded[spec.path], shown(spec.path), SpeedLimits(spec.speed_max_m_per_s, spec.speed_max_rad_per_s))
