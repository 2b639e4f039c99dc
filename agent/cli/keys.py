"""Keys of a terminal as orders for a log that is played, and where it stands in one line; without a terminal, nothing.

The terminal gives every key at once and shows none while this is in use, and is as it was afterwards.  Ctrl-C stays
what it is.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from agent.telemetry.link.playhead import Order

if TYPE_CHECKING:
    from agent.telemetry.link.playhead import Playhead

KEYS: Final[dict[bytes, Order]] = {
    b" ": Order.PAUSE, b".": Order.STEP, b"\x1b[D": Order.BACK, b"\x1b[C": Order.AHEAD, b"\x1bOD": Order.BACK,
    b"\x1bOC": Order.AHEAD, b"h": Order.BACK, b"l": Order.AHEAD, b"0": Order.BEGIN, b"+": Order.FASTER,
    b"-": Order.SLOWER, b"q": Order.QUIT,
}  # fmt: skip
HELP: Final = "space pause, . step, ← → 5 s, 0 begin, + - speed, q quit"
_ESCAPE: Final = b"\x1b"
_LONGEST: Final = max(map(len, KEYS))


class Keyboard:
    """The terminal on standard input, for the time of a `with` block."""

    def __init__(self) -> None:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._before: list[Any] | None = None
        self._typed = b""
        self._shown = ""

    def __enter__(self) -> Self:
        if self._fd is not None:
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._fd is not None and self._before is not None:
            with suppress(termios.error):  # the terminal has gone
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
            self._before = None
        if self._shown:
            sys.stderr.write("\n")
            self._shown = ""

    @property
    def present(self) -> bool:
        """Whether there is somebody who can type."""
        return self._fd is not None

    def orders(self) -> list[Order]:
        """What was typed since the last call; keys without a meaning are left out.  Never waits."""
        if self._fd is None:
            return []
        while select.select([self._fd], [], [], 0.0)[0]:
            try:
                typed = os.read(self._fd, 64)
            except OSError:  # the terminal has gone
                typed = b""
            if not typed:
                self._fd = None
                break
            self._typed += typed
        found, self._typed = orders_of(self._typed)
        return found

    def show(self, head: Playhead) -> None:
        """Where it stands, over the line before."""
        if self._fd is None or not sys.stderr.isatty():
            return
        state = "paused " if head.paused else ""
        line = f"{min(head.at_s, head.length_s):8.2f} s of {head.length_s:.2f} s  {head.speed:g}x  {state}"
        if line != self._shown:
            sys.stderr.write(f"\r{line}\x1b[K")
            sys.stderr.flush()
            self._shown = line


def orders_of(typed: bytes) -> tuple[list[Order], bytes]:
    """The orders in what was typed, and the beginning of a key that has not come whole."""
    found = []
    while typed:
        key = next((key for key in KEYS if typed.startswith(key)), None)
        if key is not None:
            found.append(KEYS[key])
            typed = typed[len(key) :]
        elif typed.startswith(_ESCAPE) and any(key.startswith(typed) for key in KEYS):
            break
        else:
            typed = typed[1:]
    return found, typed[-_LONGEST:]
