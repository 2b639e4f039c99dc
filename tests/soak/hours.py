"""Two hours of a recorder in a few minutes: as many rows, texts and logs as come in, without network and clock.

What the recorder keeps of what it has recorded is counted in blocks of memory, which is exact, at the same point of
each log; what would be added in the hours that were left out is worked out from there.
"""

from __future__ import annotations

import gc
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import psutil

from agent.log.parts import Limits
from agent.telemetry.link.record import RecordOptions, _Recorder
from agent.telemetry.link.wire import BatchHeader, Sent, seal_of
from agent.telemetry.row.event import Event, Level, encode
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Address, Kind
from tests.soak.flat import growth
from tests.soak.watch import say
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import CELL, CONFIG_ID, SERVOS, UTC_0_NS, make_rows

ARMS: Final = dict.fromkeys(("first", "second", "third", "fourth"), ("waist", "shoulder", "elbow"))
RATE_HZ, BATCH_ROWS = 500, 125
FULL_S: Final = 7200.0
EVENT_EVERY_S: Final = 60
LOGS_MIN: Final = 8
LOG_BYTES, FOLDER_BYTES = 8 << 20, 64 << 20
BLOCKS_MAX: Final = 20_000  # in FULL_S: one or two megabytes
MEMORY_MAX_MB: Final = 3.0  # of the process, over what was really recorded


@dataclass
class Taken:
    """Samples at the beginning of each log."""

    rows: list[float] = field(default_factory=list)
    blocks: list[float] = field(default_factory=list)
    memory_MB: list[float] = field(default_factory=list)

    def look(self, rows: int) -> None:
        gc.collect()
        self.rows.append(float(rows))
        self.blocks.append(float(sys.getallocatedblocks()))
        self.memory_MB.append(psutil.Process().memory_info().rss / 1e6)


class Publisher:
    """One arm's messages, as its telemetry sends them."""

    def __init__(self, arm: str, number: int) -> None:
        self._keys = {kind: Address(CELL, arm, kind).key for kind in (Kind.STATE, Kind.EVENT, Kind.HEALTH)}
        self._by = Sent(seal_of(CELL, "", arm, AGENT_STATE), 1000 + number)
        self._sent = dict.fromkeys(self._keys, 0)
        self._some = make_rows(arm, BATCH_ROWS)
        self._some["mode"] = self._some["mode"][-1]

    def rows(self, recorder: _Recorder) -> None:
        """A batch."""
        first, rows = self._sent[Kind.STATE], self._some
        rows["sequence"] = first + np.arange(BATCH_ROWS)
        rows["stamp_ns"] = rows["sequence"].astype(np.int64) * (1_000_000_000 // RATE_HZ)
        rows["utc_ns"] = UTC_0_NS + rows["stamp_ns"]
        rows["t"] = rows["stamp_ns"] * 1e-9
        self._put(recorder, Kind.STATE, rows.tobytes(), BATCH_ROWS)

    def texts(self, recorder: _Recorder, second: int, events: int) -> None:
        """The health of one second, and so many events."""
        utc_ns = UTC_0_NS + second * 1_000_000_000
        self._put(recorder, Kind.HEALTH, encode({"utc_ns": utc_ns, **SERVOS}), 1)
        for number in range(events):
            event = Event(utc_ns + number, "first", Level.INFO, f"second {second}, event {number}")
            self._put(recorder, Kind.EVENT, event.to_json(), 1)

    def _put(self, recorder: _Recorder, kind: Kind, payload: bytes, count: int) -> None:
        first = self._sent[kind]
        self._sent[kind] = first + count
        source = self._by.run if kind is Kind.STATE else self._by.run + 500
        header = BatchHeader(source, first, first + count, 0)
        recorder._take(self._keys[kind], payload, header.pack(self._by, payload))


def hours(folder: Path, seconds: float) -> list[str]:
    """Rows of so many seconds of four arms, with the texts of FULL_S, through the recorder: memory stays flat."""
    limits = Limits(part_bytes=LOG_BYTES, folder_bytes=FOLDER_BYTES)
    options = RecordOptions(folder / "run.mcap", scene(CELL, ARMS), CONFIG_ID, min_free_bytes=1 << 20, limits=limits)
    recorder, taken, begin_s = _Recorder(options, {}), Taken(), time.monotonic()
    publishers = [Publisher(arm, number) for number, arm in enumerate(ARMS)]
    texts_each = max(1, round(FULL_S / seconds))  # of a second: those of the hours that are left out come, too
    rows = logs = 0
    for batch in range(round(seconds * RATE_HZ / BATCH_ROWS)):
        for publisher in publishers:
            publisher.rows(recorder)
            if batch % (RATE_HZ // BATCH_ROWS) == 0:
                for number in range(texts_each):
                    second = batch * BATCH_ROWS // RATE_HZ * texts_each + number
                    publisher.texts(recorder, second, events=int(second % EVENT_EVERY_S == 0))
        rows += BATCH_ROWS * len(publishers)
        recorder._log.tick(time.monotonic())
        if len(recorder.logs) > logs:
            logs = len(recorder.logs)
            taken.look(rows)
    recorder.finish()
    took_s = time.monotonic() - begin_s
    say(f"{rows} rows and {texts_each * round(seconds) * len(ARMS)} health texts in {took_s:.0f} s, {logs} logs")
    refused = sum(recorder._intake.rejected.values())
    return judged(taken, FULL_S / seconds) + ([f"{refused} messages were refused"] if refused else [])


def judged(taken: Taken, times: float) -> list[str]:
    """What grew; `times` as many rows are in FULL_S."""
    if len(taken.rows) < LOGS_MIN:
        return [f"{len(taken.rows)} logs say nothing of growth, at least {LOGS_MIN} are needed"]
    blocks, memory = growth(taken.rows, taken.blocks), growth(taken.rows, taken.memory_MB)
    say(f"  blocks {blocks.settled:.0f} → {blocks.last:.0f}, memory {memory.settled:.1f} → {memory.last:.1f} MB")
    complaints = []
    if blocks.rise * times > BLOCKS_MAX:
        complaints.append(f"{blocks.rise * times:.0f} blocks of memory more in {FULL_S:g} s, at most {BLOCKS_MAX}")
    if memory.rise > MEMORY_MAX_MB:
        complaints.append(f"memory rose by {memory.rise:.1f} MB, at most {MEMORY_MAX_MB:g}")
    return complaints
