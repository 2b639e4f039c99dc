"""Which messages of a source to publish next, and again, and how soon to look: bookkeeping without network or clock.

The recorder says which numbers of a source it has; what stays missing is sent again as long as the source holds it.
This stands behind Zenoh's own recovery, which gives up silently when a link is closed at the wrong moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from agent.telemetry.link.coverage import Coverage, Range, count_of
from agent.telemetry.link.source import Source
from agent.telemetry.link.wire import BatchHeader, End, StreamStatus

RESEND_AFTER_S: Final = 1.0  # Zenoh's recovery needs less
RESEND_AFTER_MAX_S: Final = 8.0
RESEND_BATCHES_MAX: Final = 256  # between two signs that they help
LOCKSTEP_PAUSE_S: Final = 0.1  # each look costs the run CPU time
PRESSING_PAUSE_S: Final = 0.005


class Sender:
    """One source on its way to the recorder."""

    def __init__(self, source: Source, *, window: int | None) -> None:
        """`window`: at most so many messages beyond those the recorder has (lockstep); None: no bound (real time)."""
        self._source = source
        self._window = window
        self._next = 0
        self._lost = 0  # vanished before they were published
        self._have = Coverage()  # with the recorder, or gone for good
        self._gone = Coverage()
        self._recorded = Coverage()  # with the recorder, as it said itself
        self._unpublished = Coverage()  # vanished before they were published
        self._end_acknowledged = False
        self._end = End.OPEN
        self._written_at_end = 0
        self._end_sent_s: float | None = None
        self._stuck_since_s = 0.0
        self._patience_s = RESEND_AFTER_S
        self._holes: list[Range] = []  # what the recorder missed at its last answer before the newest that it had
        self._newest_since_s = 0.0  # when it last had a newer one
        self._sweep: int | None = None  # how far what is missing has been sent again; None: that is not going on
        self._until = 0  # where that ends
        self._credit = 0  # batches sent again between two signs of progress; doubles with each
        self._left = 0  # of the credit

    @property
    def published(self) -> int:
        """How many messages were published or are lost."""
        return self._next

    @property
    def lost(self) -> int:
        """How many messages vanished before they could be published."""
        return self._lost

    @property
    def acknowledged(self) -> int:
        """All messages before this number are with the recorder, or lost."""
        missing = self._missing()
        return missing[0][0] if missing else self._next

    @property
    def blocked(self) -> bool:
        """Whether no more may be published before the recorder has more."""
        return self._window is not None and self._next >= self.acknowledged + self._window

    @property
    def ended(self) -> bool:
        """Whether the source has ended and all of it was published."""
        return self._end is not End.OPEN and self._next >= self._written_at_end

    @property
    def complete(self) -> bool:
        """Whether the recorder has everything that can still be had, and the end marker."""
        return self.ended and self._end_acknowledged and not self._missing()

    def new(self, batches_max: int, now_s: float) -> Iterator[tuple[BatchHeader, bytes]]:
        """Return what was not published yet, at most `batches_max` batches, then once the end marker."""
        end = self._source.end
        written = self._source.written
        if end is not End.OPEN and self._end is End.OPEN:
            self._end, self._written_at_end = end, written
        if self._window is not None:
            written = min(written, self.acknowledged + self._window)
        for _ in range(batches_max):
            if self._next >= written:
                break
            block = self._source.read(self._next, min(self._source.batch_max, written - self._next))
            self._lost += block.first - self._next
            self._note_gone(self._next, block.first - 1)
            if block.first > self._next:
                self._unpublished.add(self._next, block.first - 1)
            self._next = block.first + block.count
            if not block.count:
                break
            yield self._header(block.first), block.payload
        if self.ended and self._end_sent_s is None:
            self._end_sent_s = now_s
            yield self._header(self._next), b""

    def on_status(self, status: StreamStatus | None, now_s: float) -> None:
        """Take note of what the recorder has; None when it has nothing of this key.

        What it misses before the newest that it has is lost, or on its way again; what is newer may be on its way.  New
        messages that arrive are so no sign that what is sent again does.
        """
        before = self._have.end
        told = () if status is None or status.source != self._source.source_id else status.have
        self._have = Coverage((*told, *self._gone.ranges))
        self._end_acknowledged = status is not None and status.source == self._source.source_id and status.ended
        self._note_recorded(told)
        recorded, newer = Coverage(told), self._have.end > before
        filled = any(recorded.missing(first, last) != [(first, last)] for first, last in self._holes)
        if newer:
            self._newest_since_s = now_s
        if filled or (newer and not self._holes):
            self._stuck_since_s, self._patience_s = now_s, RESEND_AFTER_S
            self._credit = self._left = min(2 * self._credit, RESEND_BATCHES_MAX)
        self._holes = self._have.missing(self._source.oldest, self._have.end - 1)

    def go_on_alone(self) -> None:
        """Nobody records any more: wait for no answer about what was published, which stays unrecorded."""
        self._note_gone(0, self._next - 1)

    def again(self, batches_max: int, now_s: float) -> Iterator[tuple[BatchHeader, bytes]]:
        """Return what the recorder misses, when it has missed the same for a while; waits longer each time.

        Called again at once it goes on from there, twice as far after every answer that shows it helps: a long history
        goes out as fast as it is taken, and a deaf recorder is not flooded.  While newer ones arrive, those beyond the
        newest that it has are left out: they are on their way.
        """
        missing = self._missing()
        end_missing = self.ended and not self._end_acknowledged
        if not (missing or end_missing):
            self._sweep = None
            self._stuck_since_s, self._patience_s = now_s, RESEND_AFTER_S  # what is published from now on has its time
            return
        if self._sweep is None or not self._left:
            if now_s - self._stuck_since_s < self._patience_s:
                return
            self._stuck_since_s, self._patience_s = now_s, min(2 * self._patience_s, RESEND_AFTER_MAX_S)
            self._sweep, self._credit, self._left = 0, batches_max, batches_max
            arrives = now_s - self._newest_since_s < RESEND_AFTER_S
            self._until = (self._have.end if arrives else self._next) - 1
        missing = [(first, min(last, self._until)) for first, last in missing]
        yield from self._resend(missing, self._sweep, min(batches_max, self._left))
        if end_missing and not self._sweeping:
            yield self._header(self._next), b""

    @property
    def _sweeping(self) -> bool:
        return self._sweep is not None

    def _resend(self, missing: list[Range], after: int, batches: int) -> Iterator[tuple[BatchHeader, bytes]]:
        """What is missing from `after` on, so many batches of it."""
        for start, last in missing:
            first = max(start, after)
            while first <= last:
                if not batches:
                    return
                block = self._source.read(first, min(self._source.batch_max, last + 1 - first))
                self._note_gone(first, min(block.first - 1, last))
                first = self._sweep = block.first + block.count
                batches, self._left = batches - 1, self._left - 1
                if block.count:
                    yield self._header(block.first), block.payload
        self._sweep = None

    def _note_gone(self, first: int, last: int) -> None:
        if first <= last:
            self._gone.add(first, last)
            self._have.add(first, last)

    def _note_recorded(self, have: Sequence[Range]) -> None:
        """It tells of its last ranges alone, and what it has once told it has; one that forgot is another recorder."""
        told = Coverage(have)
        newest = self._recorded.end - 1
        if newest >= 0 and told.missing(newest, newest):
            self._recorded = told
            return
        for first, last in have:
            self._recorded.add(first, last)

    def unrecorded(self) -> int:
        """How many published messages the recorder has not said it has, whether or not they are still there."""
        known = Coverage((*self._recorded.ranges, *self._unpublished.ranges))
        return count_of(known.missing(0, self._next - 1)) if self._next else 0

    def _missing(self) -> list[Range]:
        """Published numbers that the recorder does not have and that are still there."""
        return self._have.missing(self._source.oldest, self._next - 1) if self._next else []

    def _header(self, first: int) -> BatchHeader:
        at_end = self.ended and first >= self._next
        return BatchHeader(
            self._source.source_id,
            first,
            max(self._source.written, first),
            self._lost,
            self._end if at_end else End.OPEN,
        )


class LockstepPauses:
    """How long telemetry in lockstep waits between two looks: until several batches are worth sending.

    It looks again soon while the run waits for an answer of the recorder: because no more rows may be on their way, or
    because all of them are.  While nothing moves the pause grows again.
    """

    def __init__(self, burst: int) -> None:
        """`burst`: batches that are sent at most between two looks."""
        self._burst = burst
        self._before = (0, 0)
        self._pause_s = PRESSING_PAUSE_S

    def after(self, sent: int, rows: Sender) -> float:
        """Seconds to wait after so many batches were sent."""
        if sent >= self._burst:
            return 0.0
        if not (rows.blocked or rows.ended):
            return LOCKSTEP_PAUSE_S
        progress, before = (rows.published, rows.acknowledged), self._before
        self._before = progress
        self._pause_s = PRESSING_PAUSE_S if progress != before else min(2.0 * self._pause_s, LOCKSTEP_PAUSE_S)
        return self._pause_s
