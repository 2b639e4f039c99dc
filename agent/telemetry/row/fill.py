"""Fills the log record of one tick from the terms of the law, by one packed write; computes no number itself."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.control.brace import BRACED
from agent.control.memory import NO_POSE, Memory
from agent.control.residual import Sense
from agent.control.terms import JOINT_TERMS, Terms
from agent.telemetry.row.sample import (
    AGENT_FIELDS,
    AGENT_STATE,
    CDR_LITTLE_ENDIAN,
    MAX_JOINTS,
    MEMORY_ARRAYS,
    MEMORY_REST,
    Field,
)
from drivers.interface import BusCounters, JointState, Vector

_LOGGED: Final = len(JOINT_TERMS)
_ABSENT: Final = b""  # packs as zeros
_NO_MOTION: Final = (math.nan,) * 57  # p_object_des to dv_object_ref
_NO_WRENCHES: Final = (math.nan,) * 14  # wrench_cmd, wrench_internal, lyapunov, sigma_min
_NO_SENSE: Final = (math.nan,) * 10  # unexpected_wrench, unexpected
SENSE_ARRAYS: Final = 3  # of the field `memory`: of agent.control.residual.Sense
SENSE_REST: Final = 50
FACTOR: Final = 1  # number behind those of `braced`
SETTLED: Final = 6  # of what the start left of the shift
_WRENCHES: Final = struct.Struct(f"<{SENSE_REST}d")

Row = NDArray[np.void]


class Outcome(Protocol):
    """What a row says of a step's result; `agent.loop.Outcome` is one."""

    @property
    def q(self) -> Vector:
        """Joint positions the law used, (n,) rad."""
        ...

    @property
    def dq(self) -> Vector:
        """Joint velocities the law used, (n,) rad/s."""
        ...

    @property
    def terms(self) -> Terms | None:
        """None when the law gave nothing."""
        ...

    @property
    def tau(self) -> Vector:
        """Torque after the limits, (n,) N·m."""
        ...

    @property
    def sensed(self) -> tuple[float, ...] | None:
        """The unexpected wrench (6) and the sizes of its channels (4); None when nothing was sensed."""
        ...

    @property
    def flags(self) -> int:
        """Bits of `agent.safety.Flag`."""
        ...


