"""How much of its file's dry friction an arm has: a factor of the feed-forward, learned from the power that it loses.

With r the residual (agent.control.residual), β the factor and P = |τ_frictionᵀ dq| / β about the power that friction
takes by the file,

    β̇ = RATE s,   s = (−rᵀ dq − BELIEF (β − 1) P) / (P_0 + P),   |s| ≤ SURPRISE,   least ≤ β ≤ most.

Arms that nobody has identified rub otherwise than their file says, and an object that only the stiffness of the law
holds against that lags by it.  A power counts a joint as it moves: near rest, where nobody knows friction's sign, it
teaches nothing.  A feed-forward that is too strong is hardly felt as power, for it turns round and round instead;
BELIEF is what leads back to the file.  Viscous friction stays the file's: with it the loop is checked to be stable
(agent.verify.criterion).  A neighbour that pulls back for a second changes β by RATE SURPRISE at most, usually 0.15.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from agent.control.friction import Friction
from drivers.interface import Vector

BELIEF: Final = 0.1  # in the file, beside what is felt: of a friction off by x the factor learns x / (1 + BELIEF)
SURPRISE: Final = 0.5  # of s: more is not friction
USUAL_RAD_PER_S: Final = 0.1  # of all joints, whose friction takes P_0


@dataclass(frozen=True, slots=True)
class FrictionFactor:
    """Rate and bounds of one arm's factor."""

    per_s: float  # RATE
    least: float
    most: float
    usual_W: float  # P_0

    @staticmethod
    def of(friction: Friction, per_s: float, least: float, most: float) -> FrictionFactor:
        """That of an arm whose file says this friction; P_0 is zero where all of it is viscous."""
        usual_W = USUAL_RAD_PER_S * sum(joint.coulomb_Nm + joint.breakaway_Nm for joint in friction.joints)
        return FrictionFactor(per_s, least, most, usual_W)

    def advance(self, factor: float, residual: Vector, tau_friction: Vector, dq: Vector, dt: float) -> float:
        """The factor after dt seconds; residual, feed-forward with the factor (N·m) and speeds (rad/s) are (n,)."""
        taken_W = abs(float(tau_friction.dot(dq))) / factor
        felt_W = -float(residual.dot(dq)) - BELIEF * (factor - 1.0) * taken_W
        share = felt_W / (self.usual_W + taken_W)
        if math.isnan(share):
            return factor
        share = min(max(share, -SURPRISE), SURPRISE)
        return min(max(factor + dt * self.per_s * share, self.least), self.most)
