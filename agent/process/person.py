"""Somebody who stands beside emulated arms and says the next word once all of them are ready for it.

What `coop guide` asks a person to do is done here by the same words over the same sockets.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from agent.modes import Mode
from agent.operator.ask import ask_arms
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.operator.words import start_together
from agent.process.common_start import say

AGAIN_S = 0.1
IN_NS = 500_000_000  # from a word about an instant to that instant
SILENT_S = 0.5

# The next word of a whole session, by the mode that all arms are in; behind PARK it is over.
NEXT: Mapping[Mode, Verb] = {
    Mode.REST: Verb.APPROACH,
    Mode.APPROACH: Verb.GRASP,
    Mode.READY: Verb.START,
    Mode.HOLD: Verb.LOWER,
    Mode.LOWER: Verb.RELEASE,
    Mode.RELEASE: Verb.PARK,
}
# Words that an arm which was not done is told again, whatever the others do; the order of a session.
_EACH_BY_ITSELF = frozenset({Verb.APPROACH, Verb.GRASP, Verb.RELEASE, Verb.PARK})
_WAY = (
    Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.RELEASE, Mode.PARK
)  # fmt: skip

# The way out of a session that is given up.
_BACK: Mapping[Mode, Verb] = {
    Mode.READY: Verb.STOP,
    Mode.TRACK: Verb.STOP,
    Mode.HOLD: Verb.RELEASE,
    Mode.LOWER: Verb.RELEASE,
    Mode.RELEASE: Verb.PARK,
    Mode.APPROACH: Verb.PARK,
    Mode.HALT: Verb.RELEASE,
    Mode.REST: Verb.RELEASE,
}


class Person:
    """Says word after word; `trouble` says why it went no further."""

    def __init__(
        self, arms: Mapping[str, Sequence[Path]], fingerprint: str, tell: Callable[[str], None] = lambda _: None,
        common_start: Path | None = None,
    ) -> None:  # fmt: skip
        """arms: control sockets by arm; tell: what is said and why; common_start: the file to say it in."""
        self.trouble = ""
        self._arms = arms
        self._fingerprint = fingerprint
        self._tell = tell
        self._common_start = common_start
        self._parked = False
        self._said: Verb | None = None
        self._next_s = 0.0

    def look(self) -> None:
        """Ask all arms how they are, and say what is next; some milliseconds, at most every AGAIN_S."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + AGAIN_S
        heard = ask_arms(self._arms, Request(Verb.STATUS), SILENT_S)
        replies = {arm: one for arm, one in heard.items() if isinstance(one, Reply)}
        modes = {Mode[one.mode] for one in replies.values()}
        stopped = {arm: one.reason for arm, one in replies.items() if one.mode == "HALT" or one.reason}
        if self.trouble or stopped:
            self._give_up(stopped, {arm: Mode[one.mode] for arm, one in replies.items()})
            return
        if len(replies) < len(heard):
            return  # beginning, or over
        self._parked = self._parked or Mode.PARK in modes
        behind = min(modes, key=self._how_far)
        verb = self._word(behind)
        if verb is not None and (len(modes) == 1 or verb in _EACH_BY_ITSELF):
            self._say(verb, [arm for arm, one in replies.items() if one.mode == behind.name])

    def _how_far(self, mode: Mode) -> int:
        if mode is Mode.REST and self._parked:
            return len(_WAY)
        return _WAY.index(mode) if mode in _WAY else len(_WAY)

    def _word(self, mode: Mode) -> Verb | None:
        if mode is Mode.REST and self._parked:
            return Verb.RELEASE
        return NEXT.get(mode)

    def _say(self, verb: Verb, arms: Sequence[str]) -> None:
        if verb is not self._said:
            self._tell(verb.value)
            self._said = verb
        meant = {arm: self._arms[arm] for arm in arms}
        if verb not in (Verb.START, Verb.LOWER):
            ask_arms(meant, Request(verb, self._fingerprint), SILENT_S)
            return
        request = Request(verb, self._fingerprint, time.time_ns() + IN_NS)
        with contextlib.suppress(ControlError):  # no arm moves then, and it is said again
            start_together(meant, request, SILENT_S)
            if verb is Verb.START and self._common_start is not None:
                say(self._common_start, request.start_utc_ns)
            self._next_s = time.monotonic() + 2e-9 * IN_NS

    def _give_up(self, stopped: Mapping[str, str], modes: Mapping[str, Mode]) -> None:
        """Stop everybody, then have each arm let go and come back: nothing can fall that is emulated."""
        if not self.trouble:
            self.trouble = "; ".join(f"{arm}: {reason or 'stopped'}" for arm, reason in stopped.items())
            self._tell(f"stop: {self.trouble}")
            ask_arms(self._arms, Request(Verb.STOP), SILENT_S)
            return
        for arm, mode in modes.items():
            verb = _BACK.get(mode)
            if verb is not None:
                ask_arms({arm: self._arms[arm]}, Request(verb, self._fingerprint), SILENT_S)
