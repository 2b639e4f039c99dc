"""When the motion of a run at the wall clock's pace starts: the run writes it down, what moves the arms reads it.

Pushes and openings of a cell count from there, and nothing befalls the cell before it is known.  Where nobody writes it
down (`coop emulate`, `coop plant --real-time` by hand) they count as in lockstep, from `simulation.ready_s` after the
plant's own begin.
"""

from __future__ import annotations

from pathlib import Path

from agent.atomic import write_atomically
from agent.config.cell import Cell
from sim_backend.physics.build import AnyPlant


def say(path: Path, start_utc_ns: int) -> None:
    """The start has been given."""
    write_atomically(path, f"{start_utc_ns}\n".encode())


class CommonStart:
    """The start, looked for until it is there."""

    def __init__(self, path: Path | None, plant: AnyPlant, cell: Cell, utc_offset_ns: int) -> None:
        """utc_offset_ns: UTC minus the clock on which it is looked for."""
        self._path = path if plant.spec.happenings else None
        self._plant, self._ready_s, self._utc_offset_ns = plant, cell.file.simulation.ready_s, utc_offset_ns
        if self._path is not None:
            plant.calendar.wait()

    def look(self, now_ns: int) -> None:
        """The plant has come to this instant of that clock."""
        if self._path is None or not self._path.exists():
            return
        in_s = (int(self._path.read_bytes()) - self._utc_offset_ns - now_ns) * 1e-9
        self._plant.calendar.go(self._plant.t + in_s - self._ready_s)
        self._path = None
