"""Events and health as bounded JSON texts, and the ring that carries them.  Never blocks, takes texts of any length."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.ring import RingReader, RingWriter
from agent.telemetry.topics import Kind

TEXT_MAX_BYTES: Final = 1000
TEXT_SLOTS: Final = 1024


class Level(IntEnum):
    """How bad it is; the numbers are those of rcl_interfaces/msg/Log."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened once: who says so, when, how bad, what, and the numbers."""

    utc_ns: int
    source: str
    level: Level
    text: str
    data: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> bytes:
        """One line of JSON, at most TEXT_MAX_BYTES; a text too long loses its data first, then its end."""
        plain = {"utc_ns": self.utc_ns, "source": self.source, "level": self.level.name, "text": self.text}
        encoded = _encode(plain | {"data": dict(self.data)})
        text = self.text
        while len(encoded) > TEXT_MAX_BYTES:
            encoded = _encode(plain | {"text": text, "source": self.source[:32], "data": {"truncated": True}})
            text = text[: len(text) // 2]
        return encoded

    @classmethod
    def from_json(cls, payload: bytes) -> Event:
        """The event of `payload`, which may come from anywhere.  Raises ValueError when it is not one."""
        if len(payload) > TEXT_MAX_BYTES:
            raise ValueError(f"{len(payload)} bytes")
        try:
            raw = json.loads(payload)
            event = cls(raw["utc_ns"], raw["source"], Level[raw["level"]], raw["text"], raw.get("data", {}))
        except (KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"not an event: {error!r}") from error
        _check_time(event.utc_ns)
        if not (isinstance(event.source, str) and isinstance(event.text, str) and isinstance(event.data, dict)):
            raise ValueError("a field has the wrong type")
        return event


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
        self._ring = RingWriter(texts_path(ring), TEXT_FORMAT, name, slots=TEXT_SLOTS)

    def event(self, event: Event) -> None:
        """Write an event."""
        self._write(_TextKind.EVENT, event.to_json())

    def health(self, utc_ns: int, values: Mapping[str, Any]) -> None:
        """Write slow quantities; values beyond TEXT_MAX_BYTES of JSON are replaced by a note of their size."""
        encoded = _encode({"utc_ns": utc_ns, **values})
        if len(encoded) > TEXT_MAX_BYTES:
            encoded = _encode({"utc_ns": utc_ns, "truncated_bytes": len(encoded)})
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
        while (block := self._ring.read_new(64)).count:
            for row in np.frombuffer(block.payload, TEXT_FORMAT.dtype):
                kind, length = _KIND_OF.get(int(row["kind"])), int(row["length"])
                if kind is not None and length <= TEXT_MAX_BYTES:
                    texts.append((kind, row["text"][:length].tobytes()))
        return texts

    def close(self) -> None:
        """Unmap.  Safe twice."""
        self._ring.close()


def health_time(payload: bytes) -> int:
    """UTC in ns of a health text, which may come from anywhere.  Raises ValueError when it is none."""
    if len(payload) > TEXT_MAX_BYTES:
        raise ValueError(f"{len(payload)} bytes")
    try:
        return _check_time(json.loads(payload)["utc_ns"])
    except (KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"not a health text: {error!r}") from error


def _check_time(utc_ns: object) -> int:
    if type(utc_ns) is not int or not 0 <= utc_ns < 1 << 63:
        raise ValueError("utc_ns is not a time")
    return utc_ns


def _encode(values: Mapping[str, Any]) -> bytes:
    """JSON that every reader accepts: numbers that are not finite become null."""
    plain = json.loads(json.dumps(values, default=str), parse_constant=lambda _: None)
    return json.dumps(plain, separators=(",", ":")).encode()
