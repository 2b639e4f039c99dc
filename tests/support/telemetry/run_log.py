"""Logs of loops that ran in this process: real rows of a real law, with the files of their cell inside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from mcap.writer import Writer

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.host.info import attachments
from agent.log.channels import LogChannels
from agent.log.file import Attachment, LogFile
from agent.process.describe import run_info
from agent.process.scene import scene_of
from agent.telemetry.row.received import Rows
from agent.telemetry.row.sample import AGENT_STATE, Layout
from agent.telemetry.row.topics import Address, Kind
from tests.support.telemetry.telemetry_cell import CONFIG_ID

BATCH = 100


def write_run(
    path: Path,
    cell: Cell,
    rows: Mapping[str, np.ndarray],
    *,
    left_out: tuple[str, ...] = (),
    in_chunk: int = 0,
    told: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """A complete log of these rows by arm, and of the plant; left_out: files of the cell that shall not be in it;
    in_chunk: rows in each chunk, as many as fit without it; told: what the recorder says of them.  Rows that were made
    without a cell become those of this one."""
    files = attachments(cell, run_info(cell, DriverKind.SIM, 0))
    kept = [Attachment(name, "text/plain", data) for name, data in files.items() if name not in left_out]
    log = LogFile(path, kept, {}, created_ns=1, min_free_bytes=0)
    name = cell.file.name
    channels = LogChannels(log, scene_of(cell), has_plant="plant" in rows)
    for arm, own in of_cell(cell, rows).items():
        for begin in range(0, len(own), in_chunk or BATCH):
            channels.write_rows(Rows(Address(name, arm, Kind.STATE), own[begin : begin + (in_chunk or BATCH)]))
            if in_chunk:
                log.flush(0.0)
    assert log.finish({"completeness": {"complete": "true", **told}})
    return path


def of_cell(cell: Cell, rows: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The rows, those without a configuration with that of the cell."""
    own = {member: given.copy() for member, given in rows.items()}
    for taken in own.values():
        taken["config_id"][np.isin(taken["config_id"], (0, CONFIG_ID))] = cell.config_id
    return own


def write_other_release(
    path: Path, cell: Cell, rows: Mapping[str, np.ndarray], *, without: tuple[str, ...], memory: int | None = None
) -> Path:
    """The same as a release wrote it whose rows had not these fields, and a memory of another length."""
    fields = [
        replace(f, length=memory) if memory is not None and f.name == "memory" else f
        for f in AGENT_STATE.fields
        if f.name not in without
    ]
    layout = Layout(AGENT_STATE.ros_name, tuple(fields))
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "widowx-coop")
        for name, data in attachments(cell, run_info(cell, DriverKind.SIM, 0)).items():
            writer.add_attachment(0, 0, name, "text/plain", data)
        writer.add_metadata("versions", {"widowx-coop": "0.0.7"})
        schema = writer.register_schema("coop_msgs/msg/AgentState", "ros2msg", layout.definition.encode())
        for arm, own in rows.items():
            channel = writer.register_channel(Address(cell.file.name, arm, Kind.STATE).topic, "cdr", schema)
            old = np.zeros(len(own), layout.dtype)
            for name in old.dtype.names or ():
                length = memory if name == "memory" else None
                old[name] = own[name][:, :length] if length else own[name]
            for row in old:
                writer.add_message(channel, int(row["utc_ns"]), row.tobytes(), 0, int(row["sequence"]))
        writer.finish()
    return path


def flipped(rows: np.ndarray, row: int, field: str, byte: int = 0, bit: int = 0) -> np.ndarray:
    """The rows with one bit changed."""
    changed = rows.copy()
    offset = AGENT_STATE.dtype.fields[field][1]
    changed.view(np.uint8).reshape(len(rows), -1)[row, offset + byte] ^= 1 << bit
    return changed
