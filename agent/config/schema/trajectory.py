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
    """p_centre + p_amplitude sin, turned by angle sin about axis."""
    p_centre_m: Vec3
    """Middle of the motion, world axes."""
    p_amplitude_m: Vec3
    """Amplitude of each axis."""
    quat_centre: Quaternion = UPRIGHT
    """Attitude in the middle, w x y z."""
    axis: UnitVector
    """Axis of the turn, world axes."""
    angle_rad: Angle
    """Amplitude of the turn."""
    period_s: Duration
    """Period."""
    ramp_s: Instant = 0.0
    """The motion begins at rest and has its speed after so long; 0: at once."""


class RestToRestSpec(Strict):
    """`agent.control.trajectory_rest.RestToRest`: from one pose to another and, if asked, back again."""

    kind: Literal["rest_to_rest"]
    """From one pose to another and, if asked, back."""
    p_from_m: Vec3
    """First position, world axes."""
    quat_from: Quaternion = UPRIGHT
    """First attitude, w x y z."""
    p_to_m: Vec3
    """Second position."""
    quat_to: Quaternion = UPRIGHT
    """Second attitude."""
    move_s: Duration
    """Time of one way."""
    wait_s: Instant = 0.0
    """Before the motion, and before the way back."""
    and_back: bool = False
    """Whether it returns."""


class Waypoint(Strict):
    """A pose and the time at which the object passes it."""

    t_s: Instant
    """When the object passes."""
    p_m: Vec3
    """Where, world axes."""
    quat: Quaternion = UPRIGHT
    """At which attitude, w x y z."""


class WaypointsSpec(Strict):
    """`agent.control.trajectory_spline.PoseSpline` through way-points; at rest at both ends."""

    kind: Literal["waypoints"]
    """A smooth motion through way-points, at rest at both ends."""
    points: Annotated[list[Waypoint], Field(min_length=2)]
    """The way-points, two at least, times ascending."""


class PoseFileSpec(Strict):
    """`agent.control.trajectory_spline.PoseSpline` through the poses of a CSV file beside the cell file."""

    kind: Literal["file"]
    """A smooth motion through the poses of a CSV file."""
    path: Annotated[str, Field(min_length=1)]
    """The file, relative to the cell file."""
    speed_max_m_per_s: Speed = 0.5
    """A faster way from row to row is a jump."""
    speed_max_rad_per_s: Speed = 2.0
    """The same for the attitude."""


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
    """A band-limited excitation, to identify an arm from."""
    p_centre_m: Vec3
    """Middle of the motion, world axes."""
    quat_centre: Quaternion = UPRIGHT
    """Attitude in the middle, w x y z."""
    base_period_s: Duration
    """Period of harmonic 1."""
    fade_s: Duration
    """Time of fading in and out."""
    motion_s: Duration
    """Length of the motion."""
    x_m: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of x."""
    y_m: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of y."""
    z_m: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of z."""
    roll_rad: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of roll."""
    pitch_rad: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of pitch."""
    yaw_rad: Harmonics = Field(default_factory=list)
    """[harmonic, amplitude, phase] of yaw."""
    excursion_max_m: Length = 0.15
    """Bound of each axis, were all its terms to peak at once."""
    excursion_max_rad: Annotated[float, Field(gt=0.0, le=1.2)] = 1.0
    """The same for the angles."""
    frequency_max_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 2.0
    """Highest frequency that is meant."""

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
