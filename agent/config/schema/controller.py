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

    position_gain: Share = 0.2  # of the position innovation, into the position
    velocity_gain: Share = 0.2  # of the velocity innovation, into the velocity
    velocity_from_position_per_s: Annotated[float, Field(ge=0.0, le=1e4)] = 5.0  # of the position innovation


class Controller(Strict):
    """Gains and options of the law; a number stands for three equal entries (the paper's scalars)."""

    kind: Annotated[ControllerKind, AS_LIST]
    k_p_per_s: PerAxis
    k_eps_rad_per_s: PerAxis
    k_p_rate_per_s: PerAxis | None = None  # in v̇_r; the paper: the same as k_p
    k_eps_rate_rad_per_s: PerAxis | None = None
    friction_feedforward: bool = False
    friction_smooth_rad_per_s: Smoothing = 0.05
    velocity: Annotated[VelocitySource, AS_LIST] = VelocitySource.OBSERVER
    observer: ObserverGains = ObserverGains()
    adaptive: Adaptive = Adaptive()  # used when kind is "adaptive"
    alignment: AlignmentSpec = AlignmentSpec()
