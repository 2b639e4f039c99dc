"""Real-time scheduling and quiet memory for the control thread, or a refusal that says what the host does not give."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path

from drivers.interface import Refusal

_MCL_CURRENT, _MCL_FUTURE = 1, 2
TIMER_SLACK_NS = 1_000
_PR_SET_TIMERSLACK = 29
WITHOUT = "leave out --priority (real arms are then moved with --allow-no-realtime alone)"


class RealtimeError(Refusal):
    """The host does not give what the control loop was asked to run with."""

    exit_code = 8


@dataclass(frozen=True, slots=True)
class RealTime:
    """What a process runs with."""

    policy: str
    priority: int
    locked_bytes: int

    @property
    def real(self) -> bool:
        """Whether nothing of normal priority can hold it up."""
        return self.policy in ("SCHED_FIFO", "SCHED_RR", "SCHED_DEADLINE")

    @property
    def text(self) -> str:
        """In words."""
        return f"{self.policy} {self.priority}, {self.locked_bytes / 2**20:.0f} MB of memory locked"


_POLICIES = {
    os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR", os.SCHED_BATCH: "SCHED_BATCH",
    os.SCHED_IDLE: "SCHED_IDLE", 6: "SCHED_DEADLINE",
}  # fmt: skip


def granted() -> RealTime:
    """What this process has got, as the kernel says."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    locked_kB = 0
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmLck:"):
            locked_kB = int(line.split()[1])
    return RealTime(_POLICIES.get(policy, f"policy {policy}"), os.sched_getparam(0).sched_priority, locked_kB << 10)


def quiet_memory() -> None:
    """No garbage collection from here on: a pause of the collector is a late torque."""
    gc.collect()
    gc.freeze()
    gc.disable()


def become_realtime(priority: int, without: str = WITHOUT) -> None:
    """SCHED_FIFO with `priority`, memory locked, precise wake-ups.  Raises RealtimeError when one is refused.

    without: how whoever asks for it does without, for the remedy.
    Memory is locked first, which takes longer than LimitRTTIME leaves a real-time thread that does not sleep.  Helpers
    started later do not inherit it (SCHED_RESET_ON_FORK).
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise RealtimeError(
            "locked memory", found=os.strerror(ctypes.get_errno()), expected="all memory locked",
            remedy=f"grant LimitMEMLOCK=infinity (the shipped unit does), or {without}",
        )  # fmt: skip
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (PermissionError, OSError) as error:
        raise RealtimeError(
            "real-time priority", found=error.strerror, expected=f"SCHED_FIFO {priority}",
            remedy=f"grant LimitRTPRIO (the shipped unit does), or {without}",
        ) from error  # fmt: skip
    libc.prctl(_PR_SET_TIMERSLACK, TIMER_SLACK_NS, 0, 0, 0)


def leave_realtime() -> None:
    """Back to the priority of others, for what takes long: writing files, and the end, which frees all memory.

    A user without privileges may do that, but not let helpers inherit again.  A host that refuses keeps it as it is.
    """
    if granted().real:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
