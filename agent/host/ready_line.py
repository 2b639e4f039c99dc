"""What a process of ours says once it is ready, and how its parent reads that: `READY key=value key=value`.

A value may be a path with any byte in it: what would end it, or is no plain letter, goes by its number, as `%20`.
"""

from __future__ import annotations

import string
from typing import Final

READY: Final = "READY "
_PLAIN: Final = frozenset((string.ascii_letters + string.digits + string.punctuation.replace("%", "")).encode())
_BYTES: Final = "surrogateescape"  # names of files that are no UTF-8


def pairs(**values: object) -> str:
    """These values as a ready line says them."""
    return " ".join(f"{key}={_said(str(value))}" for key, value in values.items())


def values_of(line: str) -> dict[str, str]:
    """The values that a ready line says, by their keys.  Raises ValueError where it is none."""
    if not line.startswith(READY):
        raise ValueError(f"no ready line: {line!r}")
    said = (pair.split("=", 1) for pair in line.removeprefix(READY).split())
    return {key: _meant(value) for key, value in said}


def _said(value: str) -> str:
    return "".join(chr(byte) if byte in _PLAIN else f"%{byte:02X}" for byte in value.encode(errors=_BYTES))


def _meant(value: str) -> str:
    first, *others = value.split("%")
    rest = (bytes.fromhex(other[:2]) + other[2:].encode() for other in others)
    return (first.encode() + b"".join(rest)).decode(errors=_BYTES)
