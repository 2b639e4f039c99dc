"""What may stand under `[trajectory]` of a cell file, one model per kind."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from agent.config.schema.types import (
    AS_LIST,
    Angle,
    Coordinate,
    Duration,
    Instant,
    Length,
    Quaternion,
    Speed,
    Strict,
    UnitVector,
    Vec3,
    wrong,
)

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class SinusoidSpec(Strict):
    """`agent.control.trajectory.Sinusoid`."""

    kind: Literal["sinusoid"]
    p_centre_m: Vec3
    p_amplitude_m: Vec3
    quat_centre: Quaternion = UPRIGHT
    axis: UnitVector
    angle_rad: Angle
    period_s: Duration
    ramp_s: Instant = 0.0  # the motion begins at rest and has its speed after so long; 0: at once, as the paper's


class RestToRestSpec(Strict):
    """`agent.control.trajectory_rest.RestToRest`: from one pose to another and, if asked, back again."""

    kind: Literal["rest_to_rest"]
    p_from_m: Vec3
    quat_from: Quaternion = UPRIGHT
    p_to_m: Vec3
    quat_to: Quaternion = UPRIGHT
    move_s: Duration
    wait_s: Instant = 0.0  # before the motion, and before the way back
    and_back: bool = False


class Waypoint(Strict):
    """A pose and the time at which the object passes it."""

    t_s: Instant
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
    speed_max_m_per_s: Speed = 0.5  # a faster way from row to row is a jump
    speed_max_rad_per_s: Speed = 2.0


HarmonicNumber = Annotated[int, Field(ge=1, le=10**6)]
Harmonic = Annotated[tuple[HarmonicNumber, Coordinate, Angle], AS_LIST]  # number, amplitude (m or rad), phase_rad
Harmonics = list[Harmonic]
AXES = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")


class FourierSpec(Strict):
    """`agent.control.trajectory_fourier.Fourier`: a band-limited excitation, for a log to identify an arm from.

    Every axis has a list of [harmonic, amplitude, phase_rad] of the base period.  The bounds refuse a slip of the
    decimal point before anything is computed from it.
    """

    kind: Literal["fourier"]
    p_centre_m: Vec3
    quat_centre: Quaternion = UPRIGHT
    base_period_s: Duration
    fade_s: Duration
    motion_s: Duration
    x_m: Harmonics = Field(default_factory=list)
    y_m: Harmonics = Field(default_factory=list)
    z_m: Harmonics = Field(default_factory=list)
    roll_rad: Harmonics = Field(default_factory=list)
    pitch_rad: Harmonics = Field(default_factory=list)
    yaw_rad: Harmonics = Field(default_factory=list)
    excursion_max_m: Length = 0.15  # of each axis, were all its terms to peak at once
    excursion_max_rad: Annotated[float, Field(gt=0.0, le=1.2)] = 1.0  # below the pitch of π/2 that angles cannot pass
    frequency_max_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 2.0

    def axes(self) -> tuple[Harmonics, Harmonics, Harmonics, Harmonics, Harmonics, Harmonics]:
        """x, y, z, roll, pitch, yaw."""
        return self.x_m, self.y_m, self.z_m, self.roll_rad, self.pitch_rad, self.yaw_rad

    @model_validator(mode="after")
    def _bounded(self) -> FourierSpec:
        if not any(self.axes()):
            raise wrong(
                "",
                found="no term on any axis",
                expected="at least one term",
                remedy="add [[harmonic, amplitude, phase]]",
            )
        if 2.0 * self.fade_s > self.motion_s:
            raise wrong(
                "motion_s", found=f"{self.motion_s:g}", expected=f"motion_s ≥ 2 fade_s, {2.0 * self.fade_s:g} s",
                remedy="move for longer, or fade faster",
            )  # fmt: skip
        bounds = [self.excursion_max_m] * 3 + [self.excursion_max_rad] * 3
        for name, terms, bound in zip(AXES, self.axes(), bounds, strict=True):
            excursion = math.fsum(abs(amplitude) for _, amplitude, _ in terms)
            if excursion > bound:
                raise wrong(
                    name,
                    found=f"a sum of {excursion:g}",
                    expected=f"amplitudes that sum to at most {bound:g}",
                    remedy="make them smaller, or raise excursion_max_m or excursion_max_rad",
                )
            highest = max((number for number, _, _ in terms), default=0) / self.base_period_s
            if highest > self.frequency_max_hz:
                raise wrong(
                    name,
                    found=f"a highest frequency of {highest:g} Hz",
                    expected=f"frequencies up to frequency_max_hz, {self.frequency_max_hz:g}",
                    remedy="take lower harmonics or a longer base_period_s, or raise frequency_max_hz",
                )
        return self


TrajectorySpec = Annotated[
    SinusoidSpec | RestToRestSpec | WaypointsSpec | PoseFileSpec | FourierSpec,
    Field(discriminator="kind"),
]
