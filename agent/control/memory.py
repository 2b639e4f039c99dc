"""What an agent carries from one tick to the next; in every log row, so that a replay may begin anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.control.adaptation import Estimate
from agent.control.against import FLAT, pull_of
from agent.control.alignment import NO_SHIFT, Shift
from agent.control.borne import BORNE, BORNE_OF_OLD, borne_of
from agent.control.brace import BRACED, NOT_BRACED, Braced, braced_of
from agent.control.knock import STRUCK, struck_of
from agent.control.residual import Sense, nothing_sensed
from agent.control.touch import PLAIN, plain_of
from drivers.interface import Vector

MEMORY_JOINTS = 7  # room per joint array in the flattened form
JOINT_ARRAYS = 10
NO_POSE = (0.0,) * 7  # what the log has where nothing is held
MISSED = 1024  # in the log `calm` and `missed` share a number


class Memory(NamedTuple):
    """State of the agent between two ticks; arrays are (n,) and never written to again.

    A named tuple, because a frozen dataclass takes three times as long to make, and one is made on every tick.
    """

    q: Vector  # observer: last estimate
    dq: Vector
    ddq: Vector  # reference acceleration of the last tick
    ddq_before: Vector  # of the tick before it, for arms whose torque acts one cycle late
    tau: Vector  # last limited torque, for the rate limit
    tau_before: Vector  # the one before it, for the torque that acted in between
    primed: bool  # the observer has seen a measurement
    sense: Sense  # of the unexpected wrench
    shift: Shift = NO_SHIFT  # of the desired pose (agent.control.alignment)
    calm: int = 0  # how a hold is kept: agent.calm.LAW, BRAKE, JOINTS, above that so many ticks longer gently
    hold: tuple[float, ...] | None = None  # object pose (p, quat) to hold, once holding
    t: float = 0.0  # time of the last tick, s; the adaptation integrates over the real interval
    estimate: Estimate | None = None  # of the adaptive law; logged in fields of its own
    q_hold: Vector | None = None  # joint angles at that pose, for a hold that needs no inverse of the Jacobian
    age: float = 0.0  # s in this mode, without pauses: what goes by it is not hurried by one (agent.missed)
    missed: int = 0  # ticks until a hold forgets that it had no state for some (agent.missed)
    braced: Braced = NOT_BRACED  # of a hold that is carried on (agent.control.brace)
    friction_factor: float = 1.0  # times the file's friction (agent.control.friction_factor)
    settled: Shift = NO_SHIFT  # the shift that the start left

    @property
    def calm_and_missed(self) -> int:
        """One number of the log field `memory`."""
        return self.calm + MISSED * self.missed

    def flatten(self) -> list[float]:
        """The numbers of the log field `memory`.

        Joint arrays padded to seven, None as zeros; pose to hold (7), primed, time, shift (6), calm and MISSED times
        `missed`, age; of `sense` the wrenches (6), `ticks`, the pull against the motion and down (14), what is plain
        (8), what strikes (5) and what friction bears (4); how a hold is braced (5); the factor of friction; the
        shift that the start left (6).
        """
        own, sense, n = self[:6], self.sense, len(self.q)
        joints = np.zeros((JOINT_ARRAYS, MEMORY_JOINTS))
        for row, array in zip(joints, (*own, self.q_hold, *sense[:3]), strict=True):
            if array is not None:
                row[:n] = array
        behind = self.calm_and_missed, self.age, *sense.wrenches, *self.braced, self.friction_factor, *self.settled
        rest = *(self.hold or NO_POSE), self.primed, self.t, *self.shift, *behind
        return [*joints.ravel().tolist(), *map(float, rest)]


def initial(n: int, estimate: Estimate | None = None) -> Memory:
    """Memory before the first tick of an arm with n joints; estimate: where the adaptive law starts."""
    zero = np.zeros(n)
    return Memory(zero, zero, zero, zero, zero, zero, primed=False, sense=nothing_sensed(n), estimate=estimate)


def restore(flat: Vector, n: int, estimate: Estimate | None = None) -> Memory:
    """The memory that a log row holds; inverse of `Memory.flatten`.

    estimate: of the adaptive law before that row (`agent.control.adaptation.from_row`), None without it.
    """
    count = JOINT_ARRAYS * MEMORY_JOINTS
    joints = np.array(flat[:count]).reshape(JOINT_ARRAYS, MEMORY_JOINTS)[:, :n]
    tail = flat[count:].tolist()
    hold = tuple(tail[:7]) if any(tail[3:7]) else None
    q, dq, ddq, ddq_before, tau, tau_before, q_hold, momentum, expected, residual = (row.copy() for row in joints)
    missed, calm = divmod(int(tail[15]), MISSED)
    base, slow, rest = (np.array(tail[k : k + 6]) for k in (17, 23, 29))
    plain_at, struck_at = 36 + FLAT, 36 + FLAT + PLAIN
    borne_at = struck_at + STRUCK
    braced_at = borne_at + (BORNE if len(tail) >= borne_at + BORNE + BRACED else BORNE_OF_OLD)
    plain, struck = plain_of(tail[plain_at:struck_at], n), struck_of(tail[struck_at:borne_at])
    found = pull_of(tail[36:plain_at]), plain, struck, borne_of(tail[borne_at:braced_at])
    factor_at = braced_at + BRACED
    shift, settled = _shift(tail[9:15]), tail[factor_at + 1 :]
    return Memory(
        q,
        dq,
        ddq,
        ddq_before,
        tau,
        tau_before,
        primed=bool(tail[7]),
        sense=Sense(momentum, expected, residual, base, slow, rest, tail[35], *found),
        shift=shift,
        calm=calm,
        hold=hold,
        t=tail[8],
        estimate=estimate,
        q_hold=None if hold is None else q_hold,
        age=tail[16],
        missed=missed,
        braced=braced_of(tail[braced_at:]),
        friction_factor=(tail[factor_at:] or [1.0])[0],  # older rows have none
        settled=_shift(settled) if settled else shift,  # of older rows nothing goes back
    )


def _shift(six: Sequence[float]) -> Shift:
    x, y, z, about_x, about_y, about_z = six
    return (x, y, z, about_x, about_y, about_z)
