"""A stranger on the cell's network: one burst of random messages, or of rows that look like an arm's and are not."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from agent.config.cell import Cell
from agent.telemetry.link.session import Network, Role, open_session
from agent.telemetry.link.wire import HEADER_BYTES, BatchHeader, Sent, seal_of
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import ROOT, Address, Kind, status_key

BURST: Final = 200  # messages under each key
ROWS: Final = 50  # that are forged: the newest of the arm's
ALTERED_Nm: Final = 1.0  # added to each torque of these
HEARD_TIMEOUT_S: Final = 5.0

Message = tuple[str, bytes, bytes | None]  # key, payload, attachment


def random_messages(cell: str, arm: str, seed: int) -> Iterator[Message]:
    """Under every key of the arm, and under one that there is not: some with a header, which is random, too."""
    rng = np.random.default_rng(seed)
    keys = [Address(cell, arm, kind).key for kind in Kind] + [f"{ROOT}/{cell}/{arm}/command"]
    for number in range(BURST):
        for key in keys:
            header = rng.bytes(HEADER_BYTES) if number % 2 else None
            yield key, rng.bytes(1 + int(rng.integers(5000))), header


def forged_messages(cell: Cell, arm: str, rows: bytes) -> Iterator[Message]:
    """The rows (AGENT_STATE) with other torques, and an event, as a member sends them who has other files."""
    altered = np.frombuffer(rows, AGENT_STATE.dtype).copy()
    altered["tau_limited"] += ALTERED_Nm
    name, count, source = cell.file.name, len(altered), int.from_bytes(os.urandom(7), "little") | 1
    by = Sent(seal_of(name, cell.fingerprint[::-1], arm, AGENT_STATE), source)
    payload = altered.tobytes()
    header = BatchHeader(source, 0, count, 0)
    yield Address(name, arm, Kind.STATE).key, payload, header.pack(by, payload)
    last_ns = int(altered["utc_ns"][-1]) if count else 0
    text = Event(last_ns, arm, Level.ERROR, "mode TRACK → FAULT").to_json()
    yield Address(name, arm, Kind.EVENT).key, text, BatchHeader(source, 0, 1, 0).pack(by, text)


def last_rows(ring: Path) -> bytes:
    """The newest rows of an arm."""
    with RingReader(ring, AGENT_STATE) as reader:
        return reader.read_last(ROWS).payload


def send(endpoint: str, cell: str, messages: Iterator[Message]) -> int:
    """Connect to the recorder and send; returns how many once it has them all, or is silent.  Raises NetworkError."""
    sent = 0
    with open_session(Network(connect=(endpoint,), role=Role.VIEWER)) as opened:
        for key, payload, attachment in messages:
            opened.put(key, payload, attachment)
            sent += 1
        for _ in opened.session.get(status_key(cell), timeout=HEARD_TIMEOUT_S):  # behind them, on the same link
            pass
    return sent
