"""What may stand under `[trajectory]` of a cell file, one model per kind."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from agent.config.schema.types import Finite, NonNegative, Positive, Quaternion, Strict, UnitVector, Vec3

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


Harmonic = tuple[Annotated[int, Field(ge=1)], Finite, Finite]  # number, amplitude, phase_rad
Harmonics = list[Harmonic]


class FourierSpec(Strict):
    """`agent.control.trajectory_fourier.Fourier`: a band-limited excitation, for a log to identify an arm from.

    Every axis has a list of [harmonic, amplitude, phase_rad] of the base period.  The bounds refuse a slip of the
    decimal point before anything is computed from it.
    """

    kind: Literal["fourier"]
    p_centre_m: Vec3
    quat_centre: Quaternion = UPRIGHT
    base_period_s: Positive
    fade_s: Positive
    motion_s: Positive
    x_m: Harmonics = Field(default_factory=list)
    y_m: Harmonics = Field(default_factory=list)
    z_m: Harmonics = Field(default_factory=list)
    roll_rad: Harmonics = Field(default_factory=list)
    pitch_rad: Harmonics = Field(default_factory=list)
    yaw_rad: Harmonics = Field(default_factory=list)
    excursion_max_m: Positive = 0.15  # of each axis, were all its terms to peak at once
    excursion_max_rad: Annotated[float, Field(gt=0.0, le=1.2)] = 1.0  # below the pitch of π/2 that angles cannot pass
    frequency_max_hz: Positive = 2.0

    def axes(self) -> tuple[Harmonics, Harmonics, Harmonics, Harmonics, Harmonics, Harmonics]:
        """x, y, z, roll, pitch, yaw."""
        return self.x_m, self.y_m, self.z_m, self.roll_rad, self.pitch_rad, self.yaw_rad

    @model_validator(mode="after")
    def _bounded(self) -> FourierSpec:
        if not any(self.axes()):
            raise ValueError("at least one term on one axis")
        if 2.0 * self.fade_s > self.motion_s:
            raise ValueError(f"motion_s ≥ 2 fade_s (they are {self.motion_s:g} and {self.fade_s:g})")
        bounds = [self.excursion_max_m] * 3 + [self.excursion_max_rad] * 3
        for name, terms, bound in zip(("x", "y", "z", "roll", "pitch", "yaw"), self.axes(), bounds, strict=True):
            excursion = math.fsum(abs(amplitude) for _, amplitude, _ in terms)
            if excursion > bound:
                raise ValueError(f"amplitudes of {name} that sum to at most {bound:g} (they sum to {excursion:g})")
            highest = max((number for number, _, _ in terms), default=0) / self.base_period_s
            if highest > self.frequency_max_hz:
                raise ValueError(f"frequencies up to frequency_max_hz (the highest of {name} is {highest:g} Hz)")
        return self


TrajectorySpec = Annotated[
    SinusoidSpec | RestToRestSpec | WaypointsSpec | PoseFileSpec | FourierSpec,
    Field(discriminator="kind"),
]
