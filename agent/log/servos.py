"""Slow quantities of an arm's servos as arrays: one row per health text of the log, about a second apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.row.health import GRIP, LIMITS, Health

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ServoTable:
    """Health of one arm, by time: k instants, m servos in the order of the bus; arrays are read-only.

    `run.servos["left"].temperature_C[:, 2]` is one servo's course over `t`.  NaN where nothing is known or the servo
    senses no such thing: a servo gives either `current_A` or `load`.
    """

    utc_ns: NDArray[np.int64]  # (k,) ascending
    t: Floats  # (k,) s, the trajectory's time as the arm's rows have it
    servo_id: tuple[int, ...]  # (m,)
    joint: tuple[str, ...]  # (m,) that the servo moves; a pair of servos has the same
    temperature_C: Floats  # (k, m)
    voltage_V: Floats  # (k, m)
    current_A: Floats  # (k, m) signed as the servo counts
    load: Floats  # (k, m) share of the largest torque, signed
    error_bits: NDArray[np.uint8]  # (k, m) Hardware Error Status
    temperature_limit_C: Floats  # (k, m) at which the servo switches itself off; this and the rest NaN in older logs
    voltage_min_V: Floats  # (k, m)
    voltage_max_V: Floats  # (k, m)
    stall_current_A: Floats  # (k, m)
    # of the gripper, (k,) each; NaN where it says nothing, and in older logs
    grip_width_m: Floats  # between its fingers
    grip_width_cmd_m: Floats  # that it was told
    grip_force_N: Floats  # of each finger, as its current or PWM lets expect
    grip_force_max_N: Floats  # of each finger, as its effort limit allows

    def __len__(self) -> int:
        return len(self.utc_ns)


def servo_table(texts: Sequence[Health], row_utc_ns: NDArray[np.uint64], row_t: Floats) -> ServoTable:
    """Table of an arm's health texts, each time once; rows (k,) of the arm, at least one, say which time `t` it was."""
    by_time = {text.utc_ns: text for text in texts}
    told = [by_time[utc_ns] for utc_ns in sorted(by_time)]
    joints = {servo: joint for text in told for servo, joint in zip(text.servo_id, text.joint, strict=True)}
    place = {servo: i for i, servo in enumerate(joints)}

    def column(name: str, empty: float) -> Floats:
        out = np.full((len(told), len(place)), empty)
        for row, text in zip(out, told, strict=True):
            row[[place[servo] for servo in text.servo_id]] = getattr(text, name)
        out.flags.writeable = False
        return out

    utc_ns = np.array([text.utc_ns for text in told], np.int64)
    bits = column("error_bits", 0.0).astype(np.uint8)
    arrays = (utc_ns, _times(utc_ns, row_utc_ns.astype(np.int64), row_t), bits)
    for array in arrays:
        array.flags.writeable = False
    return ServoTable(
        utc_ns, arrays[1], tuple(joints), tuple(joints.values()), column("temperature_C", np.nan),
        column("voltage_V", np.nan), column("current_A", np.nan), column("load", np.nan), bits,
        *(column(name, np.nan) for name in LIMITS), *(_gripper(told, name) for name in GRIP),
    )  # fmt: skip


def _gripper(told: Sequence[Health], name: str) -> Floats:
    values = np.array([getattr(text, name) for text in told], np.float64)
    values.flags.writeable = False
    return values


def _times(utc_ns: NDArray[np.int64], row_utc_ns: NDArray[np.int64], row_t: Floats) -> Floats:
    """Each time by the row before it (the first row, for what came earlier): READY counts towards a start not set."""
    before = np.maximum(np.searchsorted(row_utc_ns, utc_ns, side="right") - 1, 0)
    t: Floats = row_t[before] + (utc_ns - row_utc_ns[before]) * 1e-9
    return t
