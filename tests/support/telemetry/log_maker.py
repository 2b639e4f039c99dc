"""Logs written by the recorder's own file classes, without a network."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from agent.log.channels import LogChannels
from agent.log.file import Attachment, LogFile
from agent.telemetry.row.event import Event
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.topics import PLANT, Address, Kind
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import ARMS, CELL, make_rows

RUN_JSON = b'{"cell": "paper", "rate_hz": 200.0}'


class LogMaker:
    """A log that is being written batch by batch."""

    def __init__(
        self,
        path: Path,
        *,
        has_plant: bool = True,
        min_free_bytes: int = 1 << 20,
        arms: Mapping[str, tuple[str, ...]] = ARMS,
        about: Mapping[str, str] | None = None,
    ) -> None:
        """about: what the recorder tells of itself beside its host."""
        attachments = [Attachment("run.json", "application/json", RUN_JSON)]
        recorder = {"recorder": {"host": "bench", **(about or {})}}
        self.file = LogFile(path, attachments, recorder, created_ns=1, min_free_bytes=min_free_bytes)
        self.channels = LogChannels(self.file, scene(CELL, arms), has_plant=has_plant)
        self._now_s = 1e9

    def write(self, member: str, rows: np.ndarray) -> None:
        self.channels.write_rows(Rows(Address(CELL, member, Kind.STATE), rows))

    def event(self, event: Event) -> None:
        self.channels.write_text(Text(Address(CELL, "left", Kind.EVENT), event.to_json(), event.utc_ns, event))

    def health(self, utc_ns: int, payload: bytes, arm: str = "left") -> None:
        self.channels.write_text(Text(Address(CELL, arm, Kind.HEALTH), payload, utc_ns, None))

    def flush(self) -> None:
        self._now_s += 1.0
        self.file.tick(self._now_s)

    def finish(self, complete: bool = True) -> bool:
        return self.file.finish({"completeness": {"complete": str(complete).lower()}})

    def abandon(self) -> None:
        """Leave the file as a recorder does that is killed right after a flush."""
        self.file._syncer.stop()
        self.file._open = False
        os.close(self.file._fd)


def make_log(
    path: Path,
    count: int = 100,
    *,
    batches: int = 5,
    finish: bool = True,
    events: Sequence[Event] = (),
    plant: bool = True,
) -> dict[str, np.ndarray]:
    """A log of two arms and the plant; returns its rows by member."""
    maker = LogMaker(path, has_plant=plant)
    rows = {member: make_rows(member, count) for member in (*ARMS, *([PLANT] if plant else ()))}
    for part in np.array_split(np.arange(count), batches):
        for member, all_rows in rows.items():
            maker.write(member, all_rows[part])
        maker.flush()
    for event in events:
        maker.event(event)
    maker.flush()
    if finish:
        maker.finish()
    else:
        maker.abandon()
    return rows
