"""From `[trajectory]` of a cell to the motion itself; a file of poses that it names is read while loading."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import tomli_w

from agent.config.schema.cell import CellFile
from agent.config.schema.trajectory import FourierSpec, PoseFileSpec, RestToRestSpec, SinusoidSpec, WaypointsSpec
from agent.control.trajectory import Sinusoid, Trajectory
from agent.control.trajectory_file import SpeedLimits, read
from agent.control.trajectory_fourier import Fourier, Term
from agent.control.trajectory_rest import RestToRest
from agent.control.trajectory_spline import PoseSpline, TrajectoryError

SAMPLES_PER_SHORTEST_PERIOD: Final = 8


def build(file: CellFile) -> Trajectory:
    """The desired motion of the object.  Raises TrajectoryError."""
    t = file.trajectory
    if isinstance(t, SinusoidSpec):
        return Sinusoid(t.p_centre_m, t.p_amplitude_m, t.quat_centre, t.axis, t.angle_rad, t.period_s)
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


def waypoint_times(file: CellFile) -> list[float]:
    """Instants that a check must not miss between its samples."""
    t = file.trajectory
    if isinstance(t, WaypointsSpec):
        return [p.t_s for p in t.points]
    if isinstance(t, FourierSpec):
        highest = max(number for axis in t.axes() for number, _, _ in axis)
        count = math.ceil(SAMPLES_PER_SHORTEST_PERIOD * highest * t.motion_s / t.base_period_s)
        return [t.motion_s * i / count for i in range(count + 1)]
    return []


def embed(raw: bytes, document: dict[str, Any], cell_path: Path) -> bytes:
    """The cell's bytes with the trajectory file it names appended as a table `embedded`.

    From then on the cell stands alone: every host, every log and every replay has the same motion under the same
    fingerprint.  A cell that names no file, or already carries it, is returned as it is.  Raises TrajectoryError.
    """
    trajectory = document.get("trajectory")
    if not isinstance(trajectory, dict) or trajectory.get("kind") != "file":
        return raw
    name = trajectory.get("path")
    if not isinstance(name, str) or name in document.get("embedded", {}):
        return raw
    try:
        text = (cell_path.parent / name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryError(
            f"trajectory file {name}",
            found=error.strerror if isinstance(error, OSError) else "not UTF-8 text",
            expected="a readable CSV file",
            remedy="give the path relative to the cell file",
        ) from error
    table = tomli_w.dumps({"embedded": {name: text}}, multiline_strings=True)
    return raw.rstrip(b"\n") + b"\n\n" + table.encode()


def _from_embedded(spec: PoseFileSpec, embedded: dict[str, str]) -> PoseSpline:
    if spec.path not in embedded:
        raise TrajectoryError(
            f"trajectory file {spec.path}",
            found="not in the cell's bytes",
            expected="its text under [embedded]",
            remedy="load the cell from its file, beside which the CSV file stands",
        )
    return read(embedded[spec.path], spec.path, SpeedLimits(spec.speed_max_m_per_s, spec.speed_max_rad_per_s))
