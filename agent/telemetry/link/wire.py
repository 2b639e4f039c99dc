"""What goes with messages on the network: header of a batch, recorder's status; both are checked when unpacked."""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from agent.telemetry.link.coverage import Range
from agent.telemetry.row.sample import Layout

_MAGIC: Final = b"CB3\0"
_HEADER: Final = struct.Struct("<4sI16sQQQQQI")  # magic end seal run source first written missed crc
_SEAL_BYTES: Final = 16
BATCH_BYTES_MAX: Final = 60_000  # a Zenoh batch is 64 KiB: larger payloads are cut and, when one piece is dropped, lost
LOCKSTEP_BATCH_BYTES_MAX: Final = 240_000  # where nothing is dropped on its way to the recorder pieces do no harm
CYCLE_S: Final = 0.033  # 30 batches/s in real time, of telemetry and of a log that is played
RANGES_MAX: Final = 16


class End(IntEnum):
    """Whether more will come."""

    OPEN = 0
    FINISHED = 1  # the writer said so
    DIED = 2  # the writer is gone without a word


def seal_of(cell: str, fingerprint: str, member: str, layout: Layout | None = None) -> bytes:
    """What a member of the cell puts on every message: one value for its files, its name and its row layout.

    Whoever has the cell's files can make it: it keeps out mistakes and strangers, not a forger (docs/security.md).
    """
    rows = "" if layout is None else f"{layout.ros_name}\n{layout.definition}"
    return hashlib.sha256(f"{cell}\0{fingerprint}\0{member}\0{rows}".encode()).digest()[:_SEAL_BYTES]


@dataclass(frozen=True, slots=True)
class Sent:
    """Who sends: the seal of a member, and the ring of the run that a message is of."""

    seal: bytes = bytes(_SEAL_BYTES)
    run: int = 0


NOBODY: Final = Sent()


@dataclass(frozen=True, slots=True)
class BatchHeader:
    """Attachment of every publication; the payload is the messages alone, so that any CDR reader can take it."""

    source: int  # ring id, or an id of the publishing process for texts
    first: int  # number of the first message of the batch in its source
    written: int  # how many messages the source had by then
    missed: int  # how many of them were overwritten before they could be published
    end: End = End.OPEN
    by: Sent = NOBODY
    crc: int = 0  # CRC32 of the payload; 0: not said

    def pack(self, by: Sent | None = None, payload: bytes | None = None) -> bytes:
        """The bytes of the attachment, as sent by `by` with `payload`."""
        by, crc = self.by if by is None else by, self.crc if payload is None else zlib.crc32(payload)
        return _HEADER.pack(_MAGIC, self.end, by.seal, by.run, self.source, self.first, self.written, self.missed, crc)

    def damaged(self, payload: bytes) -> bool:
        """Whether the payload is not what was sent: a TLS link that is cut can lose a piece of one without a word."""
        return self.crc != 0 and self.crc != zlib.crc32(payload)

    @classmethod
    def unpack(cls, data: bytes) -> BatchHeader:
        """Raises ValueError on anything else."""
        if len(data) != _HEADER.size or data[:4] != _MAGIC:
            raise ValueError("no batch header")
        _, end, seal, run, source, first, written, missed, crc = _HEADER.unpack(data)
        if first > written or written >= 1 << 62 or missed > written or not source:
            raise ValueError("a batch header that cannot be")
        return cls(source, first, written, missed, End(end), Sent(seal, run), crc)


HEADER_BYTES: Final = _HEADER.size


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """What the recorder has of one source."""

    source: int
    have: tuple[Range, ...]  # the last RANGES_MAX ranges: gaps before them may be beyond repair, those behind never are
    ended: bool  # the end marker is there


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """The recorder's answer."""

    recording: bool  # what comes gets into a log
    cause: str  # why not
    streams: Mapping[str, StreamStatus]  # by key; once nothing is recorded any more, what is in the log


def pack_status(recording: bool, cause: str, streams: Mapping[str, StreamStatus], seal: bytes) -> bytes:
    """The recorder's answer; `streams` by key, `seal` of the cell's recorder."""
    plain = {key: {"source": s.source, "have": s.have, "ended": s.ended} for key, s in streams.items()}
    told = {"recording": recording, "cause": cause, "seal": seal.hex(), "streams": plain}
    return json.dumps(told, separators=(",", ":")).encode()


def unpack_status(payload: bytes, seal: bytes) -> RecorderStatus:
    """The answer.  Raises ValueError when it is not one of the recorder with that seal."""
    try:
        told = json.loads(payload)
        if told["seal"] != seal.hex():
            raise ValueError("the status of another recorder")
        streams = {
            str(key): StreamStatus(
                int(s["source"]), tuple((int(a), int(b)) for a, b in s["have"][-RANGES_MAX:]), bool(s["ended"])
            )
            for key, s in told["streams"].items()
        }
        return RecorderStatus(bool(told["recording"]), str(told["cause"]), streams)
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"not a recorder's status: {error!r}") from error
