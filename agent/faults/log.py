"""A rehearsal as a log of its own, like that of a run: `coop report`, `coop events` and `coop view` read it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.atomic import require_place
from agent.config.schema.driver import DriverKind
from agent.faults.bench import ArmRun, Rehearsal
from agent.faults.virtual import UTC_OFFSET_NS
from agent.host.info import attachments
from agent.log.channels import LogChannels
from agent.log.file import Attachment, LogFile, LogFileError, LogInTheWay
from agent.process.describe import run_info
from agent.process.plant import Truth
from agent.process.scene import scene_of
from agent.telemetry.row.derive import RowEvents
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import PLANT_STATE
from agent.telemetry.row.topics import PLANT, Address, Kind

BATCH: Final = 200


def require_new(path: Path) -> None:
    """Refuse the name of a log that is there, before anything runs.

    Raises LogInTheWay, and LogFileError where it has no folder.
    """
    if path.exists() or path.is_symlink():
        raise LogInTheWay(f"log {path}", found="one of that name", expected="none", remedy="name another with --out")
    require_place(path, force=True, refusal=LogFileError)


def write_log(path: Path, run: Rehearsal) -> None:
    """Rows, truth, events and faults of a rehearsal; time is virtual and begins in 1970.  Raises LogFileError."""
    cell = run.cell
    files = attachments(cell, run_info(cell, DriverKind.DYNAMIXEL, 0))
    told = {"rehearsal": {str(i): f"{f.fault} {f.arm} {f.at_s:g} s" for i, f in enumerate(run.faults)}}
    log = LogFile(path, [Attachment(name, "text/plain", data) for name, data in files.items()], told, created_ns=1)
    channels = LogChannels(log, scene_of(cell), has_plant=True)
    rows = {name: arm.rows for name, arm in run.arms.items() if len(arm.rows)} | {PLANT: _truth(run)}
    for member, own in rows.items():
        for begin in range(0, len(own), BATCH):
            channels.write_rows(Rows(Address(cell.file.name, member, Kind.STATE), own[begin : begin + BATCH]))
    for event in sorted(_events(run), key=lambda event: event.utc_ns):
        address = Address(cell.file.name, event.source, Kind.EVENT)
        channels.write_text(Text(address, event.to_json(), event.utc_ns, event))
    log.finish({"completeness": {"complete": "true"}})


def _events(run: Rehearsal) -> Iterator[Event]:
    """What the arms' processes would have told, and the faults themselves."""
    for name, arm in run.arms.items():
        yield from RowEvents(name).watch(arm.rows)
        yield from _own_events(name, arm, run.zero_ns)
    for fault in run.faults:
        text = f"fault: {fault.fault} ({fault.possible.text})"
        yield Event(_utc_ns(fault.onset_s, run.zero_ns), str(fault.arm), Level.WARN, text, {"t": fault.onset_s})


def _own_events(name: str, arm: ArmRun, zero_ns: int) -> Iterator[Event]:
    for t, told in arm.events:
        if np.isfinite(t):
            where = "" if told.servo_id is None else f" (servo {told.servo_id}, {told.joint})"
            yield Event(_utc_ns(t, zero_ns), name, Level.WARN, f"{told.kind.value}{where}: {told.text}", {"t": t})
    for t, text in arm.warnings:
        yield Event(_utc_ns(t, zero_ns), name, Level.WARN, text, {"t": t})
    for t, text in arm.troubles:
        yield Event(_utc_ns(t, zero_ns), name, Level.WARN, f"holds: {text}", {"t": t})
    if arm.error is not None and len(arm.rows):
        yield Event(int(arm.rows["utc_ns"][-1]), name, Level.ERROR, str(arm.error))


def _stamp_ns(t: float, zero_ns: int) -> int:
    return max(0, zero_ns + round(t * 1e9))


def _utc_ns(t: float, zero_ns: int) -> int:
    return UTC_OFFSET_NS + _stamp_ns(t, zero_ns)


class _Kept:
    """Rows of the truth in memory."""

    def __init__(self) -> None:
        self.row: Any = np.zeros(1, PLANT_STATE.dtype)
        self.rows: list[Any] = []

    def commit(self) -> None:
        """Keep a copy."""
        self.rows.append(self.row[0].copy())

    def wait_for_space(self) -> None:
        """There is always space."""


def _truth(run: Rehearsal) -> NDArray[np.void]:
    kept = _Kept()
    truth = Truth(kept, run.plant, run.cell, UTC_OFFSET_NS, lockstep=False)
    for i, (t, seen) in enumerate(run.truth):
        truth.write(i, _stamp_ns(t, run.zero_ns), seen)
    return np.array(kept.rows, PLANT_STATE.dtype)
