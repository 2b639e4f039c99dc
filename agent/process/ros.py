"""The process that shows a cell to ROS 2: from the cell's files to the bridge; it computes no dynamics."""

from __future__ import annotations

from collections.abc import Callable

from agent.config.files import CellFiles
from agent.host.ready_line import pairs
from agent.process.scene import scene_of
from agent.ros import bridge
from agent.telemetry.link.session import Network


def run_ros(
    cell: CellFiles,
    telemetry: Network,
    ros: Network,
    *,
    domain: int,
    has_plant: bool,
    clock: bool,
    stop: Callable[[], bool],
    ready: Callable[[str], None],
    tell: Callable[[str], None],
) -> bridge.BridgeReport:
    """Show the cell until a stop.  Raises Refusal."""
    options = bridge.BridgeOptions(
        scene_of(cell), cell.config_id, has_plant, telemetry, ros, domain=domain, clock=clock
    )
    return bridge.run(options, stop, lambda name: ready(pairs(node=name)), tell)