class AgentRow:
    """The writing end of one AgentState message of an arm with n joints.

    Vectors are float64 of length n.  A joint array is one item of a packed stretch of fields: the bytes of its n
    numbers, then zeros for the joints that are not there.  The joint vectors of the law are copied as one block.
    """

    def __init__(self, message: Row, joint_count: int, config_id: int) -> None:
        """`message`: array of AGENT_STATE.dtype with one element, contiguous, whose memory is filled."""
        base: Any = message.reshape(1)
        for f in AGENT_FIELDS:
            if _is_of_joints(f) or f.name in ("memory", "theta_arm", "theta_object", "twin_age_s"):
                base[f.name] = 0.0
        base["encapsulation"] = CDR_LITTLE_ENDIAN
        self._bytes = base.view(np.uint8).data
        self._of_law = _block(self._bytes, JOINT_TERMS, joint_count)
        self._theta_arm: NDArray[np.float64] = base["theta_arm"][0]
        self._theta_object: NDArray[np.float64] = base["theta_object"][0]
        self._counts = (joint_count, config_id)
        self._pad = bytes(8 * (MAX_JOINTS - joint_count))
        self._sense: Sense | None = None  # that of the last row, and how it was packed
        self._packed_sense = b"", b""
        self._state, self._state_at = _packer("sequence", "dq", joint_count), _offset("sequence")
        self._motion, self._motion_at = _packer("p_object_des", "dv_object_ref", joint_count), _offset("p_object_des")
        self._sent, self._sent_at = _packer("tau_limited", "sigma_min", joint_count), _offset("tau_limited")
        self._memory, self._memory_at = _packer("shift", "memory", joint_count), _offset("shift")
        self._bridge, self._bridge_at = _packer("tau_bridge", "twin_age_s", joint_count), _offset("tau_bridge")
        self._sent_alone, self._sent_alone_at = _packer("tau_sent", "tau_sent", joint_count), _offset("tau_sent")
        self._timing, self._timing_at = _packer("late_s", "bus_retries", joint_count), _offset("late_s")

    def fill(
        self, sequence: int, t: float, utc_ns: int, mode: int, state: JointState, memory: Memory, outcome: Outcome,
        tau_sent: Vector,
    ) -> None:  # fmt: skip
        """Everything of a tick but its timing.

        memory: what the tick began with.  Where the law gave nothing its fields are NaN; terms that the law does not
        have are zero.  The values stand in the order of the table.
        """
        message = self._bytes
        self._state.pack_into(
            message, self._state_at,
            sequence, state.stamp_ns, utc_ns, mode, outcome.flags, *self._counts,
            t, state.q.tobytes(), state.dq.tobytes(), state.tau.tobytes(), outcome.q.tobytes(), outcome.dq.tobytes(),
        )  # fmt: skip
        self._fill_law(outcome.terms, outcome.tau.tobytes(), tau_sent.tobytes())
        if memory.sense is not self._sense:
            self._pack_sense(memory.sense)
        of_sense, behind = self._packed_sense
        self._memory.pack_into(
            message, self._memory_at,
            *memory.shift, memory.friction_factor, *(outcome.sensed or _NO_SENSE),
            memory.q.tobytes(), memory.dq.tobytes(), memory.ddq.tobytes(), memory.ddq_before.tobytes(),
            memory.tau.tobytes(), memory.tau_before.tobytes(),
            _ABSENT if memory.q_hold is None else memory.q_hold.tobytes(), of_sense,
            *(memory.hold or NO_POSE), memory.primed, memory.t, *memory.shift, memory.calm_and_missed, memory.age,
            behind, *memory.braced, memory.friction_factor, *memory.settled,
        )  # fmt: skip
        if memory.estimate is not None:
            self._theta_arm[: len(memory.estimate.arm)] = memory.estimate.arm
            self._theta_object[:] = memory.estimate.object

    def fill_bridge(self, sent: Vector, added: Vector, q_twin: Vector, age_s: float) -> None:
        """What is between a real arm and its simulated twin; rows of other arms have zeros.  (n,), (n,), (n,), s.

        sent: with the addition, also in a cycle without a state.
        """
        self._sent_alone.pack_into(self._bytes, self._sent_alone_at, sent.tobytes())
        self._bridge.pack_into(self._bytes, self._bridge_at, added.tobytes(), q_twin.tobytes(), age_s)

    def fill_timing(self, late_s: float, read_s: float, step_s: float, write_s: float, bus: BusCounters) -> None:
        """Fields that may differ between two runs."""
        self._timing.pack_into(
            self._bytes, self._timing_at, late_s, read_s, step_s, write_s,
            bus.timeouts, bus.corrupt, bus.alerts, bus.retries,
        )  # fmt: skip

    def _fill_law(self, terms: Terms | None, limited: bytes, sent: bytes) -> None:
        """The fields from p_object_des to sigma_min; limited, sent: torques after the law."""
        if terms is None:
            self._motion.pack_into(self._bytes, self._motion_at, *_NO_MOTION)
            self._of_law[...] = math.nan
            self._sent.pack_into(self._bytes, self._sent_at, limited, sent, *_NO_WRENCHES)
            return
        d, k, e = terms.desired, terms.kinematics, terms.errors
        self._motion.pack_into(
            self._bytes, self._motion_at,
            *d.p, *d.quat, *d.v, *d.a,
            *k.p_object, *k.quat_object, *k.v_object,
            *e.e_p, e.e_eta, *e.e_eps, *e.e_v, *e.v_ref, *e.dv_ref,
        )  # fmt: skip
        self._of_law[...] = terms.joints[:_LOGGED]
        self._sent.pack_into(
            self._bytes, self._sent_at,
            limited, sent, *terms.wrench_cmd, *terms.wrench_internal, terms.lyapunov, terms.sigma_min,
        )  # fmt: skip

    def _pack_sense(self, sense: Sense) -> None:
        """The bytes of a state of the residual; an arm without one keeps the same all the time."""
        joints = b"".join(array.tobytes() + self._pad for array in sense[:SENSE_ARRAYS])
        self._sense, self._packed_sense = sense, (joints, _WRENCHES.pack(*sense.wrenches))


def _block(message: memoryview, names: Sequence[str], joint_count: int) -> NDArray[np.float64]:
    """View (k, n) of joint arrays that follow each other in a message.  Raises ValueError where they do not."""
    first, last = _span(names[0], names[-1])[:: len(names) - 1]
    if [f.name for f in _span(first.name, last.name)] != list(names):
        raise ValueError(f"the fields {', '.join(names)} do not follow each other")
    shape, strides = (len(names), joint_count), (8 * MAX_JOINTS, 8)
    return np.ndarray(shape, np.float64, message, _offset(names[0]), strides)


def _packer(first: str, last: str, joint_count: int) -> struct.Struct:
    """Packs the values of the fields from `first` to `last`: numbers, and one bytes object per joint array."""
    joints = f"{8 * joint_count}s{8 * (MAX_JOINTS - joint_count)}x"
    return struct.Struct("<" + "".join(_code(f, joints) for f in _span(first, last)))


def _code(f: Field, joints: str) -> str:
    if f.name == "memory":
        sense, last = (8 * SENSE_ARRAYS * MAX_JOINTS, 8 * SENSE_REST), BRACED + FACTOR + SETTLED
        own = MEMORY_REST - SENSE_REST - last
        return f"{(MEMORY_ARRAYS - SENSE_ARRAYS) * joints}{sense[0]}s{own}d{sense[1]}s{last}d"
    return joints if _is_of_joints(f) else f"{max(f.length, 1)}{f.struct_code}"


def _span(first: str, last: str) -> tuple[Field, ...]:
    names = [f.name for f in AGENT_FIELDS]
    return AGENT_FIELDS[names.index(first) : names.index(last) + 1]


def _is_of_joints(f: Field) -> bool:
    return f.length == MAX_JOINTS


def _offset(name: str) -> int:
    offset: int = AGENT_STATE.dtype.fields[name][1]  # type: ignore[index]
    return offset
