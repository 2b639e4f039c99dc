"""One key of the recorder: which source it comes from, what of it is there, and what of that is in the present log."""

from __future__ import annotations

import json
from collections.abc import Sequence
from operator import lt
from typing import Final

from agent.telemetry.link.coverage import Coverage, count_of
from agent.telemetry.link.wire import RANGES_MAX, BatchHeader, End, StreamStatus
from agent.telemetry.row.topics import Address

GAPS_MAX: Final = 100
SILENT_S: Final = 1.0  # telemetry sends 30 batches a second; what is refused meanwhile it sends again
_EDGES_MAX: Final = 1024
_Left = tuple[Coverage, int, int, End]  # what was there of a source, and how it stood


class Stream:
    """One key: which source it comes from, what of it is there, and what of that is in the present log."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self.source = 0
        self.have = Coverage()
        self.written = 0
        self.missed = 0
        self.end = End.OPEN
        self.duplicates = 0
        self.since = 0  # number at which the present log begins
        self.here = 0  # messages that went into it
        self.refused = 0  # messages on this key that did not belong
        self.late = Coverage()  # of those in the present log what belongs to the stretch of an earlier one
        self.whole_before = True  # all of the sources before this one is in the logs
        self._late_at: dict[int, int] = {}  # sequence numbers at the edges of that
        self._missed_before = 0
        self._rival_s: float | None = None  # since when another source has been speaking in this one's silence
        self._past: dict[int, _Left] = {}  # sources before this one
        self._sequence_at: dict[int, int] = {}  # of the first and last row of each range, and of some within

    @property
    def status(self) -> StreamStatus:
        """For the publisher."""
        return StreamStatus(self.source, tuple(self.have.ranges[-RANGES_MAX:]), self.end is not End.OPEN)

    def kept(self, lost: int) -> StreamStatus:
        """For the publisher, once the log has ended without the last `lost` messages that came."""
        ranges = self.have.ranges
        while lost and ranges:
            first, last = ranges.pop()
            some = min(lost, last - first + 1)
            lost -= some
            if last - some >= first:
                ranges.append((first, last - some))
        return StreamStatus(self.source, tuple(ranges[-RANGES_MAX:]), self.end is not End.OPEN)

    def note(self, header: BatchHeader, count: int) -> list[tuple[int, int]]:
        """Take over a batch; return the ranges of numbers that are new."""
        self._rival_s = None
        self.written, self.missed = max(self.written, header.written), max(self.missed, header.missed)
        self.end = max(self.end, header.end)
        new = self.have.add(header.first, header.first + count - 1) if count else []
        self.duplicates += count - count_of(new)
        self.here += count_of(new)
        return new

    def gives_way(self, now_s: float) -> bool:
        """Whether another source may follow: this one brought nothing, has ended, or is silent while that speaks."""
        if not self.have.count or self.end is not End.OPEN:
            return True
        if self._rival_s is None:
            self._rival_s = now_s
        return now_s - self._rival_s >= SILENT_S

    def turn_to(self, source: int) -> bool:
        """Take messages of this source from now on; False when it is one from before."""
        if source == self.source:
            return True
        if source in self._past:
            return False
        self._past[self.source] = self.have, self.written, self.missed, self.end
        self.whole_before = self.whole_before and (not self.written or self.all_there)
        self.late, self._late_at = Coverage(), {}
        self.source, self.have, self.end = source, Coverage(), End.OPEN
        self.written = self.missed = self.since = self._missed_before = 0
        self._sequence_at, self._rival_s = {}, None
        return True

    def turn_back(self, source: int) -> None:
        """Go on with a source from before, where it was left."""
        self._past[self.source] = self.have, self.written, self.missed, self.end
        self.have, self.written, self.missed, self.end = self._past.pop(source)
        self.source = source

    def is_past(self, source: int) -> bool:
        """Whether it was this key's source before the present one."""
        return source in self._past

    def begin_log(self) -> None:
        """What comes from now on goes into another log."""
        self.since, self.here, self.duplicates, self._missed_before = self.have.end, 0, 0, self.missed
        self.refused, self.late, self._late_at = 0, Coverage(), {}

    def note_sequences(self, first: int, sequences: Sequence[int]) -> None:
        """Remember the sequence numbers at the edges of what came."""
        self._sequence_at[first] = sequences[0]
        self._sequence_at[first + len(sequences) - 1] = sequences[-1]
        if len(self._sequence_at) > _EDGES_MAX:
            edges = {n for r in self.have.ranges for n in r}
            self._sequence_at = {n: s for n, s in self._sequence_at.items() if n in edges}

    def note_late(self, new: Sequence[tuple[int, int]], first: int, sequences: Sequence[int]) -> None:
        """Remember which of the rows that are `new`, of those from number `first` on, an earlier log has not."""
        for begin, last in new:
            end = min(last, self.since - 1)
            if begin <= end:
                self.late.add(begin, end)
                self._late_at |= {begin: sequences[begin - first], end: sequences[end - first]}
        if len(self._late_at) > _EDGES_MAX:
            edges = {n for r in self.late.ranges for n in r}
            self._late_at = {n: s for n, s in self._late_at.items() if n in edges}

    def follows(self, header: BatchHeader, sequences: Sequence[int]) -> bool:
        """Whether the sequence numbers go up, within the rows and from the row before them."""
        before = self._sequence_at.get(header.first - 1, -1) if header.source == self.source else -1
        return all(map(lt, (before, *sequences), sequences))

    def told(self, lost: int, *, continued: bool) -> dict[str, str]:
        """What of it is in the present log, and what is not and why; continued: another log takes up from here.

        A row that comes late is in a later log than its stretch, and counts there apart; so while another log follows,
        one that has not come is not called lost.
        """
        goes_on = continued and self.end is End.OPEN
        until = self.have.end if goes_on else self.written
        missing = count_of(self.have.missing(self.since, until - 1))
        in_ring = self.missed - self._missed_before
        on_the_way = max(0, missing - in_ring)
        late = [(self._late_at[first], self._late_at[last]) for first, last in self.late.ranges[:GAPS_MAX]]
        return {
            "rows_before": str(self.since),
            "rows_expected": str(until - self.since),
            "rows_recorded": str(max(0, self.here - self.late.count - lost)),
            "late_rows": str(self.late.count),
            "late": json.dumps(late),
            "end": "continued" if goes_on else self.end.name.lower(),
            "gaps": json.dumps(self.gaps(until)),
            "lost_in_ring": str(in_ring),
            "lost_on_the_way": "0" if continued else str(on_the_way),
            "awaited": str(on_the_way) if continued else "0",
            "missing_before": str(count_of(self.have.missing(0, self.since - 1))),
            "lost_on_disk": str(lost),
            "duplicates": str(self.duplicates),
        }

    def whole(self, *, continued: bool) -> bool:
        """Whether the present log has all of it that belongs there; without a single row nothing is whole."""
        if not self.have.count:
            return False
        goes_on = continued and self.end is End.OPEN
        until = self.have.end if goes_on else self.written
        return (goes_on or self.end is not End.OPEN) and not self.have.missing(self.since, until - 1)

    @property
    def all_there(self) -> bool:
        """Whether all of the present source is in the logs, whichever."""
        return bool(self.have.count) and self.end is not End.OPEN and not self.have.missing(0, self.written - 1)

    def gaps(self, until: int) -> list[tuple[int, int]]:
        """Sequence numbers (first, last) of the rows that are missing, as far as their neighbours tell."""
        found = []
        for first, last in self.have.missing(self.since, until - 1)[:GAPS_MAX]:
            after = self._sequence_at.get(last + 1)
            before = self._sequence_at.get(first - 1, None if after is None else after - (last - first + 2))
            if before is None:
                continue  # nothing at all was received
            found.append((before + 1, (before + last - first + 2 if after is None else after) - 1))
        return found
