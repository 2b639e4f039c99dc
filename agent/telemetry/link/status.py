"""Asks the recorder what it has; an answer is there at a later look, or not."""

from __future__ import annotations

from typing import Final

import zenoh

from agent.telemetry.link.session import has_link
from agent.telemetry.link.wire import RecorderStatus, unpack_status
from agent.telemetry.row import topics

_TIMEOUT_S: Final = 2.0
_GIVEN_UP_S: Final = 2.0 * _TIMEOUT_S  # of a question that Zenoh should have ended
_STATUS_BYTES_MAX: Final = 1 << 16


class StatusQuery:
    """One question at a time, at most every `period_s`."""

    def __init__(self, session: zenoh.Session, cell: str, seal: bytes, period_s: float) -> None:
        """`seal` of the recorder that is asked."""
        self._session = session
        self._key = topics.status_key(cell)
        self._seal = seal
        self._period_s = period_s
        self._asked_s = 0.0
        self._replies: zenoh.Handler[zenoh.Reply] | None = None

    def poll(self, now_s: float) -> RecorderStatus | None:
        """Its status when an answer has come; ask again when it is time."""
        status = None
        if self._replies is not None:
            try:
                status = _status_in(self._replies.try_recv(), self._seal)
            except zenoh.ZError:  # nobody there, or all answers taken
                self._replies = None
            if now_s - self._asked_s > _GIVEN_UP_S:  # Zenoh has not ended it: rather ask anew than wait for ever
                self._replies = None
        if self._replies is None and now_s - self._asked_s >= self._period_s and has_link(self._session):
            self._asked_s = now_s
            self._replies = self._session.get(self._key, timeout=_TIMEOUT_S)
        return status


def _status_in(reply: zenoh.Reply | None, seal: bytes) -> RecorderStatus | None:
    if reply is None or reply.ok is None or len(reply.ok.payload) > _STATUS_BYTES_MAX:
        return None
    try:
        return unpack_status(reply.ok.payload.to_bytes(), seal)
    except ValueError:
        return None  # not our recorder's answer: as if nobody had answered
