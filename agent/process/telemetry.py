"""The telemetry process of one arm or of the plant: its ring to the recorder; it computes no dynamics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agent.config.files import CellFiles
from agent.telemetry.link import publish
from agent.telemetry.link.session import Network
from agent.telemetry.row import topics
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE


def run_telemetry(
    cell: CellFiles,
    member: str,
    ring: Path,
    network: Network,
    *,
    lockstep: bool,
    follow: bool,
    stop: Callable[[], bool],
    ready: Callable[[str], None],
    say: Callable[[str], None],
) -> publish.PublishReport:
    """Publish the ring of an arm or of topics.PLANT until the recorder has it, or a stop.  Raises Refusal.

    follow: go on with the ring of the next agent; say: is told in words what is waited for.
    """
    is_plant = member == topics.PLANT
    if not is_plant:
        cell.index(member)  # refuses a member that the cell does not have
    options = publish.PublishOptions(
        cell=cell.file.name,
        member=member,
        ring=ring,
        layout=PLANT_STATE if is_plant else AGENT_STATE,
        fingerprint=cell.fingerprint,
        network=network,
        pace=publish.Pace.LOCKSTEP if lockstep else publish.Pace.REAL_TIME,
        follow=follow,
        info={"cell": cell.file.name, "fingerprint": cell.fingerprint, "member": member},
    )
    return publish.run(options, stop, lambda name: ready(f"member={name}"), say)
