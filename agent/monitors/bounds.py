"""The monitors of an arm by name, and the bounds that they keep; data alone."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Name(enum.StrEnum):
    """Each monitor, as cells, logs and docs call it."""

    SPEED = "speed"
    POWER = "power"
    POSITION = "position"
    START = "start"
    WORKSPACE = "workspace"
    SATURATED = "saturated"
    RATE_LIMITED = "rate_limited"
    FROZEN = "frozen"
    LOAD = "load"
    GRAVITY = "gravity"
    TEMPERATURE = "temperature"
    VOLTAGE = "voltage"
    SERVO_LOAD = "servo_load"


@dataclass(frozen=True, slots=True)
class Bounds:
    """Of one arm; tuples have one entry per controlled joint."""

    joints: tuple[str, ...]
    period_s: float
    watched: frozenset[Name]  # the others are switched off
    speed_rad_per_s: tuple[float, ...]
    speed_alone_rad_per_s: tuple[float, ...]  # of an arm of a session that holds nothing
    power_W: tuple[float, ...]  # |torque x speed|
    position_rad: tuple[tuple[float, float], ...]
    position_alone_rad: tuple[tuple[float, float], ...]  # of an arm of a session that holds nothing
    workspace_m: tuple[tuple[float, float], ...]  # of the object's origin, world axes: x, y, z
    start_m: float  # how far from its stated start the object may be seen before the motion
    start_rad: float
    limited_share: float  # of the last LIMITED_TICKS
    frozen_rad: float  # that the motion asks of a joint whose reading stays the same
    frozen_Nm: tuple[float, ...]  # of the feedback beyond which no friction keeps a joint
    load_share: float  # of stall torque or current, root mean square
    stall_Nm: tuple[float, ...]
    load_time_s: float
    load_share_of_weight: float  # of the object's, that this arm carries
    object_weight_N: tuple[float, float, float]  # world axes
    gravity: tuple[float, ...]  # (6,) N, N·m: wrench of what is measured at rest less what the files say, world axes
    temperature_margin_C: float  # below the servo's own limit
    voltage_margin_V: float  # within the servo's own limits
