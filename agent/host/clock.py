"""How far this host's clock may be off UTC: as chrony says, else as the kernel's discipline of the clock says.

A file can speak for both (a process without the right to ask): JSON with `utc_ns`, `synchronised` and `max_error_s`.
An old one says nothing.
"""

from __future__ import annotations

import ctypes
import json
import math
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

STATE_FILE = Path("/run/coop/clock.json")
STALE_S = 5.0
CHRONY_TIMEOUT_S = 1.0
_STA_UNSYNC = 0x40
_CHRONY_FIELDS = 14  # of `chronyc -c tracking`
_SYSTEM_TIME, _ROOT_DELAY, _ROOT_DISPERSION, _LEAP_STATUS = 4, 10, 11, 13


def bound_text(error_s: float) -> str:
    """By how much a clock may be off, in the unit that a person reads."""
    return f"{error_s:.3g} s" if error_s >= 1.0 else f"{error_s * 1e3:.3g} ms"


@dataclass(frozen=True, slots=True)
class ClockState:
    """What is known of the clock of this host."""

    synchronised: bool
    max_error_s: float  # inf: nobody knows

    @property
    def text(self) -> str:
        """In words."""
        known = "synchronised" if self.synchronised else "not synchronised"
        if math.isinf(self.max_error_s):
            return f"{known}, error not known"
        return f"{known}, error at most {bound_text(self.max_error_s)}"

    def encode(self, utc_ns: int) -> bytes:
        """As the file that `read_file` reads."""
        error_s = None if math.isinf(self.max_error_s) else self.max_error_s
        return json.dumps({"utc_ns": utc_ns, "synchronised": self.synchronised, "max_error_s": error_s}).encode()


UNKNOWN = ClockState(synchronised=False, max_error_s=math.inf)


class _Timex(ctypes.Structure):
    """First fields of the kernel's struct timex, with room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint), ("offset", ctypes.c_long), ("freq", ctypes.c_long), ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long), ("status", ctypes.c_int), ("rest", ctypes.c_char * 256),
    )  # fmt: skip


def read_clock(file: Path | None = None) -> ClockState:
    """What is known now: by the file alone when one is given, else by chrony, else by the kernel."""
    if file is not None:
        return read_file(file)
    return _chrony() or read_kernel()


def read_file(file: Path) -> ClockState:
    """What the file says; nothing when it is missing, makes no sense, is STALE_S old or of the future."""
    try:
        content = json.loads(file.read_bytes())
        age_s = (time.time_ns() - int(content["utc_ns"])) * 1e-9
        error_s = float(content["max_error_s"])
        synchronised = content["synchronised"] is True
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return UNKNOWN
    if abs(age_s) > STALE_S or not error_s >= 0.0:
        return UNKNOWN
    return ClockState(synchronised, error_s)


def read_kernel() -> ClockState:
    """By adjtimex, which may be asked by anybody; its bound grows by itself while nobody corrects the clock."""
    buffer = _Timex()
    if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(buffer)) < 0:
        return UNKNOWN
    return ClockState(not buffer.status & _STA_UNSYNC, buffer.maxerror * 1e-6)


def _chrony() -> ClockState | None:
    try:
        done = subprocess.run(
            ["chronyc", "-n", "-c", "tracking"], capture_output=True, text=True, timeout=CHRONY_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return from_tracking(done.stdout) if done.returncode == 0 else None


def from_tracking(line: str) -> ClockState | None:
    """The bound of `chronyc -c tracking`: |offset| + root dispersion + half the root delay; None: not such a line."""
    fields = line.strip().split(",")
    if len(fields) < _CHRONY_FIELDS:
        return None
    try:
        offset_s, delay_s, dispersion_s = (float(fields[i]) for i in (_SYSTEM_TIME, _ROOT_DELAY, _ROOT_DISPERSION))
    except ValueError:
        return None
    synchronised = fields[_LEAP_STATUS] != "Not synchronised"
    return ClockState(synchronised, abs(offset_s) + dispersion_s + 0.5 * delay_s)
