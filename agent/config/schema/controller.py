"""What may stand under `[controller]` of a cell file, the adaptive law apart."""

from __future__ import annotations

import enum
from typing import Annotated

from pydantic import Field

from agent.config.schema.adaptive import Adaptive
from agent.config.schema.coordination import AlignmentSpec
from agent.config.schema.types import AS_LIST, PerAxis, Share, Smoothing, Strict


class ControllerKind(enum.StrEnum):
    """Which of the paper's laws runs."""

    KNOWN = "known"
    ADAPTIVE = "adaptive"


class VelocitySource(enum.StrEnum):
    """What the law takes as joint position and velocity."""

    SERVO = "servo"  # the servos' own values, as they are
    OBSERVER = "observer"  # fused with the commanded acceleration (agent.control.estimator)


class ObserverGains(Strict):
    """How far a servo's values correct what the observer predicts, per control period; used with velocity = "observer".

    A larger gain follows a surprise sooner and lets more of the servos' quantisation through.
    """

    position_gain: Share = 0.2
    """Of the surprise in position, into the position, per cycle."""
    velocity_gain: Share = 0.2
    """Of the surprise in velocity, into the velocity, per cycle."""
    velocity_from_position_per_s: Annotated[float, Field(ge=0.0, le=1e4)] = 5.0
    """Of the surprise in position, into the velocity."""


class Controller(Strict):
    """Gains and options of the law; a number stands for three equal entries (the paper's scalars)."""

    kind: Annotated[ControllerKind, AS_LIST]
    """Known: parameters as in the files; adaptive: learned."""
    k_p_per_s: PerAxis
    """Gain of the position error; one number or three; larger is stiffer, and unstable sooner."""
    k_eps_rad_per_s: PerAxis
    """Gain of the attitude error."""
    k_p_rate_per_s: PerAxis | None = None
    """The part of k_p in v̇_r; smaller bears more delay; none: k_p, as in the paper."""
    k_eps_rate_rad_per_s: PerAxis | None = None
    """The part of k_eps in v̇_r; none: k_eps."""
    friction_feedforward: bool = False
    """Whether friction of the arm files is compensated."""
    friction_smooth_rad_per_s: Smoothing = 0.05
    """Speed over which the compensation changes its sign."""
    friction_learning_per_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    """How quickly each arm learns how much of that friction it has, within [tolerance]; known law only; 0: never."""
    velocity: Annotated[VelocitySource, AS_LIST] = VelocitySource.OBSERVER
    """Joint state that the law takes: the servos' own, or the observer's, fused with the commanded acceleration."""
    observer: ObserverGains = ObserverGains.default()
    """Gains of the observer."""
    adaptive: Adaptive = Adaptive.default()
    """The adaptive law; used with kind = "adaptive"."""
    alignment: AlignmentSpec = AlignmentSpec.default()
    """How arms that see the object differently meet."""
