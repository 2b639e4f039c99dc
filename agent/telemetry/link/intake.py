"""The recorder's door: checks what comes in, keeps out what is there already, and knows what is missing.

A function of the messages alone, without network, file or clock.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.link.coverage import Coverage, count_of
from agent.telemetry.link.wire import RANGES_MAX, BatchHeader, End, StreamStatus
from agent.telemetry.row.event import Event, health_time
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE
from agent.telemetry.row.topics import PLANT, PUBLISHED, Address, Kind

TEXTS_MAX: Final = 100_000  # per stream and log: a flood of texts ends there, with a count
GAPS_MAX: Final = 100
_EDGES_MAX: Final = 1024


class Rejection(Enum):
    """Why something did not get in."""

    UNKNOWN_KEY = "unknown_key"
    NO_HEADER = "no_batch_header"
    TOO_LARGE = "too_large"
    WRONG_LENGTH = "wrong_length"
    WRONG_ENCAPSULATION = "wrong_encapsulation"
    WRONG_CONFIG = "wrong_config_id"
    WRONG_JOINTS = "wrong_joint_count"
    WRONG_ORDER = "wrong_order"
    ANOTHER_RUN = "another_run"  # a ring of the same member from an earlier start
    NOT_A_TEXT = "not_a_text"
    TOO_MANY_TEXTS = "too_many_texts"


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
        self._missed_before = 0
        self._past: set[int] = set()  # sources before this one
        self._sequence_at: dict[int, int] = {}  # of the first and last row of each range, and of some within

    @property
    def status(self) -> StreamStatus:
        """For the publisher."""
        return StreamStatus(self.source, tuple(self.have.ranges[-RANGES_MAX:]), self.end is not End.OPEN)

    def note(self, header: BatchHeader, count: int) -> list[tuple[int, int]]:
        """Take over a batch; return the ranges of numbers that are new."""
        self.written, self.missed = max(self.written, header.written), max(self.missed, header.missed)
        self.end = max(self.end, header.end)
        new = self.have.add(header.first, header.first + count - 1) if count else []
        self.duplicates += count - count_of(new)
        self.here += count_of(new)
        return new

    def turn_to(self, source: int) -> bool:
        """Take messages of this source from now on; False when it is one from before."""
        if source == self.source:
            return True
        if source in self._past:
            return False
        self._past.add(self.source)
        self.source, self.have, self.end = source, Coverage(), End.OPEN
        self.written = self.missed = self.since = self._missed_before = 0
        self._sequence_at = {}
        return True

    def is_past(self, source: int) -> bool:
        """Whether it was this key's source before the present one."""
        return source in self._past

    def begin_log(self) -> None:
        """What comes from now on goes into another log."""
        self.since, self.here, self.duplicates, self._missed_before = self.have.end, 0, 0, self.missed

    def note_sequences(self, first: int, rows: NDArray[np.void]) -> None:
        """Remember the sequence numbers at the edges of what came."""
        self._sequence_at[first] = int(rows[0]["sequence"])
        self._sequence_at[first + len(rows) - 1] = int(rows[-1]["sequence"])
        if len(self._sequence_at) > _EDGES_MAX:
            edges = {n for r in self.have.ranges for n in r}
            self._sequence_at = {n: s for n, s in self._sequence_at.items() if n in edges}

    def follows(self, header: BatchHeader, rows: NDArray[np.void]) -> bool:
        """Whether the sequence numbers go up, within the rows and from the row before them."""
        sequence = rows["sequence"]
        before = self._sequence_at.get(header.first - 1, -1) if header.source == self.source else -1
        return not np.count_nonzero(sequence[1:] <= sequence[:-1]) and before < int(sequence[0])

    def told(self, lost: int, *, continued: bool) -> dict[str, str]:
        """What of it is in the present log, and what is not and why; continued: another log takes up from here."""
        goes_on = continued and self.end is End.OPEN
        until = self.have.end if goes_on else self.written
        missing = count_of(self.have.missing(self.since, until - 1))
        in_ring = self.missed - self._missed_before
        return {
            "rows_expected": str(until - self.since),
            "rows_recorded": str(self.here - lost),
            "end": "continued" if goes_on else self.end.name.lower(),
            "gaps": json.dumps(self.gaps(until)),
            "lost_in_ring": str(in_ring),
            "lost_on_the_way": str(max(0, missing - in_ring)),
            "lost_on_disk": str(lost),
            "duplicates": str(self.duplicates),
        }

    def whole(self, *, continued: bool) -> bool:
        """Whether the present log has all of it that belongs there."""
        goes_on = continued and self.end is End.OPEN
        until = self.have.end if goes_on else self.written
        return (goes_on or self.end is not End.OPEN) and not self.have.missing(self.since, until - 1)

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


