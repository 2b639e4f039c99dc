"""What may be a touch: a sudden force above its limit that is no more than 2 N on the object make of it.

Until the observer has seen all of a jolt dq_r runs ahead of ddq_r, and the residual of s = dq − dq_r shows a step of
the force up to 2.5 times as large as it is.  The momentum of the joints without the reference obeys

    d(B dq)/dt = Cᵀ dq + τ_acting − (τ_cmd − τ_feedback) + B ddq_r + C dq_r + Jᵀ W,

and shows a step no larger than it is, later, and what grows for longer as such: the `plain` force is what it finds of
W.  A sudden force may be a touch as long as its size, the plain force and its own part along gravity are within what a
touch makes; a neighbour that holds or is locked pulls ever harder, and a limp one down.  An arm with this sense holds
for nothing for which it would not hold without.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.control.models import Matrix
from agent.control.terms import Terms
from drivers.interface import Vector

PLAIN_JOINTS = 7  # room for the momentum in the log field `memory`
PLAIN = PLAIN_JOINTS + 1  # numbers there


class Plain(NamedTuple):
    """State between two ticks."""

    momentum: Vector  # (n,) expected of B dq at the next tick, without the torque that acts until then
    force_N: float = 0.0  # found, without the slow part of the unexpected force

    @property
    def flat(self) -> tuple[float, ...]:
        """For the log field `memory`: PLAIN_JOINTS numbers and one."""
        return (*self.momentum.tolist(), *(0.0,) * (PLAIN_JOINTS - len(self.momentum)), self.force_N)


def plain_of(flat: Sequence[float], n: int) -> Plain:
    """Inverse of `Plain.flat` for n joints; nothing from a row of a log that is older than this sense."""
    if not flat:
        return Plain(np.zeros(n))
    return Plain(np.array(flat[:n]), flat[PLAIN_JOINTS])


@dataclass(frozen=True, slots=True)
class Touch:
    """What 2 N on the object make at most of what an arm finds, in this cell."""

    period_s: float
    rate_per_s: float  # of the residual
    most_N: float  # of the sudden force, to any side
    down_N: float  # of its part along gravity
    plain_N: float
    down: tuple[float, float, float] = (0.0, 0.0, 0.0)  # gravity's direction, world axes; zero where there is none

    def begin(self, terms: Terms, dq: Vector) -> Plain:
        """State after the first tick."""
        return Plain(terms.kinematics.B.dot(dq) + self.period_s * _expected(terms, dq))

    def advance(self, plain: Plain, terms: Terms, J_inv_P: Matrix, dq: Vector, acting: Vector, base: Vector) -> Plain:
        """State after a tick; acting: torque (n,) since the last one, base: slow part of the unexpected wrench (6,)."""
        estimate = plain.momentum + self.period_s * acting
        r = self.rate_per_s * (terms.kinematics.B.dot(dq) - estimate)
        W = J_inv_P.T.dot(r) - base
        return Plain(estimate + self.period_s * (_expected(terms, dq) + r), math.hypot(*W[:3].tolist()))

    def may_be(self, force: Sequence[float], plain: Plain) -> bool:
        """Whether a sudden force (3,), world axes, may be one; what is no number may not."""
        x, y, z = force
        a, b, c = self.down
        sunk = a * x + b * y + c * z
        return math.hypot(x, y, z) <= self.most_N and sunk <= self.down_N and plain.force_N <= self.plain_N


def _expected(terms: Terms, dq: Vector) -> Vector:
    """Cᵀ dq − (τ_cmd − τ_feedback) + B ddq_r + C dq_r of a tick, (n,)."""
    k = terms.kinematics
    inertia = k.B.dot(terms.ddq_ref) + k.C.dot(terms.dq_ref)
    expected: Vector = k.C.T.dot(dq) + inertia - (terms.tau_cmd - terms.tau_feedback)
    return expected
