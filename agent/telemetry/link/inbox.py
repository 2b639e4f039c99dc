"""What the recorder hears, on its way from Zenoh's threads to its own: bounded, and putting in never waits."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Final

import zenoh
import zenoh.ext

from agent.telemetry.link.intake import Rejection
from agent.telemetry.link.wire import HEADER_BYTES
from agent.telemetry.row import topics

INBOX_BYTES_MAX: Final = 256 << 20
BATCH_BYTES_MAX: Final = 1 << 18
MUCH_BYTES: Final = 1 << 20  # so much does not wait to be fetched together with what follows

Message = tuple[str, bytes, bytes]  # key, payload, attachment


class Inbox:
    """Messages of known keys, in the order of their arrival."""

    def __init__(self, keys: frozenset[str]) -> None:
        self._keys = keys
        self._messages: deque[Message] = deque()
        # SimpleQueue waits for ever when a signal comes as its timeout ends (CPython 3.11, measured here).
        self._lock = threading.Condition(threading.Lock())
        self._bytes = 0
        self._pressing = False  # there is much, or the end of something
        self._rejected: Counter[Rejection] = Counter()
        self._refused: Counter[str] = Counter()  # by known key
        self.overflowed = 0

    def put(self, sample: zenoh.Sample) -> None:
        """Runs in a thread of Zenoh's: look at the envelope, keep or count."""
        key, size, attachment = str(sample.key_expr), len(sample.payload), sample.attachment
        why = None
        if key not in self._keys:
            why = Rejection.UNKNOWN_KEY
        elif attachment is None or len(attachment) != HEADER_BYTES:
            why = Rejection.NO_HEADER
        elif size > BATCH_BYTES_MAX:
            why = Rejection.TOO_LARGE
        with self._lock:
            if why is not None:
                self._rejected[why] += 1
                if why is not Rejection.UNKNOWN_KEY:
                    self._refused[key] += 1
                return
            if self._bytes + size > INBOX_BYTES_MAX:
                self.overflowed += 1  # not acknowledged, so its publisher sends it again
                return
            self._bytes += size
        assert attachment is not None
        message = key, sample.payload.to_bytes(), attachment.to_bytes()
        with self._lock:
            self._messages.append(message)
            if not self._pressing and (not size or self._bytes >= MUCH_BYTES):
                self._pressing = True
                self._lock.notify()

    def take(self, most: int, wait_s: float = 0.0) -> list[Message]:
        """The next messages, at most so many: what has come when `wait_s` is over, or before when it presses.

        Waking for each message costs more than what is in it.
        """
        with self._lock:
            if not self._pressing and wait_s > 0.0:
                self._lock.wait(wait_s)
            taken = [self._messages.popleft() for _ in range(min(most, len(self._messages)))]
            self._bytes -= sum(len(payload) for _, payload, _ in taken)
            self._pressing = bool(self._messages)
        return taken

    def rejected(self) -> Counter[Rejection]:
        """How many messages were kept out since the counts were taken, by reason."""
        with self._lock:
            return self._rejected.copy()

    def take_refused(self) -> tuple[Counter[Rejection], Counter[str]]:
        """How many messages were kept out, by reason and by key; the counts begin anew."""
        with self._lock:
            taken = self._rejected, self._refused
            self._rejected, self._refused = Counter(), Counter()
        return taken


class Listening:
    """Subscriber and queryable of a recorder, for the time of a `with` block."""

    def __init__(
        self, session: zenoh.Session, cell: str, inbox: Inbox, status: Callable[[], bytes],
        missed: Callable[[zenoh.ext.Miss], None],
    ) -> None:  # fmt: skip
        key = topics.status_key(cell)
        self._queryable = session.declare_queryable(key, lambda query: query.reply(key, status()))
        self._subscriber = zenoh.ext.declare_advanced_subscriber(
            session,
            topics.cell_keys(cell),
            inbox.put,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            recovery=zenoh.ext.RecoveryConfig(heartbeat=True),  # type: ignore[call-arg]
        )
        self._listener = self._subscriber.sample_miss_listener(missed)

    def __enter__(self) -> Listening:
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.undeclare()  # type: ignore[no-untyped-call]
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
