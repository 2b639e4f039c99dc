"""The recorder process of a cell: everything the cell publishes into one log that describes itself.

It computes no dynamics and loads nothing that does; what run.json holds of the models comes from another process.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from agent.config.files import CellFiles
from agent.config.schema.driver import DriverKind
from agent.host import python
from agent.host.info import attachments
from agent.host.ready_line import pairs
from agent.log.file import Attachment
from agent.log.parts import Limits, only_recorder
from agent.process.scene import scene_of
from agent.telemetry.link import record
from agent.telemetry.link.session import Network
from drivers.interface import Refusal

_MEDIA_TYPES = {"json": "application/json", "toml": "application/toml"}


class DescriptionError(Refusal):
    """What the log shall say of its run cannot be had, or is of another cell."""

    exit_code = 4


def run_recorder(
    cell: CellFiles,
    log: Path,
    network: Network,
    run_info: bytes,
    *,
    has_plant: bool,
    limits: Limits,
    alone: bool,
    stop: Callable[[], bool],
    ready: Callable[[str], None],
    ended: Callable[[Path, str], None],
) -> record.RecordReport:
    """Record the cell until a stop; ready is told the endpoint, ended why a log ends before its time.  Raises Refusal.

    run_info: content of run.json; alone: refuse when another recorder of the cell is at work in the log's folder.
    """
    info = json.loads(run_info)
    if info.get("fingerprint") != cell.fingerprint:
        raise DescriptionError(
            "description of the run",
            found=f"cell {str(info.get('fingerprint'))[:12]}",
            expected=f"cell {cell.fingerprint[:12]}",
            remedy="do not change the cell file while the recorder starts",
        )
    files = attachments(cell, run_info)
    options = record.RecordOptions(
        path=log,
        scene=scene_of(cell),
        config_id=cell.config_id,
        fingerprint=cell.fingerprint,
        has_plant=has_plant,
        network=network,
        attachments=tuple(Attachment(name, _media_type(name), content) for name, content in files.items()),
        limits=limits,
        ended=ended,
        metadata={"versions": info["versions"], "cell": {"name": cell.file.name, "fingerprint": cell.fingerprint}},
    )
    with only_recorder(log.parent, cell.file.name) if alone else nullcontext() as note:
        if note is not None:  # for `coop status`
            options = replace(options, left_out=lambda counts: note(json.dumps({"left_out": dict(counts)}).encode()))
        return record.run(options, stop, lambda endpoint: ready(pairs(endpoint=endpoint)))


def described(cell: Path, driver: DriverKind, seed: int) -> bytes:
    """run.json of the cell at that path, from a process that ends when it is made.  Raises DescriptionError."""
    command = python.command("agent.process.describe", str(cell), driver.value, str(seed))
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, check=False, env=python.surroundings(),
        start_new_session=True,  # Ctrl-C and Ctrl-Z are for the recorder
    )  # fmt: skip
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise DescriptionError(
            f"description of cell {cell}", found=last, expected="run.json", remedy="see what `coop check` says of it"
        )
    return done.stdout


def _media_type(name: str) -> str:
    return _MEDIA_TYPES.get(name.rpartition(".")[2], "application/xml")
