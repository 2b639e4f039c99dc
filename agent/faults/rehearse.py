"""A run with faults, by the cell: all arms on emulated servos, or those alone that [hil] puts in the loop."""

from __future__ import annotations

from collections.abc import Sequence

from agent.config.cell import Cell
from agent.faults.bench import Bench, Rehearsal
from agent.faults.loop_bench import LoopBench
from agent.faults.plan import Injection, placed, require_fit


def rehearse(cell: Cell, faults: Sequence[Injection], seed: int = 1) -> Rehearsal:
    """Run the cell from READY on with these faults; seed: of what is random on the bus.  Raises Refusal."""
    chosen, hil = placed(faults, [arm.name for arm in cell.arms]), cell.file.hil
    require_fit(chosen, None if hil is None else hil.arms)
    return (Bench if hil is None else LoopBench)(cell, chosen, seed).run()
