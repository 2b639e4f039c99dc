"""Real-time scheduling and quiet memory for the control thread, or a refusal that says what the host does not give."""

from __future__ import annotations

import ctypes
import gc
import os

from drivers.interface import Refusal

_MCL_CURRENT, _MCL_FUTURE = 1, 2
TIMER_SLACK_NS = 1_000
_PR_SET_TIMERSLACK = 29


class RealtimeError(Refusal):
    """The host does not give what the control loop was asked to run with."""

    exit_code = 8


def quiet_memory() -> None:
    """No garbage collection from here on: a pause of the collector is a late torque."""
    gc.collect()
    gc.freeze()
    gc.disable()


def become_realtime(priority: int) -> None:
    """SCHED_FIFO with `priority`, memory locked, precise wake-ups.  Raises RealtimeError when one is refused.

    Helpers started later do not inherit it (SCHED_RESET_ON_FORK).
    """
    libc = ctypes.CDLL(None, use_errno=True)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (PermissionError, OSError) as error:
        raise RealtimeError(
            "real-time priority", found=error.strerror, expected=f"SCHED_FIFO {priority}",
            remedy="grant LimitRTPRIO (the shipped unit does), or leave out --priority",
        ) from error  # fmt: skip
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise RealtimeError(
            "locked memory", found=os.strerror(ctypes.get_errno()), expected="all memory locked",
            remedy="grant LimitMEMLOCK=infinity (the shipped unit does), or leave out --priority",
        )  # fmt: skip
    libc.prctl(_PR_SET_TIMERSLACK, TIMER_SLACK_NS, 0, 0, 0)
