"""What an agent carries from one tick to the next; in every log row, so that a replay may begin anywhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agent.control.adaptation import Estimate
from drivers.interface import Vector

MEMORY_JOINTS = 7  # room per joint array in the flattened form
_NO_POSE = (0.0,) * 7


class Memory(NamedTuple):
    """State of the agent between two ticks; arrays are (n,) and never written to again.

    A named tuple, because a frozen dataclass takes three times as long to make, and one is made on every tick.
    """

    q: Vector  # observer: last estimate
    dq: Vector
    ddq: Vector  # reference acceleration of the last tick
    ddq_before: Vector  # of the tick before it, for arms whose torque acts one cycle late
    tau: Vector  # last limited torque, for the rate limit
    primed: bool  # the observer has seen a measurement
    hold: tuple[float, ...] | None = None  # object pose (p, quat) to hold, once holding
    t: float = 0.0  # time of the last tick, s; the adaptation integrates over the real interval
    estimate: Estimate | None = None  # of the adaptive law; logged in fields of its own
    q_hold: Vector | None = None  # joint angles at that pose, for a hold that needs no inverse of the Jacobian

    @property
    def joint_arrays(self) -> tuple[Vector | None, ...]:
        """The six joint arrays of the log field `memory`, each (n,); None is logged as zeros."""
        return self.q, self.dq, self.ddq, self.ddq_before, self.tau, self.q_hold

    @property
    def pose_flag_time(self) -> tuple[float, ...]:
        """What stands behind them: the held pose (7), whether it is primed, the time."""
        return (*(_NO_POSE if self.hold is None else self.hold), float(self.primed), self.t)

    def flatten(self) -> list[float]:
        """The numbers of the log field `memory`: the joint arrays padded to seven, the pose, the flag, the time."""
        pad = [0.0] * (MEMORY_JOINTS - len(self.q))
        flat: list[float] = []
        for array in self.joint_arrays:
            flat += [0.0] * len(self.q) if array is None else array.tolist()
            flat += pad
        return [*flat, *self.pose_flag_time]


def initial(n: int, estimate: Estimate | None = None) -> Memory:
    """Memory before the first tick of an arm with n joints; estimate: where the adaptive law starts."""
    zero = np.zeros(n)
    return Memory(zero, zero, zero, zero, zero, primed=False, estimate=estimate)


def restore(flat: Vector, n: int, estimate: Estimate | None = None) -> Memory:
    """The memory that a log row holds; inverse of `Memory.flatten`.

    estimate: of the adaptive law before that row (`agent.control.adaptation.from_row`), None without it.
    """
    joints = np.array(flat[: 6 * MEMORY_JOINTS]).reshape(6, MEMORY_JOINTS)[:, :n]
    tail = flat[6 * MEMORY_JOINTS :].tolist()
    hold = tuple(tail[:7]) if any(tail[3:7]) else None
    q, dq, ddq, ddq_before, tau, q_hold = (row.copy() for row in joints)
    at_hold = None if hold is None else q_hold
    return Memory(q, dq, ddq, ddq_before, tau, bool(tail[7]), hold, tail[8], estimate, at_hold)
