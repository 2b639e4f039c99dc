"""The part of a check that takes up to a second: monitors' bounds, how near bodies come, what reality may make of it.

Nobody loads it who does not ask for it: agents and plant of a simulated cell start without.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.config import monitors
from agent.config.cell import Cell
from agent.control.life import Life
from agent.control.models import ArmModel
from agent.verify.alignment_room import alignment_room
from agent.verify.asked import asked
from agent.verify.collision.findings import collisions
from agent.verify.collision.scene import Scene
from agent.verify.finding import Finding
from agent.verify.path import Path
from agent.verify.robustness import Robustness, Walk, robustness
from agent.verify.unaligned import unaligned
from agent.verify.watched import watched
from agent.verify.ways import ways


def examine_thoroughly(
    cell: Cell, models: Sequence[ArmModel], paths: Sequence[Path], instants: Sequence[float], of_arms: Sequence[Life]
) -> tuple[list[Finding], Robustness]:
    """Findings, and figures of what reality may make of the cell; instants: of the paths, s; of_arms: [session]."""
    each, along = [p.q for p in paths], list(zip(*(p.q for p in paths), strict=True))
    scene, bounds = Scene(cell, models), monitors.bounds_of_all(cell)
    findings = [
        *watched(cell, bounds),
        *asked(cell, bounds, models, paths, instants),
        *collisions(cell, models, each, instants, scene),
        *ways(cell, models, scene, of_arms, each, instants),
        *unaligned(cell, models, along[0]),
    ]
    found = robustness(Walk(cell, models, along, instants))
    return [*findings, *found.findings(), *alignment_room(cell, models, along, instants, scene)], found
