"""Fills the log record of one tick from the terms of the law, by one packed write; computes no number itself."""

from __future__ import annotations

import math
import struct
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.control.law import Terms
from agent.control.memory import Memory
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

_ABSENT: Final = b""  # packs as zeros
_NO_WRENCHES: Final = (math.nan,) * 14  # wrench_cmd, wrench_internal, lyapunov, sigma_min
_NO_SENSE: Final = (math.nan,) * 10  # unexpected_wrench, unexpected

Row = NDArray[np.void]
Values = tuple[bytes | float, ...]


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

    Vectors are float64 of length n.  A joint array is one item of the packed record: the bytes of its n numbers, then
    zeros for the joints that are not there.
    """

    def __init__(self, message: Row, joint_count: int, config_id: int) -> None:
        """`message`: array of AGENT_STATE.dtype with one element, contiguous, whose memory is filled."""
        base: Any = message.reshape(1)
        for f in AGENT_FIELDS:
            if _is_of_joints(f) or f.name in ("memory", "theta_arm", "theta_object"):
                base[f.name] = 0.0
        base["encapsulation"] = CDR_LITTLE_ENDIAN
        self._bytes = base.view(np.uint8).data
        self._theta_arm: NDArray[np.float64] = base["theta_arm"][0]
        self._theta_object: NDArray[np.float64] = base["theta_object"][0]
        self._head = (joint_count, config_id)
        self._no_law = _no_law(joint_count)
        self._tick = _packer("sequence", "memory", joint_count)
        self._tick_at = _offset("sequence")
        self._timing = _packer("late_s", "bus_retries", joint_count)
        self._timing_at = _offset("late_s")

    def fill(
        self, sequence: int, t: float, utc_ns: int, mode: int, state: JointState, memory: Memory, outcome: Outcome,
        tau_sent: Vector,
    ) -> None:  # fmt: skip
        """Everything of a tick but its timing.

        memory: what the tick began with.  Where the law gave nothing its fields are NaN; terms that the law does not
        have are zero.  The values stand in the order of the table.
        """
        terms = outcome.terms
        law, wrenches = (self._no_law, _NO_WRENCHES) if terms is None else _law(terms)
        self._tick.pack_into(
            self._bytes, self._tick_at,
            sequence, state.stamp_ns, utc_ns, mode, outcome.flags, *self._head,
            t, state.q.tobytes(), state.dq.tobytes(), state.tau.tobytes(), outcome.q.tobytes(), outcome.dq.tobytes(),
            *law, outcome.tau.tobytes(), tau_sent.tobytes(), *wrenches,
            *memory.shift, *(_NO_SENSE if outcome.sensed is None else outcome.sensed),
            *map(_bytes, memory.joint_arrays), *memory.rest,
        )  # fmt: skip
        if memory.estimate is not None:
            self._theta_arm[: len(memory.estimate.arm)] = memory.estimate.arm
            self._theta_object[:] = memory.estimate.object

    def fill_timing(self, late_s: float, read_s: float, step_s: float, write_s: float, bus: BusCounters) -> None:
        """Fields that may differ between two runs."""
        self._timing.pack_into(
            self._bytes, self._timing_at, late_s, read_s, step_s, write_s,
            bus.timeouts, bus.corrupt, bus.alerts, bus.retries,
        )  # fmt: skip


def _law(terms: Terms) -> tuple[Values, tuple[float, ...]]:
    """The fields from p_object_des to tau_cmd, and those from wrench_cmd to sigma_min."""
    d, k, e = terms.desired, terms.kinematics, terms.errors
    return (
        *d.p, *d.quat, *d.v, *d.a,
        *k.p_object, *k.quat_object, *k.v_object,
        *e.e_p, e.e_eta, *e.e_eps, *e.e_v, *e.v_ref, *e.dv_ref,
        terms.dq_ref.tobytes(), terms.ddq_ref.tobytes(),
        _bytes(terms.tau_inertia), _bytes(terms.tau_coriolis), _bytes(terms.tau_gravity), _bytes(terms.tau_adaptive),
        terms.tau_feedback.tobytes(), terms.tau_object.tobytes(),
        _bytes(terms.tau_internal), _bytes(terms.tau_friction), _bytes(terms.tau_posture),
        terms.tau_cmd.tobytes(),
    ), (*terms.wrench_cmd, *terms.wrench_internal, terms.lyapunov, terms.sigma_min)  # fmt: skip


def _bytes(array: Vector | None) -> bytes:
    return _ABSENT if array is None else array.tobytes()


def _no_law(joint_count: int) -> Values:
    """The fields from p_object_des to tau_cmd when there is no law."""
    nan = np.full(joint_count, np.nan).tobytes()
    values: list[bytes | float] = []
    for f in _span("p_object_des", "tau_cmd"):
        values += [nan] if _is_of_joints(f) else [math.nan] * max(f.length, 1)
    return tuple(values)


def _packer(first: str, last: str, joint_count: int) -> struct.Struct:
    """Packs the values of the fields from `first` to `last`: numbers, and one bytes object per joint array."""
    joints = f"{8 * joint_count}s{8 * (MAX_JOINTS - joint_count)}x"
    return struct.Struct("<" + "".join(_code(f, joints) for f in _span(first, last)))


def _code(f: Field, joints: str) -> str:
    if f.name == "memory":
        return MEMORY_ARRAYS * joints + f"{MEMORY_REST}d"
    return joints if _is_of_joints(f) else f"{max(f.length, 1)}{f.struct_code}"


def _span(first: str, last: str) -> tuple[Field, ...]:
    names = [f.name for f in AGENT_FIELDS]
    return AGENT_FIELDS[names.index(first) : names.index(last) + 1]


def _is_of_joints(f: Field) -> bool:
    return f.length == MAX_JOINTS


def _offset(name: str) -> int:
    offset: int = AGENT_STATE.dtype.fields[name][1]  # type: ignore[index]
    return offset
