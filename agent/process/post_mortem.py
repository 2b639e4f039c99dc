"""The post-mortem of an arm: what its ring still holds of the time before its agent was gone, as a log.

`python -m agent.process.post_mortem CELL ARM RING OUT CAUSE` writes it; a guard starts this beside the hold.  The file
has its name once it is whole.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from agent.atomic import make_folder
from agent.config.cell import load_cell
from agent.guard.black_box import UNFINISHED
from agent.host.info import attachments, versions
from agent.log.channels import LogChannels
from agent.log.file import Attachment, LogFile, LogFileError
from agent.process.describe import run_info
from agent.process.scene import scene_of
from agent.telemetry.ring.file import RingError
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.event import UTC_END_NS, Event, health_time
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Address, Kind
from drivers.interface import Refusal

NAME = "post_mortem"  # of the metadata record


def write_post_mortem(cell_path: Path, arm: str, ring: Path, out: Path, cause: str) -> int:
    """Write the log; how many rows it has.  Raises Refusal, and leaves what was written as OUT.part."""
    cell = load_cell(cell_path)
    make_folder(out.parent)
    info = run_info(cell, cell.file.driver, seed=0, alone=arm)
    files = [Attachment(name, "text/plain", content) for name, content in attachments(cell, info).items()]
    about = {
        "versions": versions(),
        "cell": {"name": cell.file.name, "fingerprint": cell.fingerprint},
        NAME: {"arm": arm, "cause": cause},
    }
    part = out.with_name(out.name + UNFINISHED)
    file = LogFile(part, files, about, created_ns=time.time_ns())
    channels = LogChannels(file, scene_of(cell), has_plant=False)
    rows, left_out = _write_rows(channels, Address(cell.file.name, arm, Kind.STATE), ring)
    _write_texts(channels, cell.file.name, arm, ring)
    ended = {"complete": "false", f"{arm}.end": "died", f"{arm}.rows_recorded": str(rows)}
    if left_out:
        ended["rejected.impossible_time"] = str(left_out)  # as a recorder counts them
    if not file.finish({"completeness": ended}):
        raise LogFileError(
            f"cannot finish {part}", found=file.failure, expected="a disk that takes the whole log",
            remedy=f"make room; `coop recover {part}` mends what is there",
        )  # fmt: skip
    try:
        part.rename(out)
    except OSError as error:
        raise LogFileError(
            f"cannot name {out}", found=error.strerror, expected="a name that is free, in a folder to write into",
            remedy=f"the whole post-mortem is {part}; give it another name",
        ) from error  # fmt: skip
    return rows


def _write_rows(channels: LogChannels, address: Address, ring: Path) -> tuple[int, int]:
    """How many rows were written, and how many left out: no message can have their time."""
    count = left_out = 0
    with RingReader(ring, AGENT_STATE) as reader:
        end = reader.written
        while reader.next_index < end:
            block = reader.read_new(1024)  # none of it where a row is damaged, and then what is behind that
            rows = np.frombuffer(block.payload, AGENT_STATE.dtype)
            kept = rows[(rows["utc_ns"] >= 0) & (rows["utc_ns"] < UTC_END_NS)]
            if len(kept):
                channels.write_rows(Rows(address, kept))
            count += len(kept)
            left_out += len(rows) - len(kept)
    return count, left_out


def _write_texts(channels: LogChannels, cell: str, arm: str, ring: Path) -> None:
    try:
        reader = TextReader(ring)
    except RingError:
        return
    with closing(reader):
        for kind, payload in reader.read_new():
            try:
                event = Event.from_json(payload) if kind is Kind.EVENT else None
                utc_ns = event.utc_ns if event is not None else health_time(payload)
            except ValueError:  # one that makes no sense keeps nothing else out
                continue
            channels.write_text(Text(Address(cell, arm, kind), payload, utc_ns, event))


if __name__ == "__main__":
    cell_file, name, ring_file, target, why = sys.argv[1:]
    try:
        write_post_mortem(Path(cell_file), name, Path(ring_file), Path(target), why)
    except Refusal as refusal:
        sys.stderr.write(f"post-mortem: {refusal}\n")
        sys.exit(refusal.exit_code)
