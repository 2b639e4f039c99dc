"""An agent's side of its guard: it borrows the port, is watched, and notices that the guard is gone, or hangs."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from agent.guard.agent_end import AgentEnd
from agent.guard.line import GuardError, Word, close_all
from agent.guard.pulse import Pulse
from agent.guard.vigil import Vigil
from agent.telemetry.row.event import Level
from drivers.interface import Refusal

BUSY_S = 0.6  # that bringing an arm back takes at most
HAND_OVER_AFTER = 100  # cycles of a hold, so that the object is at rest
AGAIN_AFTER = 50  # cycles between two attempts to reach a guard that is gone
CRASHED = 1  # exit code of a process that ends by an error that is no Refusal
UNGUARDED = "no guard: when this process dies, the arm falls limp as soon as its servos' watchdog fires"
GONE, HANGS = "the guard is gone", "the guard hangs"
NOBODY = "nobody takes over should this process end, and the arm falls limp then"
Tell = Callable[[Level, str], None]


class Guarded:
    """The guard of this process.  `poll` once a cycle; `borrow`, `watch` and `leave` alone wait for an answer."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Reach the guard.  Raises GuardError."""
        self._path = path
        self._fingerprint = fingerprint
        self._end: AgentEnd | None = AgentEnd(path, fingerprint)
        self._watch: tuple[tuple[int, ...], dict[str, Any]] | None = None
        self._tell: Tell = lambda *_: None
        self._lent = False
        self._cycles = 0
        self._asked_back = False
        self._pulse: Pulse | None = None
        self._vigil: Vigil | None = None  # over the guard that watches; none over one that has not said yes
        self._new_vigil: Callable[[], Vigil | None] = lambda: None
        self._hangs = False
        self._ending = 0
        self._hands_over = False  # the guard has been told to go on, and has not said yes yet

    @property
    def there(self) -> bool:
        """Whether somebody goes on when this process cannot."""
        return self._has_agreed and not self._hangs

    @property
    def _has_agreed(self) -> bool:
        return self._end is not None and self._watch is not None and not self._asked_back

    @property
    def state(self) -> str:
        """The same in a word."""
        return {"": "watches", HANGS: "hangs", GONE: "gone"}[self.missing]

    @property
    def missing(self) -> str:
        """Why nobody goes on when this process cannot; empty while somebody does."""
        if self.there:
            return ""
        return HANGS if self._has_agreed else GONE

    @property
    def has_lent(self) -> bool:
        """Whether it has lent the port before."""
        return self._lent

    def borrow(self) -> int:
        """Descriptor of the arm's port; a second one is another, for the first was lost.  Raises GuardError."""
        if self._end is None or self._hangs:  # who hangs would have the loop wait for its answer
            raise GuardError(
                f"port from the guard at {self._path}", found="no guard any more" if self._end is None else HANGS,
                expected="one that lends it", remedy="start the guard again",
            )  # fmt: skip
        fds = self._end.ask(Word.PORT, again=self._lent)
        if len(fds) != 1:
            close_all(fds)
            raise GuardError(
                f"port from the guard at {self._path}", found=f"{len(fds)} descriptors", expected="one",
                remedy="start agent and guard from one release",
            )  # fmt: skip
        (fd,) = fds
        self._lent = True
        return fd

    def watch(self, fds: Sequence[int], tell: Tell, vigil: Callable[[], Vigil], **content: Any) -> None:
        """Torque is on: from now on the guard goes on when this process cannot.  Raises GuardError.

        fds: of the ring, of its texts, and of the driver; content: what the guard must know; tell: is told what becomes
        of the guard; vigil: a new one over its pulse.
        """
        self._tell, self._new_vigil = tell, vigil
        self._pulse = Pulse.made()
        self._watch = ((os.pidfd_open(os.getpid()), self._pulse.fileno(), *fds), content)
        if self._end is not None:
            self._end.ask(Word.WATCH, self._watch[0], **content)
            self._vigil = vigil()

    def busy(self) -> None:
        """No row will come for a moment, and that is all right."""
        self._say(Word.BUSY, for_s=BUSY_S)

    def poll(self, *, ending: bool = False, why: str = "") -> str:
        """What has been found wrong with the guard in this cycle; in the place of a dead one it looks for another.

        ending: this process was asked to end, why says by what, and holds: some cycles later it asks the guard to go
        on, and does not return once that has said yes.
        """
        if ending:
            self._ending += 1
            if self._ending >= HAND_OVER_AFTER and not self._hands_over:
                self._hands_over = self._has_agreed and self._say(Word.TAKE, why=why)
        if self._end is None:
            self._cycles += 1
            if self._cycles % AGAIN_AFTER == 0:
                self._look_for_another()
            return ""
        heard = self._end.heard()
        if heard is None:
            self._end.close()
            return self._lost()
        to = heard.get("to")
        if heard and self._asked_back and to in (None, Word.WATCH):
            if heard.get("ok"):
                self._asked_back = False
                self._vigil = self._new_vigil()
                self._tell(Level.INFO, "the guard is back and watches")
            else:
                self._tell(Level.ERROR, f"the guard is back and does not watch: found {heard.get('found')}")
        elif self._hands_over and heard.get("ok") and to in (None, Word.TAKE):
            self._tell(Level.INFO, "hands the arm to the guard, as it was asked to end")
            self._end_process(0)
        return self._found_hanging()

    def _found_hanging(self) -> str:
        """Looks at the guard's pulse: a guard that hangs is told of once, and one that works again, too."""
        vigil, pulse = self._vigil, self._pulse
        if vigil is None:
            return ""
        assert pulse is not None
        hangs = vigil.is_stale(time.monotonic_ns(), pulse.count)
        if hangs is self._hangs:
            return ""
        self._hangs = hangs
        if not hangs:
            self._tell(Level.INFO, "the guard works again and watches")
            return ""
        self._tell(Level.ERROR, f"the guard hangs (no look for {vigil.still_ns * 1e-6:.0f} ms): {NOBODY}")
        return HANGS

    def leave(self) -> None:
        """Torque is off: the guard lets go of the ring.  Safe twice, and without a guard."""
        if self._end is not None and self._watch is not None:
            try:
                self._end.ask(Word.LEAVE)
            except GuardError as error:
                self._tell(Level.WARN, str(error))
        if self._end is not None:
            self._end.close()
            self._end = None
        if self._watch is not None:
            os.close(self._watch[0][0])
            self._watch = self._vigil = None
        if self._pulse is not None:
            self._pulse.close()

    def give_up(self, error: BaseException) -> None:
        """The loop has failed: end this process at once, torque on, for the guard.  Returns where there is none."""
        if not self.there:
            return
        self._tell(Level.ERROR, f"{type(error).__name__}: {error}; the guard goes on")
        with suppress(OSError):  # nobody may listen any more, to this as to what is flushed
            traceback.print_exception(error)
        self._end_process(error.exit_code if isinstance(error, Refusal) else CRASHED)

    @staticmethod
    def _end_process(code: int) -> NoReturn:
        """Nothing that an orderly end does: it would switch the torque off."""
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(code)

    def _say(self, word: Word, **content: Any) -> bool:
        """Tell the guard, if there is one; False where it could not be told."""
        try:
            if self._end is not None:
                self._end.say(word, **content)
        except GuardError:
            return False
        return True

    def _lost(self) -> str:
        self._end, self._vigil, self._hangs, self._hands_over = None, None, False, False
        self._tell(Level.ERROR, f"the guard is gone: {NOBODY}")
        return GONE

    def _look_for_another(self) -> None:
        try:
            end = AgentEnd(self._path, self._fingerprint, patience_s=0.0)
            if self._watch is not None:
                end.say(Word.WATCH, self._watch[0], **self._watch[1])
        except GuardError:
            return
        self._end, self._asked_back = end, self._watch is not None
