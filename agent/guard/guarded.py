"""An agent's side of its guard: it borrows the port, is watched, and notices within a cycle that the guard is gone."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from agent.guard.agent_end import AgentEnd
from agent.guard.line import GuardError, Word
from agent.telemetry.row.event import Level
from drivers.interface import Refusal

BUSY_S = 0.6  # that bringing an arm back takes at most
HAND_OVER_AFTER = 100  # cycles of a hold, so that the object is at rest
AGAIN_AFTER = 50  # cycles between two attempts to reach a guard that is gone
CRASHED = 1  # exit code of a process that ends by an error that is no Refusal
UNGUARDED = "no guard: when this process dies, the arm falls limp as soon as its servos' watchdog fires"
Tell = Callable[[Level, str], None]


class Guarded:
    """The guard of this process.  `poll` once a cycle; nothing but `borrow` and `watch` waits for an answer."""

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
        self._ending = 0
        self._hands_over = False  # the guard has been told to go on, and has not said yes yet

    @property
    def there(self) -> bool:
        """Whether somebody goes on when this process cannot."""
        return self._end is not None and self._watch is not None and not self._asked_back

    @property
    def state(self) -> str:
        """The same in a word."""
        return "watches" if self.there else "gone"

    @property
    def has_lent(self) -> bool:
        """Whether it has lent the port before."""
        return self._lent

    def borrow(self) -> int:
        """Descriptor of the arm's port; a second one is another, for the first was lost.  Raises GuardError."""
        if self._end is None:
            raise GuardError(
                f"port from the guard at {self._path}", found="no guard any more", expected="one that lends it",
                remedy="start the guard again",
            )  # fmt: skip
        (fd,) = self._end.ask(Word.PORT, again=self._lent)
        self._lent = True
        return fd

    def watch(self, fds: Sequence[int], tell: Tell, **content: Any) -> None:
        """Torque is on: from now on the guard goes on when this process cannot.  Raises GuardError.

        fds: of the ring and of its texts; content: what the guard must know; tell: is told what becomes of the guard.
        """
        self._tell = tell
        self._watch = ((os.pidfd_open(os.getpid()), *fds), content)
        if self._end is not None:
            self._end.ask(Word.WATCH, self._watch[0], **content)

    def busy(self) -> None:
        """No row will come for a moment, and that is all right."""
        self._say(Word.BUSY, for_s=BUSY_S)

    def poll(self, *, ending: bool = False) -> bool:
        """Whether the guard has been found gone in this cycle; looks for a new one later.

        ending: this process was asked to end, and holds: some cycles later it asks the guard to go on, and does not
        return once that has said yes.
        """
        if ending:
            self._ending += 1
            if self._ending >= HAND_OVER_AFTER and not self._hands_over:
                self._hands_over = self.there and self._say(Word.TAKE)
        if self._end is None:
            self._cycles += 1
            if self._cycles % AGAIN_AFTER == 0:
                self._look_for_another()
            return False
        heard = self._end.heard()
        if heard is None:
            self._end.close()
            return self._lost()
        if heard and self._asked_back:
            if heard.get("ok"):
                self._asked_back = False
                self._tell(Level.INFO, "the guard is back and watches")
            else:
                self._tell(Level.ERROR, f"the guard is back and does not watch: found {heard.get('found')}")
        elif heard and self._hands_over and heard.get("ok"):
            self._tell(Level.INFO, "hands the arm to the guard, as it was asked to end")
            self._end_process(0)
        return False

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
            self._watch = None

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
        try:
            if self._end is not None:
                self._end.say(word, **content)
        except GuardError:
            return False
        return self._end is not None

    def _lost(self) -> bool:
        self._end, self._hands_over = None, False
        self._tell(
            Level.ERROR, "the guard is gone: nobody takes over should this process end, and the arm falls limp then"
        )
        return True

    def _look_for_another(self) -> None:
        try:
            end = AgentEnd(self._path, self._fingerprint, patience_s=0.0)
            if self._watch is not None:
                end.say(Word.WATCH, self._watch[0], **self._watch[1])
        except GuardError:
            return
        self._end, self._asked_back = end, self._watch is not None
