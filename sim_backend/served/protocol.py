"""What plant and agents say to each other over SOCK_SEQPACKET: layouts and meanings.

In the tick there are two fixed messages, STATE and COMMAND; words (JSON) are used before it and when it ends.
A new meaning of any byte needs a new VERSION.
"""

from __future__ import annotations

import json
import struct
from enum import IntEnum
from typing import Final

import numpy as np

from drivers.interface import Refusal, Vector

VERSION: Final = 4
MAX_MESSAGE_BYTES: Final = 4096
HEADER: Final = struct.Struct("=qqq")  # kind, number (tick or serial), stamp_ns


class MessageKind(IntEnum):
    """First field of every message."""

    HELLO = 1  # agent, words: version, arm, config_id, joints; perhaps lockstep; of a guest watchdog_s
    INFO = 2  # plant, words: lockstep, rate_hz, utc_offset_ns (UTC minus its clock), limits
    REFUSED = 3  # plant, words: a Refusal; the connection ends
    POLL = 4  # agent: tell me the state now; number = serial
    REPLY = 5  # plant: STATE layout, number = serial of the POLL
    ENABLE = 6  # agent: torque on, at zero
    ENABLED = 7  # plant
    DISABLE = 8  # agent: torque off; in lockstep the plant does not wait for this arm any more
    STATE = 9  # plant, every tick: q, dq, tau; a guest's: true q and dq, tau, mean torque of its grasp; number = tick
    COMMAND = 10  # agent, once per tick: tau; a guest's: also what stays of it without it; number = tick it answers
    BYE = 11  # agent: end of the run for this arm
    NOTICE = 12  # plant, words: a Refusal that says why no state will come any more


KINDS: Final = {int(kind): kind for kind in MessageKind}


class FixedMessage:
    """A reusable fixed message of one kind: header and `count` doubles in one buffer."""

    def __init__(self, count: int) -> None:
        self.buffer = bytearray(HEADER.size + 8 * count)
        self.values: Vector = np.frombuffer(self.buffer, np.float64, count, HEADER.size)

    def head(self, kind: MessageKind, number: int, stamp_ns: int) -> None:
        """Write the header."""
        HEADER.pack_into(self.buffer, 0, kind, number, stamp_ns)


def state_layout(arrays: int, joint_count: int) -> struct.Struct:
    """Packs header and the bytes of so many arrays (n,) of doubles."""
    return struct.Struct(f"{HEADER.format}{8 * arrays * joint_count}s")


def words(kind: MessageKind, **content: object) -> bytes:
    """Message with named values."""
    return HEADER.pack(kind, 0, 0) + json.dumps(content).encode()


def header_only(kind: MessageKind, number: int = 0) -> bytes:
    """Message without content."""
    return HEADER.pack(kind, number, 0)


def read_words(message: bytes) -> dict[str, object]:
    """Named values of a message; empty when it is not what it says it is."""
    try:
        content = json.loads(message[HEADER.size :])
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def refusal_words(kind: MessageKind, refusal: Refusal) -> bytes:
    """A Refusal as a message."""
    found, expected = str(refusal.found)[:500], str(refusal.expected)[:500]
    return words(kind, what=refusal.what[:500], found=found, expected=expected, remedy=refusal.remedy[:500])


def refusal_parts(message: bytes) -> tuple[str, dict[str, str]]:
    """What a Refusal says, for the receiver to raise as an error of its own."""
    content = read_words(message)
    return str(content.get("what", "plant")), {k: str(content.get(k, "?")) for k in ("found", "expected", "remedy")}
