"""A command ends at Ctrl-C, SIGTERM and SIGHUP, also where what it is in loses the KeyboardInterrupt that they become.

Python drops an exception that comes in a callback of a weak reference, and what a library in C++ is given while one
comes it calls a wrong argument.  So the stop is remembered, and asked for again where it was dropped.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType
from typing import Final

AGAIN_S: Final = 0.5  # after which a stop that was dropped comes again
_heard = list[int]()  # signals


def hear() -> None:
    """Have SIGINT, SIGTERM and SIGHUP end a command as KeyboardInterrupt, which tidies up, unless it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _interrupt)
    sys.unraisablehook = _unraisable


def hear_ctrl_z() -> None:
    """Have Ctrl-Z end a command as Ctrl-C does: suspended, one that moves an arm would watch over it no more."""
    if signal.getsignal(signal.SIGTSTP) is signal.SIG_DFL:
        signal.signal(signal.SIGTSTP, _interrupt)


def heard() -> bool:
    """Whether such a stop has come, whatever became of it."""
    return bool(_heard)


def _interrupt(number: int, frame: FrameType | None) -> None:
    del frame
    _heard.append(number)
    raise KeyboardInterrupt


def _unraisable(dropped: sys.UnraisableHookArgs) -> None:
    """Say nothing of a stop that was dropped, which comes again."""
    if dropped.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(dropped)
        return
    again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
    again.daemon = True
    again.start()
