"""The recorder's inbox gives everything that has come at once, in order, and does not wait for what presses."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from agent.telemetry.link import wire
from agent.telemetry.link.inbox import BATCH_BYTES_MAX, INBOX_BYTES_MAX, MUCH_BYTES, Inbox, Message
from agent.view import live

KEY = "coop/paper/left/state"
HEADER = bytes(wire.HEADER_BYTES)
FOR_EVER_S = 3600.0  # whoever waits so long is ended by pytest-timeout


class Bytes(bytes):
    def to_bytes(self) -> bytes:  # type: ignore[override]
        return bytes(self)


@dataclass
class Sample:
    """As Zenoh hands them over."""

    payload: Bytes
    key_expr: str = KEY
    attachment: Bytes = Bytes(HEADER)  # noqa: RUF009 (bytes do not change)


def inbox_with(*payloads: bytes) -> Inbox:
    inbox = Inbox(frozenset({KEY}))
    put(inbox, *payloads)
    return inbox


def put(inbox: Inbox, *payloads: bytes) -> None:
    for payload in payloads:
        sample: Any = Sample(Bytes(payload))
        inbox.put(sample)


def messages(*payloads: bytes) -> list[Message]:
    return [(KEY, payload, HEADER) for payload in payloads]


def test_what_came_is_given_at_once_and_in_order() -> None:
    inbox = inbox_with(b"a", b"b", b"c")
    assert inbox.take(2) == messages(b"a", b"b")
    assert inbox.take(2) == messages(b"c")
    assert inbox.take(2) == []


def test_the_end_of_a_source_is_not_waited_behind() -> None:
    assert inbox_with(b"a", b"").take(64, FOR_EVER_S) == messages(b"a", b"")


def test_much_is_not_waited_behind() -> None:
    each = bytes(BATCH_BYTES_MAX)
    count = MUCH_BYTES // BATCH_BYTES_MAX
    assert len(inbox_with(*[each] * count).take(64, FOR_EVER_S)) == count


def test_what_was_left_is_not_waited_behind_and_then_nothing_presses() -> None:
    inbox = inbox_with(b"a", b"", b"c")
    assert inbox.take(2, FOR_EVER_S) == messages(b"a", b"")
    assert inbox.take(2, FOR_EVER_S) == messages(b"c")
    put(inbox, b"d")
    assert not inbox._pressing


def test_an_end_wakes_whoever_waits() -> None:
    inbox, taken = inbox_with(), list[Message]()
    waiting = threading.Thread(target=lambda: taken.extend(inbox.take(64, FOR_EVER_S)), daemon=True)
    waiting.start()
    put(inbox, b"a", b"")
    waiting.join()
    assert taken + inbox.take(64) == messages(b"a", b"")


def test_room_that_was_taken_is_there_again() -> None:
    inbox, each = inbox_with(), bytes(BATCH_BYTES_MAX)
    for _ in range(INBOX_BYTES_MAX // BATCH_BYTES_MAX + 1):
        put(inbox, each)
        assert len(inbox.take(1)) == 1
    assert not inbox.overflowed


def test_a_batch_of_lockstep_is_let_in_and_seen_live() -> None:
    assert min(BATCH_BYTES_MAX, live._PAYLOAD_BYTES_MAX) >= wire.LOCKSTEP_BATCH_BYTES_MAX
