"""The ring that carries one arm's events and health texts to telemetry; a write waits for no reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import TEXT_MAX_BYTES, Event, encode
from agent.telemetry.row.topics import Kind

TEXT_SLOTS: Final = 1024


class _TextKind(Enum):
    EVENT = 0
    HEALTH = 1


_KIND_OF: Final = {_TextKind.EVENT.value: Kind.EVENT, _TextKind.HEALTH.value: Kind.HEALTH}


@dataclass(frozen=True)
class _TextFormat:
    """Ring rows that carry one text each; has what the ring needs of a layout."""

    ros_name: str = "coop_msgs/RingText"
    definition: str = f"uint32 kind\nuint32 length\nuint8[{TEXT_MAX_BYTES}] text\n"

    @property
    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(
            [("encapsulation", "<u4"), ("kind", "<u4"), ("length", "<u4"), ("text", "u1", (TEXT_MAX_BYTES,))]
        )


TEXT_FORMAT: Final = _TextFormat()


def texts_path(ring: Path) -> Path:
    """Where the texts of the agent with this ring lie."""
    return ring.with_name(ring.name + ".texts")


class TextWriter:
    """The agent's end: events and health into a small ring of their own, beside the ring of rows."""

    def __init__(self, ring: Path, name: str) -> None:
        """Create `texts_path(ring)`; do so before the ring itself, for which telemetry waits.  Raises RingError."""
        self._ring: RingWriter = RingWriter(texts_path(ring), TEXT_FORMAT, name, slots=TEXT_SLOTS)

    @classmethod
    def of(cls, ring: RingWriter) -> Self:
        """Into a ring that is there: the texts of a writer that has died."""
        self = cls.__new__(cls)
        self._ring = ring
        return self

    def fileno(self) -> int:
        """Descriptor of the file, for a process that may have to go on with it."""
        return self._ring.fileno()

    def event(self, event: Event) -> None:
        """Write an event."""
        self._write(_TextKind.EVENT, event.to_json())

    def health(self, utc_ns: int, values: Mapping[str, Any]) -> None:
        """Write slow quantities; values beyond TEXT_MAX_BYTES of JSON are replaced by a note of their size."""
        encoded = encode({"utc_ns": utc_ns, **values})
        if len(encoded) > TEXT_MAX_BYTES:
            encoded = encode({"utc_ns": utc_ns, "truncated_bytes": len(encoded)})
        self._write(_TextKind.HEALTH, encoded)

    def finish(self) -> None:
        """Say that nothing will follow."""
        self._ring.finish()

    def close(self) -> None:
        """Give the ring back.  Safe twice."""
        self._ring.close()

    def _write(self, kind: _TextKind, encoded: bytes) -> None:
        row: NDArray[np.void] = self._ring.row
        row["kind"] = kind.value
        row["length"] = len(encoded)
        row["text"][: len(encoded)] = np.frombuffer(encoded, np.uint8)
        self._ring.commit()


class TextReader:
    """The telemetry's end."""

    def __init__(self, ring: Path) -> None:
        """Open `texts_path(ring)`.  Raises RingError."""
        self._ring = RingReader(texts_path(ring), TEXT_FORMAT)

    @property
    def pid(self) -> int:
        """Process that wrote them."""
        return self._ring.header.pid

    def read_new(self) -> list[tuple[Kind, bytes]]:
        """Return the new texts with their kinds, oldest first; a text that makes no sense is left out."""
        texts = []
        end = self._ring.written
        while self._ring.next_index < end:
            block = self._ring.read_new(64)
            for row in np.frombuffer(block.payload, TEXT_FORMAT.dtype):
                kind, length = _KIND_OF.get(int(row["kind"])), int(row["length"])
                if kind is not None and length <= TEXT_MAX_BYTES:
                    texts.append((kind, row["text"][:length].tobytes()))
        return texts

    def close(self) -> None:
        """Let go of the file.  Safe twice."""
        self._ring.close()
