"""Events and health as JSON texts of at most TEXT_MAX_BYTES, whatever length they are given."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

TEXT_MAX_BYTES: Final = 1000
UTC_END_NS: Final = (1 << 32) * 1_000_000_000  # what comes later fits no stamp of ROS, which has 32 bits of seconds
HOLDS: Final = "holds: "  # before the reason in what an arm tells when it holds by itself


class ImpossibleTimeError(ValueError):
    """A UTC that no stamp of a message can have."""


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
        encoded = encode(plain | {"data": dict(self.data)})
        text = self.text
        while len(encoded) > TEXT_MAX_BYTES:
            encoded = encode(plain | {"text": text, "source": self.source[:32], "data": {"truncated": True}})
            text = text[: len(text) // 2]
        return encoded

    @classmethod
    def from_json(cls, payload: bytes) -> Event:
        """The event of `payload`, which may come from anywhere.  Raises ValueError when it is not one."""
        if len(payload) > TEXT_MAX_BYTES:
            raise ValueError(f"{len(payload)} bytes")
        try:
            raw = json.loads(payload)
            source, text = _utf8(raw["source"]), _utf8(raw["text"])
            event = cls(check_time(raw["utc_ns"]), source, Level[raw["level"]], text, raw.get("data", {}))
        except (KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"not an event: {error!r}") from error
        if not isinstance(event.data, dict):
            raise ValueError("a field has the wrong type")
        return event


def health_time(payload: bytes) -> int:
    """UTC in ns of a health text, which may come from anywhere.  Raises ValueError when it is none."""
    if len(payload) > TEXT_MAX_BYTES:
        raise ValueError(f"{len(payload)} bytes")
    try:
        return check_time(json.loads(payload)["utc_ns"])
    except (KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"not a health text: {error!r}") from error


def check_time(utc_ns: object) -> int:
    """The same when it can be a UTC in ns.  Raises ValueError, of a number ImpossibleTimeError."""
    if type(utc_ns) is not int:
        raise ValueError("utc_ns is not a time")
    if not 0 <= utc_ns < UTC_END_NS:
        raise ImpossibleTimeError("utc_ns is not a time of a stamp")
    return utc_ns


def _utf8(text: str) -> str:
    """The same as logs and networks take it: half of a letter, as of a path that is no UTF-8, by its number."""
    return text.encode(errors="backslashreplace").decode()


def encode(values: Mapping[str, Any]) -> bytes:
    """JSON that every reader accepts: numbers that are not finite become null."""
    plain = json.loads(json.dumps(values, default=str), parse_constant=lambda _: None)
    return json.dumps(plain, separators=(",", ":")).encode()
