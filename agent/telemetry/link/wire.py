"""What goes with messages on the network: header of a batch, recorder's status; both are checked when unpacked."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from agent.telemetry.link.coverage import Range

_MAGIC: Final = b"CB1\0"
_HEADER: Final = struct.Struct("<4sIQQQQ")  # magic end source first written missed
BATCH_BYTES_MAX: Final = 60_000  # a Zenoh batch is 64 KiB: larger payloads are cut and, when one piece is dropped, lost
RANGES_MAX: Final = 16


class End(IntEnum):
    """Whether more will come."""

    OPEN = 0
    FINISHED = 1  # the writer said so
    DIED = 2  # the writer is gone without a word


@dataclass(frozen=True, slots=True)
class BatchHeader:
    """Attachment of every publication; the payload is the messages alone, so that any CDR reader can take it."""

    source: int  # ring id, or an id of the publishing process for texts
    first: int  # number of the first message of the batch in its source
    written: int  # how many messages the source had by then
    missed: int  # how many of them were overwritten before they could be published
    end: End = End.OPEN

    def pack(self) -> bytes:
        """The bytes of the attachment."""
        return _HEADER.pack(_MAGIC, self.end, self.source, self.first, self.written, self.missed)

    @classmethod
    def unpack(cls, data: bytes) -> BatchHeader:
        """Raises ValueError on anything else."""
        if len(data) != _HEADER.size or data[:4] != _MAGIC:
            raise ValueError("no batch header")
        _, end, source, first, written, missed = _HEADER.unpack(data)
        if first > written or written >= 1 << 62 or missed > written or not source:
            raise ValueError("a batch header that cannot be")
        return cls(source, first, written, missed, End(end))


HEADER_BYTES: Final = _HEADER.size


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """What the recorder has of one source."""

    source: int
    have: tuple[Range, ...]  # the last RANGES_MAX ranges: gaps before them may be beyond repair, those behind never are
    ended: bool  # the end marker is there


def pack_status(recording: bool, cause: str, streams: Mapping[str, StreamStatus]) -> bytes:
    """The recorder's answer; `streams` by key."""
    plain = {key: {"source": s.source, "have": s.have, "ended": s.ended} for key, s in streams.items()}
    return json.dumps({"recording": recording, "cause": cause, "streams": plain}, separators=(",", ":")).encode()


def unpack_status(payload: bytes) -> dict[str, StreamStatus]:
    """Status by key.  Raises ValueError when it is not one."""
    try:
        return {
            str(key): StreamStatus(
                int(s["source"]), tuple((int(a), int(b)) for a, b in s["have"][-RANGES_MAX:]), bool(s["ended"])
            )
            for key, s in json.loads(payload)["streams"].items()
        }
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"not a recorder's status: {error!r}") from error
