"""What `/diagnostics` says of an arm (its mode, what is wrong, the figures behind that) and of each of its servos."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import IntEnum
from typing import Final

import numpy as np

from agent.log.cdr import CdrTemplate, stamp_of
from agent.log.standard import Rows
from agent.modes import Mode
from agent.safety import Flag
from agent.telemetry.row.health import QUANTITIES
from agent.telemetry.row.health import Health as ServoTexts
from agent.telemetry.row.sample import BUS_COUNTERS
from drivers.dynamixel.servo.codes import HardwareError

TOPIC: Final = "/diagnostics"
ROS_NAME: Final = "diagnostic_msgs/DiagnosticArray"
_EVERY_NS: Final = 1_000_000_000
_FIGURES: Final = ("t", "sigma_min", "late_s", "step_s", *BUS_COUNTERS)
_MODES: Final = {mode.value: mode.name for mode in Mode}
_WRONG: Final = (
    Flag.NOT_FINITE | Flag.SINGULAR | Flag.STALE | Flag.OFF_TRACK | Flag.UNEXPECTED | Flag.DAMPED | Flag.BLIND
    | Flag.RESUMED | Flag.GAP | Flag.GENTLE
)  # fmt: skip


class Health(IntEnum):
    """How an arm is; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


class Diagnostics:
    """Messages of one arm: one a second, and one whenever its mode or what is wrong changes."""

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self._last: tuple[int, int, int] | None = None

    def messages(self, rows: Rows) -> Iterator[tuple[int, bytes]]:
        """UTC in ns and the message, for those of the rows that are worth one."""
        wrong = (rows["flags"] & np.uint32(_WRONG)).tolist()
        for i, utc_ns, mode, flags in zip(
            range(len(rows)), rows["utc_ns"].tolist(), rows["mode"].tolist(), wrong, strict=True
        ):
            now = (utc_ns // _EVERY_NS, mode, flags)
            if now != self._last:
                self._last = now
                yield utc_ns, message(self._arm, rows[i])


def message(arm: str, row: np.void) -> bytes:
    """diagnostic_msgs/DiagnosticArray of one row."""
    mode, wrong = int(row["mode"]), Flag(int(row["flags"])) & _WRONG
    name = _MODES.get(mode, f"mode {mode}")
    values = {"mode": name, "flags": _names(Flag(int(row["flags"]))), "e_p_m": f"{np.linalg.norm(row['e_p']):.6g}"}
    values |= {key: f"{row[key]:.6g}" for key in _FIGURES}
    out = CdrTemplate().given("<u4", stamp_of(int(row["utc_ns"]))).string("").length(1)
    out.given("u1", [health(mode, wrong)]).string(f"arm {arm}")
    out.string(f"{name} {_names(wrong)}".strip()).string(arm).length(len(values))
    for key, value in values.items():
        out.string(key).string(value)
    return out.message


def servo_message(arm: str, told: ServoTexts) -> bytes:
    """diagnostic_msgs/DiagnosticArray of an arm's servos, one status each; a servo with an error bit is an error."""
    out = CdrTemplate().given("<u4", stamp_of(told.utc_ns)).string("").length(len(told.servo_id))
    for i, (servo, joint, bits) in enumerate(zip(told.servo_id, told.joint, told.error_bits, strict=True)):
        names = " ".join(bit.name for bit in HardwareError if bits & bit and bit.name) or f"error bits {bits:#04x}"
        out.given("u1", [Health.ERROR if bits else Health.OK]).string(f"arm {arm}: servo {servo} {joint}")
        out.string(names if bits else "no error").string(arm)
        values = {name: getattr(told, name)[i] for name in QUANTITIES} | {"error_bits": bits}
        known = {key: f"{value:.6g}" for key, value in values.items() if not math.isnan(value)}
        out.length(len(known))
        for key, value in known.items():
            out.string(key).string(value)
    return out.message


def health(mode: int, wrong: Flag) -> Health:
    """A fault is an error; a hold, and whatever is wrong in another mode, a warning."""
    if mode == Mode.FAULT:
        return Health.ERROR
    return Health.WARN if wrong or mode in (Mode.HOLD, Mode.LOWER, Mode.STAND) else Health.OK


def _names(flags: Flag) -> str:
    return " ".join(flag.name or "" for flag in flags)
