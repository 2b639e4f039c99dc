"""What one tick of a law computed: every intermediate result, the joint vectors in one block."""

from __future__ import annotations

from typing import Final, NamedTuple, overload

import numpy as np

from agent.control.errors import Errors
from agent.control.models import Kinematics, Matrix
from agent.control.trajectory import Desired, Vec6
from drivers.interface import Vector

# Rows of `Terms.joints`, each (n,): fields of the log row of the same names, which follow each other there.
JOINT_TERMS: Final = (
    "dq_ref",
    "ddq_ref",
    "tau_inertia",
    "tau_coriolis",
    "tau_gravity",
    "tau_adaptive",
    "tau_feedback",
    "tau_object",
    "tau_internal",
    "tau_friction",
    "tau_posture",
    "tau_cmd",
)
(
    DQ_REF, DDQ_REF, INERTIA, CORIOLIS, GRAVITY, ADAPTIVE, FEEDBACK, OBJECT, INTERNAL, FRICTION, POSTURE, CMD,
) = range(len(JOINT_TERMS))  # fmt: skip
SUMMANDS: Final = slice(INERTIA, CMD)  # of which tau_cmd is the sum
SUMS: Final = slice(CMD, CMD + 2)
LAW = CMD + 1  # one more row behind the logged ones: the sum without friction feed-forward
BY_WRENCHES: Final = slice(FEEDBACK, FRICTION)  # Jᵀ of wrenches at the object


def no_terms(n: int) -> Matrix:
    """A block for n joints: zeros, which is what a term is that the law does not have."""
    return np.zeros((LAW + 1, n))


class _Row:
    """The row of `Terms.joints` that the attribute is named after, (n,)."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._row = JOINT_TERMS.index(name)

    @overload
    def __get__(self, terms: None, owner: type) -> _Row: ...
    @overload
    def __get__(self, terms: _Terms, owner: type) -> Vector: ...
    def __get__(self, terms: _Terms | None, owner: type) -> Vector | _Row:
        return self if terms is None else terms.joints[self._row]


class _Terms(NamedTuple):
    desired: Desired
    kinematics: Kinematics
    errors: Errors
    joints: Matrix  # (13, n) JOINT_TERMS, and the sum of the law's own
    wrench_cmd: Vec6  # u_i at the end effector
    wrench_internal: Vec6  # at the end effector
    lyapunov: float
    sigma_min: float
    J_inv_P: Matrix | None  # (n, 6) joint velocities of an object twist; None where the Jacobian was not inverted


class Terms(_Terms):
    """Every intermediate result of one tick; the torque is the sum of the named terms, and one that is not had is zero.

    A named tuple, because a frozen dataclass takes three times as long to make, and one block of joint vectors, because
    making, summing and logging twelve takes ten times as long as one; neither is ever written to again.
    """

    __slots__ = ()
    dq_ref = _Row()
    ddq_ref = _Row()
    tau_inertia = _Row()
    tau_coriolis = _Row()
    tau_gravity = _Row()
    tau_adaptive = _Row()
    tau_feedback = _Row()
    tau_object = _Row()
    tau_internal = _Row()
    tau_friction = _Row()
    tau_posture = _Row()
    tau_cmd = _Row()
