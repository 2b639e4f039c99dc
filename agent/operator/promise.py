"""What an arm has agreed to and not been given yet: one common instant at a time, known by the token of who asked.

Whoever gives an instant shows the token that the arm agreed to, and does so in time: until then no arm agrees to
another one, and afterwards no arm takes it.  So no arms of a cell take the instants of two operators in opposite order.
"""

from __future__ import annotations

from collections import deque

from agent.operator.ask import REPLY_TIMEOUT_S

HELD_NS = round(2 * REPLY_TIMEOUT_S * 1e9)  # from when the first arm was asked, in which all are asked and told
ASKED_MAX = 64  # tokens that are remembered: nobody takes back what so many others have asked for since


class Promise:
    """Of one arm; instants are those of CLOCK_MONOTONIC, which all on this host share."""

    def __init__(self) -> None:
        self._token = ""
        self._until_ns = 0
        self._asked: deque[str] = deque(maxlen=ASKED_MAX)  # since the last instant that was given
        self._given = ""

    def agree(self, token: str, asked_ns: int, now_ns: int) -> bool:
        """With whoever has this token and began to ask then, and nobody else; False where that cannot be.

        Another one is agreed with, or the time is over already.
        """
        until_ns = min(asked_ns, now_ns) + HELD_NS
        if now_ns >= until_ns or (token != self._token and self._token and now_ns < self._until_ns):
            return False
        self._token, self._until_ns = token, until_ns
        if token not in self._asked:
            self._asked.append(token)
        return True

    def covers(self, token: str, now_ns: int) -> bool:
        """Whether an instant with this token is the one agreed to."""
        return bool(token) and token == self._token and now_ns < self._until_ns

    def give(self) -> None:
        """The instant agreed to has been given."""
        self._given, self._token = self._token, ""
        self._asked.clear()

    def forget(self, token: str = "") -> None:
        """What was agreed with this token, or with anybody."""
        if token in ("", self._token):
            self._token = ""

    def concerns(self, token: str) -> bool:
        """Whether what is taken back with this token was given last, or asked for since; without a token it is."""
        return token in ("", self._given) or token in self._asked
