"""What the loop tells whoever is around it: why its arm stands, and in a session which words lead back from there."""

from __future__ import annotations

from typing import Final

from agent.around import Surroundings
from agent.modes import Mode
from agent.session import way_back

OBEYS_AGAIN: Final = "its servos had stopped, and obey again"


class Telling:
    """Of one loop; each is left out where nobody asked to be told."""

    def __init__(self, around: Surroundings, *, in_session: bool) -> None:
        self._around = around
        self._in_session = in_session
        self._told_at_rest = ""

    def refused(self, reason: str) -> None:
        """A word that counts for nothing."""
        if self._around.refused is not None:
            self._around.refused(reason)

    def at_rest(self, reason: str) -> None:
        """What is wrong with an arm that rests, once: nothing else comes of it."""
        if reason == self._told_at_rest:
            return
        self._told_at_rest = reason
        if self._around.trouble is not None:
            self._around.trouble(way_back(Mode.REST, reason))

    def resumed(self, mode: Mode, reason: str) -> str:
        """Why an arm stands whose servos had stopped and obey again: nothing is wrong any more with one that rests."""
        if mode is not Mode.REST:
            return reason
        self.at_rest(OBEYS_AGAIN)
        return ""

    def stands(self, mode: Mode, reason: str, *, seen: bool) -> None:
        """Why an arm has stopped in this mode when nobody asked it to; seen: it answers now."""
        if self._around.trouble is not None:
            self._around.trouble(way_back(mode, reason, seen=seen) if self._in_session else reason)
