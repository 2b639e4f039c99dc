"""The recorder and telemetry processes of a cell, composed from the cell file; neither can reach an arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agent.config.cell import Cell
from agent.config.schema.cell import DriverKind
from agent.host.info import attachments, run_info
from agent.log.file import Attachment
from agent.telemetry.link import publish, record
from agent.telemetry.link.session import FREE_PORT, Network
from agent.telemetry.row import topics
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE


@dataclass(frozen=True)
class RecorderOptions:
    """How the recorder of a cell is started."""

    log: Path
    driver: DriverKind
    has_plant: bool
    seed: int
    listen: str
    network_config: Path | None


@dataclass(frozen=True)
class TelemetryOptions:
    """How the telemetry of one member of a cell is started."""

    member: str  # arm, or topics.PLANT
    ring: Path
    connect: str
    network_config: Path | None
    lockstep: bool
    follow: bool  # go on with the ring of the next agent


def run_recorder(
    cell: Cell, options: RecorderOptions, stop: Callable[[], bool], ready: Callable[[str], None]
) -> record.RecordReport:
    """Record the cell until a stop; ready is told the endpoint.  Raises Refusal."""
    normal = cell.model(cell.arms[0]).plane_normal
    info = run_info(cell, options.driver, options.seed, None if normal is None else normal.tolist())
    files = tuple(Attachment(name, _media_type(name), content) for name, content in attachments(cell, info).items())
    network = Network(config_file=options.network_config) if options.network_config else Network(listen=options.listen)
    return record.run(
        record.RecordOptions(
            path=options.log,
            cell=cell.file.name,
            arms={arm.name: tuple(arm.entry.controlled) for arm in cell.arms},
            config_id=cell.config_id,
            has_plant=options.has_plant,
            network=network,
            attachments=files,
            metadata={"versions": info["versions"], "cell": {"name": cell.file.name, "fingerprint": cell.fingerprint}},
        ),
        stop,
        lambda endpoint: ready(f"endpoint={endpoint}"),
    )


def run_telemetry(
    cell: Cell, options: TelemetryOptions, stop: Callable[[], bool], ready: Callable[[str], None]
) -> publish.PublishReport:
    """Publish the ring of one member until the recorder has it, or a stop.  Raises Refusal."""
    if options.member != topics.PLANT:
        cell.arm(options.member)
    network = (
        Network(config_file=options.network_config) if options.network_config else Network(connect=(options.connect,))
    )
    return publish.run(
        publish.PublishOptions(
            cell=cell.file.name,
            member=options.member,
            ring=options.ring,
            layout=PLANT_STATE if options.member == topics.PLANT else AGENT_STATE,
            network=network,
            pace=publish.Pace.LOCKSTEP if options.lockstep else publish.Pace.REAL_TIME,
            follow=options.follow,
            info={"cell": cell.file.name, "fingerprint": cell.fingerprint, "member": options.member},
        ),
        stop,
        lambda member: ready(f"member={member}"),
    )


def _media_type(name: str) -> str:
    return {"json": "application/json", "toml": "application/toml"}.get(name.rpartition(".")[2], "application/xml")


__all__ = ["FREE_PORT", "RecorderOptions", "TelemetryOptions", "run_recorder", "run_telemetry"]
