"""The log records: one table per message gives its numpy layout, its packed form and its ROS 2 definition.

A ROS 2 message of fixed-size fields has a constant CDR layout, so a numpy row *is* the encoded message.  A string or an
array of variable length would move every field behind it, so the table knows numbers and fixed arrays alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_JOINTS: Final = 7  # arms with fewer joints leave the rest at zero
MAX_ARMS: Final = 8
ARM_PARAMETERS: Final = MAX_JOINTS * 16  # per joint: 10 inertial, rotor inertia, 5 of friction
OBJECT_PARAMETERS: Final = 10
MEMORY_ARRAYS, MEMORY_REST = 10, 79  # of agent.control.memory.Memory: joint arrays, and what stands behind them
MEMORY_LENGTH: Final = MEMORY_ARRAYS * MAX_JOINTS + MEMORY_REST

BUS_COUNTERS: Final = ("bus_timeouts", "bus_corrupt", "bus_alerts", "bus_retries")  # since the bus was opened

CDR_LITTLE_ENDIAN: Final = 0x00000100  # the encapsulation header 00 01 00 00, read as a little-endian u4

_NUMPY_OF_ROS: Final = {"uint64": "<u8", "int64": "<i8", "float64": "<f8", "uint32": "<u4"}
_STRUCT_OF_ROS: Final = {"uint64": "Q", "int64": "q", "float64": "d", "uint32": "I"}


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a record: its type, length (0 = scalar), unit and meaning."""

    name: str
    ros_type: str
    length: int
    unit: str
    doc: str
    timing: bool = False  # differs between two runs of the same cell; excluded when runs are compared

    @property
    def numpy_code(self) -> str:
        """Numpy's name of its type."""
        return _NUMPY_OF_ROS[self.ros_type]

    @property
    def struct_code(self) -> str:
        """The same for the module struct."""
        return _STRUCT_OF_ROS[self.ros_type]


def _f(name: str, length: int, unit: str, doc: str, *, timing: bool = False) -> Field:
    return Field(name, "float64", length, unit, doc, timing)


J: Final = MAX_JOINTS

AGENT_FIELDS: Final[tuple[Field, ...]] = (
    Field("sequence", "uint64", 0, "", "row number, without gaps as long as no row is lost"),
    Field("stamp_ns", "int64", 0, "ns", "driver clock when the joints were sampled"),
    Field("utc_ns", "int64", 0, "ns", "UTC at the same instant, mapped once at start", timing=True),
    Field("mode", "uint32", 0, "", "agent.modes.Mode"),
    Field("flags", "uint32", 0, "", "agent.safety.Flag bits of this tick"),
    Field("joint_count", "uint32", 0, "", "joints in use; the rest of each joint array is zero"),
    Field("config_id", "uint32", 0, "", "first 32 bits of the cell's fingerprint"),
    _f("t", 0, "s", "time since the trajectory's zero"),
    _f("q_measured", J, "rad", "joint positions as the servos report them"),
    _f("dq_measured", J, "rad/s", "joint velocities as the servos report them"),
    _f("tau_measured", J, "N·m", "joint torques estimated from current; NaN where a servo cannot tell"),
    _f("q", J, "rad", "joint positions the law used"),
    _f("dq", J, "rad/s", "joint velocities the law used"),
    _f("p_object_des", 3, "m", "desired object position p_O,d, world"),
    _f("quat_object_des", 4, "", "desired object attitude ξ_O,d, scalar first"),
    _f("v_object_des", 6, "m/s, rad/s", "desired object twist, linear first, world axes"),
    _f("a_object_des", 6, "m/s², rad/s²", "desired object acceleration, world axes"),
    _f("p_object", 3, "m", "object position by this arm's own kinematics"),
    _f("quat_object", 4, "", "object attitude by this arm's own kinematics"),
    _f("v_object", 6, "m/s, rad/s", "object twist by this arm's own kinematics"),
    _f("e_p", 3, "m", "position error p_O − p_O,d"),
    _f("e_eta", 0, "", "scalar part of the attitude error quaternion"),
    _f("e_eps", 3, "", "vector part of the attitude error quaternion"),
    _f("e_v", 6, "m/s, rad/s", "velocity error v_O − v_O^r"),
    _f("v_object_ref", 6, "m/s, rad/s", "reference twist v_O^r"),
    _f("dv_object_ref", 6, "m/s², rad/s²", "its time derivative"),
    _f("dq_ref", J, "rad/s", "reference joint velocity"),
    _f("ddq_ref", J, "rad/s²", "reference joint acceleration"),
    _f("tau_inertia", J, "N·m", "B(q) ddq_ref"),
    _f("tau_coriolis", J, "N·m", "C(q, dq) dq_ref"),
    _f("tau_gravity", J, "N·m", "g(q)"),
    _f("tau_adaptive", J, "N·m", "Y_q θ̂ of the adaptive law, which replaces the three terms before"),
    _f("tau_feedback", J, "N·m", "of −k_v e_v − c_i e"),
    _f("tau_object", J, "N·m", "of this arm's share of the object's dynamics"),
    _f("tau_internal", J, "N·m", "of the desired internal wrench"),
    _f("tau_friction", J, "N·m", "friction feed-forward, along the motion: against the joint's friction"),
    _f("tau_posture", J, "N·m", "null-space posture term of a redundant arm"),
    _f("tau_cmd", J, "N·m", "sum of the terms"),
    _f("tau_limited", J, "N·m", "after agent.safety"),
    _f("tau_sent", J, "N·m", "what the driver says it really commanded"),
    _f("wrench_cmd", 6, "N, N·m", "task-space wrench u_i at the end effector, world axes"),
    _f("wrench_internal", 6, "N, N·m", "internal-force part of it"),
    _f("lyapunov", 0, "J", "the part of the Lyapunov function this agent can compute"),
    _f("sigma_min", 0, "", "lower bound of the smallest singular value of the object Jacobian"),
    _f("shift", 6, "m, rad", "of the desired pose, by which this arm has found together with the others"),
    _f("friction_factor", 0, "", "times the friction of its file, which the feed-forward takes this arm to have"),
    _f("unexpected_wrench", 6, "N, N·m", "on this arm beside its load share, at the object, world axes"),
    _f("unexpected", 4, "N, N·m, N, N·m", "sizes of its fast part (force, moment) and of its slow part"),
    _f("memory", MEMORY_LENGTH, "", "what the agent carried into this tick (agent.control.memory)"),
    _f("theta_arm", ARM_PARAMETERS, "", "adaptive arm estimate before this tick"),
    _f("theta_object", OBJECT_PARAMETERS, "", "adaptive object estimate before this tick"),
    _f("tau_bridge", J, "N·m", "in the loop ([hil]): what the driver added for the simulated object; else zero"),
    _f("q_twin", J, "rad", "in the loop: joints of the simulated twin; NaN before it has any; else zero"),
    _f("twin_age_s", 0, "s", "in the loop: age of the twin's state; else zero"),
    _f("late_s", 0, "s", "how late this tick began", timing=True),
    _f("read_s", 0, "s", "duration of the bus read", timing=True),
    _f("step_s", 0, "s", "duration of the control step", timing=True),
    _f("write_s", 0, "s", "duration of the bus write", timing=True),
    *(Field(name, "uint32", 0, "", "cumulative", timing=True) for name in BUS_COUNTERS),
)