class Intake:
    """All streams of a cell."""

    def __init__(self, cell: str, arms: Mapping[str, int], *, has_plant: bool, config_id: int) -> None:
        """`arms`: joint count by arm name."""
        self._arms = dict(arms)
        self._config_id = config_id
        self.rejected: Counter[Rejection] = Counter()
        members = [*arms, PLANT] if has_plant else [*arms]
        addresses = [Address(cell, member, kind) for member in members for kind in PUBLISHED]
        self.streams = {a.key: Stream(a) for a in addresses}
        agent_row, plant_row = AGENT_STATE.dtype, PLANT_STATE.dtype
        self._dtypes = {member: plant_row if member == PLANT else agent_row for member in members}
        self._texts: dict[bytes, None] = {}  # events that were told, the oldest first
        self.another_run = False  # what was just refused is of a new run: it goes into the next log

    def take(self, key: str, payload: bytes, attachment: bytes) -> list[Rows] | list[Text]:
        """What is new in a message, in order; nothing when it does not belong here, which is counted."""
        self.another_run = False
        stream = self.streams.get(key)
        if stream is None:
            return self._reject(Rejection.UNKNOWN_KEY)
        try:
            header = BatchHeader.unpack(attachment)
        except ValueError:
            return self._reject(Rejection.NO_HEADER)
        if stream.address.kind is Kind.STATE:
            return self._take_rows(stream, header, payload)
        return self._take_text(stream, header, payload)

    def _take_rows(self, stream: Stream, header: BatchHeader, payload: bytes) -> list[Rows]:
        member = stream.address.member
        dtype = self._dtypes[member]
        if len(payload) % dtype.itemsize or (not payload and header.end is End.OPEN):
            return self._reject(Rejection.WRONG_LENGTH)
        rows = np.frombuffer(payload, dtype)
        if np.count_nonzero(rows["encapsulation"] != CDR_LITTLE_ENDIAN):  # several times as fast as any()
            return self._reject(Rejection.WRONG_ENCAPSULATION)
        if np.count_nonzero(rows["config_id"] != self._config_id):
            return self._reject(Rejection.WRONG_CONFIG)
        if member in self._arms and np.count_nonzero(rows["joint_count"] != self._arms[member]):
            return self._reject(Rejection.WRONG_JOINTS)
        if header.first + len(rows) > header.written or (len(rows) and not stream.follows(header, rows)):
            return self._reject(Rejection.WRONG_ORDER)
        if stream.here and stream.source != header.source and not stream.is_past(header.source):
            self.another_run = True
            return []
        if not stream.turn_to(header.source):
            return self._reject(Rejection.ANOTHER_RUN)
        new = stream.note(header, len(rows))
        if len(rows):
            stream.note_sequences(header.first, rows)
        return [Rows(stream.address, rows[a - header.first : b + 1 - header.first]) for a, b in new]

    def _take_text(self, stream: Stream, header: BatchHeader, payload: bytes) -> list[Text]:
        if not payload:
            if header.end is End.OPEN:
                return self._reject(Rejection.WRONG_LENGTH)
            stream.turn_to(header.source)
            stream.note(header, 0)
            return []
        try:
            event = Event.from_json(payload) if stream.address.kind is Kind.EVENT else None
            utc_ns = event.utc_ns if event is not None else health_time(payload)
        except ValueError:
            return self._reject(Rejection.NOT_A_TEXT)
        if stream.here >= TEXTS_MAX:
            return self._reject(Rejection.TOO_MANY_TEXTS)
        if not stream.turn_to(header.source) or not stream.note(header, 1):
            return []
        if event is not None:  # a telemetry process that was started again tells the same events again
            if payload in self._texts:
                stream.duplicates += 1
                return []
            self._texts[payload] = None
            if len(self._texts) > TEXTS_MAX:
                del self._texts[next(iter(self._texts))]
        return [Text(stream.address, payload, utc_ns, event)]

    def _reject(self, why: Rejection) -> list[Any]:
        self.rejected[why] += 1
        return []

    def begin_log(self) -> None:
        """What comes from now on goes into another log."""
        self.rejected.clear()
        for stream in self.streams.values():
            stream.begin_log()

    def completeness(self, lost_on_disk: Mapping[str, int], *, continued: bool = False) -> dict[str, str]:
        """The last metadata record: per member what was written, what is here, what is missing and why.

        `lost_on_disk`: rows by member that came and could not be written; continued: another log takes up from here.
        """
        out: dict[str, str] = {}
        complete = True
        for stream in self.streams.values():
            if stream.address.kind is not Kind.STATE:
                continue
            member = stream.address.member
            lost = lost_on_disk.get(member, 0)
            complete = complete and stream.whole(continued=continued) and not lost
            out |= {f"{member}.{key}": value for key, value in stream.told(lost, continued=continued).items()}
        rejected = {f"rejected.{why.value}": str(count) for why, count in self.rejected.items()}
        return {"complete": str(complete).lower()} | out | rejected
