"""The recorder's door: checks what comes in, keeps out what is there already, and knows what is missing.

A function of the messages alone, without network, file or clock.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.link.source import TEXTS_KEPT
from agent.telemetry.link.stream import Stream
from agent.telemetry.link.wire import BatchHeader, End, seal_of
from agent.telemetry.ring.texts import TEXT_SLOTS
from agent.telemetry.row.event import UTC_END_NS, Event, ImpossibleTimeError, health_time
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE
from agent.telemetry.row.topics import PLANT, PUBLISHED, Address, Kind

TEXTS_MAX: Final = 100_000  # per stream and log: a flood of texts ends there, with a count
TOLD_MAX: Final = {  # texts of an arm that are known again: as many as its telemetry makes of its ring, or finds there
    Kind.EVENT: TEXTS_KEPT,
    Kind.HEALTH: TEXT_SLOTS,
}
_DIGEST_BYTES: Final = 16


class Rejection(Enum):
    """Why something did not get in."""

    UNKNOWN_KEY = "unknown_key"
    NO_HEADER = "no_batch_header"
    WRONG_SEAL = "wrong_cell_or_layout"  # not sent by that member of the cell with these very files and this row layout
    TOO_LARGE = "too_large"
    WRONG_LENGTH = "wrong_length"
    WRONG_ENCAPSULATION = "wrong_encapsulation"
    DAMAGED = "damaged"  # not what was sent; it is sent again
    WRONG_CONFIG = "wrong_config_id"
    WRONG_JOINTS = "wrong_joint_count"
    IMPOSSIBLE_TIME = "impossible_time"  # that no stamp of a message can have
    WRONG_ORDER = "wrong_order"
    ANOTHER_PUBLISHER = "another_publisher"  # while the run that is being recorded goes on
    ANOTHER_RUN = "another_run"  # a ring of the same member from an earlier start
    NOT_A_TEXT = "not_a_text"
    TOO_MANY_TEXTS = "too_many_texts"


STRANGE: Final = frozenset(Rejection) - {
    Rejection.ANOTHER_RUN,
    Rejection.DAMAGED,
    Rejection.TOO_MANY_TEXTS,
}  # somebody else's, or a mistake


def _constants(config_id: int, joints: int | None) -> list[tuple[str, int, Rejection]]:
    """Fields that are the same in every row of a member, with what they are; joints: None of the plant."""
    found = [
        ("encapsulation", CDR_LITTLE_ENDIAN, Rejection.WRONG_ENCAPSULATION),
        ("config_id", config_id, Rejection.WRONG_CONFIG),
    ]
    return found if joints is None else [*found, ("joint_count", joints, Rejection.WRONG_JOINTS)]


class Intake:
    """All streams of a cell."""

    def __init__(
        self, cell: str, arms: Mapping[str, int], *, has_plant: bool, config_id: int, fingerprint: str = ""
    ) -> None:
        """`arms`: joint count by arm name; `fingerprint`: what every publisher of the cell must have."""
        self.rejected: Counter[Rejection] = Counter()
        members = [*arms, PLANT] if has_plant else [*arms]
        addresses = [Address(cell, member, kind) for member in members for kind in PUBLISHED]
        self.streams = {a.key: Stream(a) for a in addresses}
        layouts = {member: PLANT_STATE if member == PLANT else AGENT_STATE for member in members}
        self._dtypes = {member: layout.dtype for member, layout in layouts.items()}
        self._constants = {member: _constants(config_id, arms.get(member)) for member in members}
        self._seals = {member: seal_of(cell, fingerprint, member, layout) for member, layout in layouts.items()}
        self._rows_of = {a.member: self.streams[a.key] for a in addresses if a.kind is Kind.STATE}
        self._stream: Stream | None = None  # that the present message is for
        self._told: dict[str, dict[bytes, None]] = {key: {} for key in self.streams}  # digests, the oldest first
        self.another_run = False  # what was just refused is of a new run: it goes into the next log
        self.told_twice: set[str] = set()  # members of whose run two processes tell, in the present log

    def take(self, key: str, payload: bytes, attachment: bytes, now_s: float = 0.0) -> list[Rows] | list[Text]:
        """What is new in a message, in order; nothing when it does not belong here, which is counted.

        `now_s` of any clock that goes up.
        """
        self.another_run = False
        self._stream = stream = self.streams.get(key)
        if stream is None:
            return self._reject(Rejection.UNKNOWN_KEY)
        try:
            header = BatchHeader.unpack(attachment)
        except ValueError:
            return self._reject(Rejection.NO_HEADER)
        if header.damaged(payload):
            return self._reject(Rejection.DAMAGED)
        if header.by.seal != self._seals[stream.address.member]:
            return self._reject(Rejection.WRONG_SEAL)
        if stream.address.kind is Kind.STATE:
            return self._take_rows(stream, header, payload, now_s)
        return self._take_text(stream, header, payload)

    def _take_rows(self, stream: Stream, header: BatchHeader, payload: bytes, now_s: float) -> list[Rows]:
        member = stream.address.member
        dtype = self._dtypes[member]
        if len(payload) % dtype.itemsize or (not payload and header.end is End.OPEN):
            return self._reject(Rejection.WRONG_LENGTH)
        rows = np.frombuffer(payload, dtype)
        if why := self._wrong(member, rows):
            return self._reject(why)
        sequences: list[int] = rows["sequence"].tolist()
        if header.first + len(rows) > header.written or not stream.follows(header, sequences):
            return self._reject(Rejection.WRONG_ORDER)
        if header.source != stream.source and not self._turn(stream, header.source, now_s):
            return []
        new = stream.note(header, len(rows))
        if sequences:
            stream.note_sequences(header.first, sequences)
            stream.note_late(new, header.first, sequences)
        return [Rows(stream.address, rows[a - header.first : b + 1 - header.first]) for a, b in new]

    def _wrong(self, member: str, rows: NDArray[np.void]) -> Rejection | None:
        """What in any of the rows is not as it must be."""
        for name, value, why in self._constants[member]:
            if rows[name].tolist().count(value) != len(rows):  # a quarter of what comparing the array costs
                return why
        times: list[int] = rows["utc_ns"].tolist()
        possible = not times or 0 <= min(times) <= max(times) < UTC_END_NS
        return None if possible else Rejection.IMPOSSIBLE_TIME

    def _turn(self, stream: Stream, source: int, now_s: float) -> bool:
        """Whether the rows of another source than the present one go into this log from now on."""
        if stream.is_past(source):
            self._reject(Rejection.ANOTHER_RUN)
        elif not stream.gives_way(now_s):
            self._reject(Rejection.ANOTHER_PUBLISHER)
        elif stream.here:
            self.another_run = True
        else:
            return stream.turn_to(source)
        return False

    def _take_text(self, stream: Stream, header: BatchHeader, payload: bytes) -> list[Text]:
        rows = self._rows_of[stream.address.member]
        if header.by.run != rows.source and rows.have.count and rows.end is End.OPEN:
            return self._reject(Rejection.ANOTHER_PUBLISHER)
        if not payload:
            if header.end is End.OPEN:
                return self._reject(Rejection.WRONG_LENGTH)
            if self._listens(stream, header, rows):
                stream.note(header, 0)
            return []
        try:
            event = Event.from_json(payload) if stream.address.kind is Kind.EVENT else None
            utc_ns = event.utc_ns if event is not None else health_time(payload)
        except ImpossibleTimeError:
            return self._reject(Rejection.IMPOSSIBLE_TIME)
        except ValueError:
            return self._reject(Rejection.NOT_A_TEXT)
        if stream.here >= TEXTS_MAX:
            return self._reject(Rejection.TOO_MANY_TEXTS)
        if not self._listens(stream, header, rows) or not stream.note(header, 1):
            return []
        # a telemetry process that was started again, or a second one, tells the same again
        told, digest = self._told[stream.address.key], hashlib.sha256(payload).digest()[:_DIGEST_BYTES]
        if digest in told:
            stream.duplicates += 1
            return []
        told[digest] = None
        if len(told) > TOLD_MAX[stream.address.kind]:
            del told[next(iter(told))]
        return [Text(stream.address, payload, utc_ns, event)]

    def _listens(self, stream: Stream, header: BatchHeader, rows: Stream) -> bool:
        """Whether these texts count: of a process that told before another one only where both tell of this run."""
        if not stream.turn_to(header.source):
            if header.by.run != rows.source:
                return False
            stream.turn_back(header.source)
            self.told_twice.add(stream.address.member)
        return True

    def _reject(self, why: Rejection) -> list[Any]:
        self.rejected[why] += 1
        if self._stream is not None:
            self._stream.refused += 1
        return []

    def also_refused(self, rejected: Counter[Rejection], by_key: Counter[str]) -> None:
        """Count what was refused before it came here."""
        self.rejected.update(rejected)
        for key, count in by_key.items():
            self.streams[key].refused += count

    def begin_log(self) -> None:
        """What comes from now on goes into another log."""
        self.rejected.clear()
        self.told_twice.clear()
        for stream in self.streams.values():
            stream.begin_log()

    @property
    def whole(self) -> bool:
        """Whether all rows of every run that came are in the logs together, and every member has come."""
        return all(stream.all_there and stream.whole_before for stream in self._rows_of.values())

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
            out[f"{member}.refused"] = str(sum(s.refused for s in self.streams.values() if s.address.member == member))
        rejected = {f"rejected.{why.value}": str(count) for why, count in self.rejected.items()}
        return {"complete": str(complete).lower()} | out | rejected
