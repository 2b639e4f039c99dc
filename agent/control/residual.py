"""What acts on an arm beside what it expects, as a wrench at the object, from the arm's own signals.

With s = dq − dq_r, the law (`eq:control law`) and Ḃ = C + Cᵀ the momentum B s obeys

    d(B s)/dt = Cᵀ s + τ_acting − (τ_cmd − τ_feedback) + Jᵀ W,

where W is what the others, the object and people do to this arm beyond the load share that it carries.  The observer

    I ← I + T (Cᵀ s₋ + τ_acting − (τ_cmd − τ_feedback)₋ + r),   r = L (B s − I)

makes r follow Jᵀ W within 1/L; the unexpected wrench is J⁻ᵀ r.  A fast channel, the wrench without its own slow part,
tells a blow; a slow one, the wrench low-passed and without what it was before the start, tells a load that came to
stay.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.control.against import NO_PULL, Against, Pull
from agent.control.borne import NOT_BORNE, Bearing, Borne
from agent.control.knock import NOT_STRUCK, Knock, Struck
from agent.control.models import Matrix
from agent.control.terms import Terms
from agent.control.touch import Plain, Touch
from drivers.interface import Vector

REST_S = 2.0  # of the mean of the slow channel before the start


class Sense(NamedTuple):
    """State of the residual between two ticks; arrays are never written to again."""

    momentum: Vector  # (n,) I
    expected: Vector  # (n,) Cᵀ s − (τ_cmd − τ_feedback) of the last tick
    residual: Vector  # (n,) r, N·m
    base: Vector  # (6,) the unexpected wrench low-passed for the fast channel, at the object, world axes
    slow: Vector  # (6,) the same for the slow channel
    rest: Vector  # (6,) mean of the slow channel before the start
    ticks: float  # in that mean, and one; 0: the residual has not begun
    pull: Pull  # against the motion
    plain: Plain  # of what may be a touch
    struck: Struck
    borne: Borne = NOT_BORNE

    @property
    def wrenches(self) -> tuple[float, ...]:
        """In the log field `memory`: three wrenches (6), `ticks`, `pull`, `plain`, `struck` and `borne`."""
        base, slow, rest = self.base.tolist(), self.slow.tolist(), self.rest.tolist()
        return (*base, *slow, *rest, self.ticks, *self.pull.flat, *self.plain.flat, *self.struck, *self.borne)


def nothing_sensed(n: int) -> Sense:
    """Before the first tick of an arm with n joints."""
    joints, wrench = np.zeros(n), np.zeros(6)
    return Sense(joints, joints, joints, wrench, wrench, wrench, 0.0, NO_PULL, Plain(joints), NOT_STRUCK)


class Channels(NamedTuple):
    """Sizes of the unexpected wrench."""

    fast_N: float
    fast_Nm: float
    slow_N: float
    slow_Nm: float


@dataclass(frozen=True, slots=True)
class Residual:
    """Rates of the residual and its channels, and the thresholds of this arm in this cell."""

    period_s: float
    delay_periods: float  # a command acts this much later
    limits: Channels
    rate_per_s: float = 30.0  # L
    base_per_s: float = 0.5
    slow_per_s: float = 2.0
    against: Against | None = None  # None: nobody asks what pulls against the motion
    knock: Knock | None = None  # what strikes the object, and the slip that limits of `against` grow with
    touch: Touch | None = None  # None: no touch is above the limit of the sudden force
    bearing: Bearing | None = None  # beside `against`: what the friction feed-forward bears

    def __post_init__(self) -> None:
        if (self.against is None) is not (self.knock is None):
            raise ValueError("against and knock go together: without the slip of one the other's limits stay high")

    def advance(
        self, sense: Sense, terms: Terms, J_inv_P: Matrix, dq: Vector, tau: tuple[Vector, Vector],
        friction_factor: float = 1.0, *, ready: bool, periods: int,
    ) -> Sense:  # fmt: skip
        """State after a tick of the law at joint velocities dq (n,).

        J_inv_P: (n, 6) joint velocities of an object twist; tau: what was sent (n,) one tick and two ticks before;
        friction_factor: of the feed-forward; ready: before the start, when the slow channel learns what is usual;
        periods: since the last tick.
        """
        T, f = self.period_s, self.delay_periods
        momentum, expected = _momentum(terms, dq)
        if sense.ticks == 0.0:
            plain = sense.plain if self.touch is None else self.touch.begin(terms, dq)
            return sense._replace(momentum=momentum, expected=expected, ticks=1.0, plain=plain)
        acting = (1.0 - f) * tau[0] + f * tau[1]
        estimate = sense.momentum + T * (sense.expected + acting + sense.residual)
        if periods > 1:
            estimate += (periods - 1) * T * (sense.expected + tau[0] + sense.residual)
        r = self.rate_per_s * (momentum - estimate)
        W = J_inv_P.T.dot(r)
        base = sense.base + (T * self.base_per_s) * (W - sense.base)
        slow = sense.slow + (T * self.slow_per_s) * (W - sense.slow)
        rest, ticks = sense.rest, sense.ticks
        if ready:
            ticks += 1.0
            rest = rest + (slow - rest) / min(ticks, REST_S / T)
        pull, plain = sense.pull, sense.plain
        if self.touch is not None:
            plain = self.touch.advance(plain, terms, J_inv_P, dq, acting, base)
        struck = sense.struck
        if self.against is not None and not ready:
            pull = self.against.advance(pull, W.tolist(), base.tolist(), terms.desired.v)
        if self.knock is not None:
            struck = self.knock.advance(struck, (W - base)[:3].tolist(), J_inv_P.dot(terms.desired.v).tolist())
        borne = sense.borne
        if self.bearing is not None:
            rubs = terms.tau_friction, dq, friction_factor
            borne = self.bearing.advance(borne, pull.weight_N, J_inv_P, *rubs, ready=ready)
        return Sense(estimate, expected, r, base, slow, rest, ticks, pull, plain, struck, borne)

    def over_a_gap(self, sense: Sense, terms: Terms, dq: Vector) -> Sense:
        """The same where more than a period has passed since the last tick: what has been found stands.

        How dq_r, and with it s, went meanwhile is known to nobody.
        """
        momentum, expected = _momentum(terms, dq)
        plain = sense.plain if self.touch is None else self.touch.begin(terms, dq)
        return sense._replace(momentum=momentum - sense.residual / self.rate_per_s, expected=expected, plain=plain)

    def channels(self, sense: Sense, wrench: Vector) -> Channels:
        """Sizes of the fast and of the slow channel; wrench: the unexpected one (6,)."""
        fast = (wrench - sense.base).tolist()
        slow = (sense.slow - sense.rest).tolist()
        return Channels(math.hypot(*fast[:3]), math.hypot(*fast[3:]), math.hypot(*slow[:3]), math.hypot(*slow[3:]))

    def pulled(self, sense: Sense) -> bool:
        """Whether something pulls this arm back against the motion, down or up, or strikes the object."""
        pulled = self.against is not None and self.against.tripped(sense.pull, sense.struck.slip)
        return pulled or self._hangs(sense) or (self.knock is not None and self.knock.tripped(sense.struck))

    def dragged(self, sense: Sense) -> bool:
        """Whether something pulls this arm back against the motion."""
        return self.against is not None and self.against.drags(sense.pull, sense.struck.slip)

    def weighed(self, sense: Sense) -> bool:
        """Whether something pulls this arm down."""
        return self._hangs(sense) or (self.against is not None and self.against.weighs(sense.pull, sense.struck.slip))

    def _hangs(self, sense: Sense) -> bool:
        """Whether something does with what the friction feed-forward bears."""
        return self.bearing is not None and self.bearing.tripped(sense.borne)

    def tripped(self, found: Channels, sense: Sense, wrench: Vector) -> bool:
        """Whether any channel is above its limit, beside a sudden force that may be a touch; one that is no number is.

        found: as `channels` makes it of `sense` and `wrench`.
        """
        if all(x <= bound for x, bound in zip(found, self.limits, strict=True)):
            return False
        if self.touch is None or not all(x <= bound for x, bound in zip(found[1:], self.limits[1:], strict=True)):
            return True
        return not self.touch.may_be((wrench - sense.base)[:3].tolist(), sense.plain)


def _momentum(terms: Terms, dq: Vector) -> tuple[Vector, Vector]:
    """B s, and its rate without the torque that acts, (n,) each."""
    k, s = terms.kinematics, dq - terms.dq_ref
    return k.B.dot(s), k.C.T.dot(s) - (terms.tau_cmd - terms.tau_feedback)
