"""Does the arm carry at rest what its files say?  Asked before the first motion.

At rest the torque that the servos measure is that of the arm's own weight and of its share of the object's, and

    W = J⁻ᵀ (τ − g(q) − c_i Jᵀ w − τ_internal),   w = −m_O g,

is zero but for friction, errors of masses and of torque constants (agent.config.monitors has the limits).  Arms on one
object share such errors: each sees something between its own and the mean of all, and the anchor more, for the others
align themselves with it.  So nobody can tell here whose error it is, and a weight below the limit goes unnoticed.
What is beyond is a gravity that points elsewhere, an object that is not there or of another weight, or an arm that
is not the file's.
"""

from __future__ import annotations

import numpy as np

from agent.control.models import Matrix
from agent.control.terms import Terms
from agent.modes import Mode
from agent.monitors.bounds import Bounds
from agent.monitors.tick import Tick, digits, sentence
from drivers.interface import Vector

WINDOW_S = 0.5
WINDOWS = 2  # in a row: a hand that lets go, or an arm that sinks into its hold, is over by then
REST_S = WINDOW_S * WINDOWS + 0.1  # after so long at rest, with its load, an arm has been judged
_FORCES = 3
_COMPONENTS = ("along x", "along y", "along z", "about x", "about y", "about z")
STILL_RAD_PER_S = 0.05  # in the mean over a window


class Gravity:
    """Compares measured torque with the files' over windows of READY in which the arm is at rest."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._limits = np.array(bounds.gravity)
        self._wrench = np.array([*bounds.object_weight_N, 0.0, 0.0, 0.0]) * bounds.load_share_of_weight
        self._ticks = max(1, round(WINDOW_S / bounds.period_s))
        self._bad = 0  # windows in a row
        self._begin()

    def _begin(self) -> None:
        n = len(self._bounds.joints)
        self._count, self._sum, self._first = 0, np.zeros(n), np.full(n, np.nan)

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        terms = at.outcome.terms
        if at.mode is not Mode.READY or terms is None or terms.J_inv_P is None:  # None: it takes its load up, say
            if self._count or self._bad:
                self._bad = 0
                self._begin()
            return ""
        measured = at.state.tau
        if not self._count:
            self._first = at.state.q
        self._sum = self._sum + np.where(np.isnan(measured), at.outcome.tau, measured)
        self._count += 1
        if self._count < self._ticks:
            return ""
        mean = self._sum / self._count
        turned = float(np.max(np.abs(at.state.q - self._first)))
        self._begin()
        said = self._compared(terms, terms.J_inv_P, mean) if turned <= STILL_RAD_PER_S * WINDOW_S else ""
        self._bad = self._bad + 1 if said else 0
        return said if self._bad >= WINDOWS else ""

    def _compared(self, terms: Terms, J_inv_P: Matrix, mean: Vector) -> str:
        k = terms.kinematics
        W = J_inv_P.T.dot(mean - k.g - k.Jt.dot(self._wrench) - terms.tau_internal)
        shares = np.abs(W) / self._limits
        worst = int(np.argmax(shares))
        if shares[worst] <= 1.0:
            return ""
        n = digits(2, abs(W[worst]), self._limits[worst])
        unit = "N" if worst < _FORCES else "N·m"
        return sentence(
            "torque at rest", f"{W[worst]:+.{n}f} {unit} {_COMPONENTS[worst]} at the object beside what the files say",
            f"at most {self._limits[worst]:.{n}f} {unit}",
            "check that no neighbour is limp, gravity_m_per_s2, the object (held, alone, of the stated mass) and that "
            "this is the arm of the file",
        )  # fmt: skip