PLANT_FIELDS: Final[tuple[Field, ...]] = (
    Field("sequence", "uint64", 0, "", "tick number since the plant's zero"),
    Field("stamp_ns", "int64", 0, "ns", "plant clock"),
    Field("utc_ns", "int64", 0, "ns", "UTC at the same instant", timing=True),
    Field(
        "arm_count",
        "uint32",
        0,
        "",
        f"arms in use; joint arrays have {J} places for each; the rest is zero",
    ),
    Field("config_id", "uint32", 0, "", "first 32 bits of the cell's fingerprint"),
    _f("t", 0, "s", "time since the plant's zero, where it began: before the trajectory's by the wait for the start"),
    _f("p_object", 3, "m", "true position of the object's frame, at the centre of mass as the cell has it, world"),
    _f("quat_object", 4, "", "true object attitude, scalar first"),
    _f("v_object", 6, "m/s, rad/s", "true twist of the object's frame, linear first, world axes"),
    _f("grasp_wrench", MAX_ARMS * 6, "N, N·m", "wrench of each arm on the object at its end effector, world axes"),
    _f("contact_error_m", MAX_ARMS, "m", "drift of each grasp constraint, translation"),
    _f("contact_error_rad", MAX_ARMS, "rad", "drift of each grasp constraint, rotation"),
    _f("slip_m", MAX_ARMS, "m", "how far the pads of each grasp have slipped since it was closed, translation"),
    _f("slip_rad", MAX_ARMS, "rad", "how far the pads of each grasp have slipped since it was closed, rotation"),
    _f("q", MAX_ARMS * J, "rad", "true positions of the controlled joints, arm after arm"),
    _f("dq", MAX_ARMS * J, "rad/s", "true velocities"),
    _f("tau_applied", MAX_ARMS * J, "N·m", "torque that reached the joint after all actuator effects, friction apart"),
    _f("tau_friction", MAX_ARMS * J, "N·m", "friction as it acts on the joint, against the motion"),
    _f("energy", 0, "J", "kinetic plus potential energy of the cell"),
)


@dataclass(frozen=True)
class Layout:
    """A fixed-layout message: table of fields, numpy dtype of the encoded message, ROS 2 definition."""

    ros_name: str  # package/Name
    fields: tuple[Field, ...]

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Packed dtype of one complete CDR message, encapsulation header first.

        CDR aligns each primitive to its size, counted from behind the header; the tables keep every
        8-byte field on a multiple of 8 (checked here), so packed and CDR offsets are the same.
        """
        offset = 0
        names: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [("encapsulation", "<u4")]
        for f in self.fields:
            code = f.numpy_code
            size = np.dtype(code).itemsize
            if offset % size:
                raise AssertionError(f"{self.ros_name}.{f.name} is not aligned to {size} bytes")
            offset += size * max(f.length, 1)
            names.append((f.name, code, (f.length,)) if f.length else (f.name, code))
        return np.dtype(names)

    @property
    def definition(self) -> str:
        """The .msg text for MCAP's `ros2msg` schema encoding, one commented line per field."""
        lines = []
        for f in self.fields:
            kind = f"{f.ros_type}[{f.length}]" if f.length else f.ros_type
            unit = f" [{f.unit}]" if f.unit else ""
            lines.append(f"{kind} {f.name}  # {f.doc}{unit}")
        return "\n".join(lines) + "\n"

    def decode(self, payload: bytes) -> NDArray[np.void]:
        """Rows (k,) of `k` consecutive messages, as a read-only view of the bytes.

        Raises ValueError when the length is not a whole number of messages or a header is wrong.
        """
        rows: NDArray[np.void] = np.frombuffer(payload, dtype=self.dtype)
        if not np.all(rows["encapsulation"] == CDR_LITTLE_ENDIAN):
            raise ValueError(f"{self.ros_name}: not a little-endian CDR message")
        return rows


AGENT_STATE: Final = Layout("coop_msgs/AgentState", AGENT_FIELDS)
PLANT_STATE: Final = Layout("coop_msgs/PlantState", PLANT_FIELDS)
