"""What may stand under `[trajectory]` of a cell file, one model per kind; validates, and reads no file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from agent.config.schema_types import Finite, NonNegative, Positive, Quaternion, Strict, UnitVector, Vec3

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class SinusoidSpec(Strict):
    """`agent.control.trajectory.Sinusoid`."""

    kind: Literal["sinusoid"]
    p_centre_m: Vec3
    p_amplitude_m: Vec3
    quat_centre: Quaternion = UPRIGHT
    axis: UnitVector
    angle_rad: Finite
    period_s: Positive


class RestToRestSpec(Strict):
    """`agent.control.trajectory_rest.RestToRest`: from one pose to another and, if asked, back again."""

    kind: Literal["rest_to_rest"]
    p_from_m: Vec3
    quat_from: Quaternion = UPRIGHT
    p_to_m: Vec3
    quat_to: Quaternion = UPRIGHT
    move_s: Positive
    wait_s: NonNegative = 0.0  # before the motion, and before the way back
    and_back: bool = False


class Waypoint(Strict):
    """A pose and the time at which the object passes it."""

    t_s: NonNegative
    p_m: Vec3
    quat: Quaternion = UPRIGHT


class WaypointsSpec(Strict):
    """`agent.control.trajectory_spline.PoseSpline` through way-points; at rest at both ends."""

    kind: Literal["waypoints"]
    points: Annotated[list[Waypoint], Field(min_length=2)]


class PoseFileSpec(Strict):
    """`agent.control.trajectory_spline.PoseSpline` through the poses of a CSV file beside the cell file."""

    kind: Literal["file"]
    path: Annotated[str, Field(min_length=1)]
    speed_max_m_per_s: Positive = 0.5  # a faster way from row to row is a jump
    speed_max_rad_per_s: Positive = 2.0


TrajectorySpec = Annotated[
    SinusoidSpec | RestToRestSpec | WaypointsSpec | PoseFileSpec,
    Field(discriminator="kind"),
]
