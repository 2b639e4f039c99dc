"""Fills the log record of one tick from the terms of the law; copies numbers, computes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.control.law import Terms
from agent.control.memory import Memory
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, MAX_JOINTS
from drivers.interface import BusCounters, JointState, Vector

_ESTIMATE_FIELDS = ("theta_arm", "theta_object")
_JOINT_FIELDS = tuple(f.name for f in AGENT_STATE.fields if f.length == MAX_JOINTS)
_NAMES = tuple(f.name for f in AGENT_STATE.fields)
_OUTPUTS = ("tau_limited", "tau_sent")
_LAW_FIELDS = tuple(
    name for name in _NAMES[_NAMES.index("p_object_des") : _NAMES.index("sigma_min") + 1] if name not in _OUTPUTS
)


class AgentRow:
    """Writable views of one AgentState message.

    message: structured scalar or (1,) array of AGENT_STATE.dtype whose memory the views share.
    """

    def __init__(self, message: NDArray[np.void] | np.void, joint_count: int, config_id: int) -> None:
        base: Any = np.asarray(message).reshape(())
        for field in AGENT_STATE.fields:
            view = base[field.name]
            if field.name in _JOINT_FIELDS:
                view[...] = 0.0
                view = view[:joint_count]
            elif field.name in _ESTIMATE_FIELDS:
                view[...] = 0.0
            setattr(self, "v_" + field.name, view)
        self._law_views = [getattr(self, "v_" + name) for name in _LAW_FIELDS]
        self._has: tuple[bool, ...] | None = None  # which of its terms the law of the last tick had; None: no law
        base["encapsulation"] = CDR_LITTLE_ENDIAN
        base["joint_count"] = joint_count
        base["config_id"] = config_id

    def __getattr__(self, name: str) -> Any:  # the views are set from the table; this tells mypy so
        raise AttributeError(name)

    def fill_state(self, sequence: int, t: float, utc_ns: int, mode: int, state: JointState) -> None:
        """Inputs of the tick."""
        self.v_sequence[()] = sequence
        self.v_stamp_ns[()] = state.stamp_ns
        self.v_utc_ns[()] = utc_ns
        self.v_t[()] = t
        self.v_mode[()] = mode
        self.v_q_measured[:] = state.q
        self.v_dq_measured[:] = state.dq
        self.v_tau_measured[:] = state.tau

    def fill_law(self, q: Vector, dq: Vector, terms: Terms | None, memory: Memory) -> None:
        """Intermediate results and outputs of the law, and the memory it began with; NaN where it gave nothing."""
        self.v_q[:] = q
        self.v_dq[:] = dq
        self.v_memory[:] = memory.flatten()
        if memory.estimate is not None:
            self.v_theta_arm[: len(memory.estimate.arm)] = memory.estimate.arm
            self.v_theta_object[:] = memory.estimate.object
        has = None if terms is None else _has(terms)
        if has is None or has != self._has:
            for view in self._law_views:
                view[...] = np.nan if has is None else 0.0
            self._has = has
        if terms is not None:
            self._fill_terms(terms)

    def _fill_terms(self, terms: Terms) -> None:
        """Terms that the law does not have stay zero."""
        desired, k, e = terms.desired, terms.kinematics, terms.errors
        self.v_p_object_des[:] = desired.p
        self.v_quat_object_des[:] = desired.quat
        self.v_v_object_des[:] = desired.v
        self.v_a_object_des[:] = desired.a
        self.v_p_object[:] = k.p_object
        self.v_quat_object[:] = k.quat_object
        self.v_v_object[:] = k.v_object
        self.v_e_p[:] = e.e_p
        self.v_e_eta[()] = e.e_eta
        self.v_e_eps[:] = e.e_eps
        self.v_e_v[:] = e.e_v
        self.v_v_object_ref[:] = e.v_ref
        self.v_dv_object_ref[:] = e.dv_ref
        self.v_dq_ref[:] = terms.dq_ref
        self.v_ddq_ref[:] = terms.ddq_ref
        if terms.tau_inertia is not None:
            self.v_tau_inertia[:] = terms.tau_inertia
            self.v_tau_coriolis[:] = terms.tau_coriolis
            self.v_tau_gravity[:] = terms.tau_gravity
        if terms.tau_adaptive is not None:
            self.v_tau_adaptive[:] = terms.tau_adaptive
        self.v_tau_feedback[:] = terms.tau_feedback
        self.v_tau_object[:] = terms.tau_object
        if terms.tau_internal is not None:
            self.v_tau_internal[:] = terms.tau_internal
        if terms.tau_friction is not None:
            self.v_tau_friction[:] = terms.tau_friction
        if terms.tau_posture is not None:
            self.v_tau_posture[:] = terms.tau_posture
        self.v_tau_cmd[:] = terms.tau_cmd
        self.v_wrench_cmd[:] = terms.wrench_cmd
        self.v_wrench_internal[:] = terms.wrench_internal
        self.v_lyapunov[()] = terms.lyapunov
        self.v_sigma_min[()] = terms.sigma_min

    def fill_output(self, flags: int, tau_limited: Vector, tau_sent: Vector) -> None:
        """What left the agent."""
        self.v_flags[()] = flags
        self.v_tau_limited[:] = tau_limited
        self.v_tau_sent[:] = tau_sent

    def fill_timing(self, late_s: float, read_s: float, step_s: float, write_s: float, bus: BusCounters) -> None:
        """Fields that may differ between two runs."""
        self.v_late_s[()] = late_s
        self.v_read_s[()] = read_s
        self.v_step_s[()] = step_s
        self.v_write_s[()] = write_s
        self.v_bus_timeouts[()] = bus.timeouts
        self.v_bus_corrupt[()] = bus.corrupt
        self.v_bus_alerts[()] = bus.alerts
        self.v_bus_retries[()] = bus.retries


def _has(terms: Terms) -> tuple[bool, ...]:
    """Which of the optional terms there are."""
    return (
        terms.tau_inertia is not None,
        terms.tau_adaptive is not None,
        terms.tau_internal is not None,
        terms.tau_friction is not None,
        terms.tau_posture is not None,
    )
