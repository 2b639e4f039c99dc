"""How often a cell holds by itself when nothing has failed: shipped cells in realities within their tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import configs
from agent.config.cell import load_cell
from agent.study.lab import Laboratory
from agent.study.measure import RunResult, measure
from agent.study.plan import Task
from agent.study.work import cores, here, in_processes

RUN_S = 25.0  # of the trajectory, a motion of the paper and two thirds


@dataclass(frozen=True)
class FalseTrips:
    """What so much simulated time brought."""

    simulated_s: float
    runs: int
    trips: tuple[str, ...]  # cell, seed and reason of each

    @property
    def per_hour(self) -> float:
        """Trips per simulated hour."""
        return 3600.0 * len(self.trips) / self.simulated_s if self.simulated_s else 0.0

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "id": "false trips",
            "verdict": "not tested" if not self.runs else "missed" if self.trips else "met",
            "detected_s": None,
            "reacted_s": None,
            "bound": "no hold without a fault",
            "simulated_s": round(self.simulated_s, 1),
            "runs": self.runs,
            "per_hour": round(self.per_hour, 3),
            "missed": list(self.trips),
        }


def false_trips(simulated_s: float, seed: int) -> FalseTrips:
    """Run the cells that notice in so much time of drawn realities, and those that do not once as their files say."""
    cells = [load_cell(path, [f"duration_s={RUN_S}"]) for path in _carrying()]
    noticing = [cell for cell in cells if cell.file.safety.noticing.enabled]
    each = math.ceil(simulated_s / RUN_S / len(noticing))
    tasks = [
        Task(cell.toml, f"{cell.file.name}.toml", i, number, seed + number, ())
        for number in range(each)
        for i, cell in enumerate(noticing)
    ]
    work = here if cores() == 1 else lambda some: in_processes(some, cores())
    found = [result for _, result in work(tasks)] if tasks else []
    if tasks:
        found += [measure(Laboratory(cell), None) for cell in cells if cell not in noticing]
    return FalseTrips(len(found) * RUN_S, len(found), tuple(_told(r) for r in found if r.tripped or r.lost))


def _carrying() -> list[Path]:
    """Shipped cells in which arms carry an object; those that identify an arm do not."""
    return [path for path in sorted(configs.CELLS_DIR.glob("*.toml")) if not path.stem.startswith("identify")]


def _told(result: RunResult) -> str:
    return f"{result.cell}, reality {result.seed}: {result.why}"
