"""The telemetry process of one arm or of the plant: its ring to the recorder; it computes no dynamics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agent.host.ready_line import pairs
from agent.telemetry.link import publish
from agent.telemetry.link.publication import Pace, PublishOptions, PublishReport
from agent.telemetry.link.session import Network
from agent.telemetry.row import topics
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE


def run_telemetry(
    cell: str,
    fingerprint: str,
    member: str,
    ring: Path,
    network: Network,
    *,
    joints: tuple[str, ...] | None,
    lockstep: bool,
    follow: bool,
    fresh: bool,
    stop: Callable[[], bool],
    ready: Callable[[str], None],
    say: Callable[[str], None],
) -> PublishReport:
    """Publish the ring of an arm, or of topics.PLANT, until the recorder has it, or a stop.  Raises Refusal.

    cell, fingerprint: its name and that of its files, which the recorder must have, too.  joints: the member's, in
    order, where its ring may be another's.  follow: go on with the ring of the next agent; fresh: take none that an
    earlier run has left; say: is told in words what is waited for.
    """
    options = PublishOptions(
        cell=cell,
        member=member,
        ring=ring,
        layout=PLANT_STATE if member == topics.PLANT else AGENT_STATE,
        joints=joints,
        fingerprint=fingerprint,
        network=network,
        pace=Pace.LOCKSTEP if lockstep else Pace.REAL_TIME,
        follow=follow,
        fresh=fresh,
        info={"cell": cell, "fingerprint": fingerprint, "member": member},
    )
    return publish.run(options, stop, lambda name: ready(pairs(member=name)), say)
