"""Two faults at once, drawn from a seed: what must hold whatever they are."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.config.cell import Cell, load_cell
from agent.faults.bench import Rehearsal
from agent.faults.measure import GONE, Measured, measured
from agent.faults.plan import Injection
from agent.faults.rehearse import rehearse
from agent.modes import Mode

CELLS = ("two_wx200", "paper_real")
DURATION_S = 4.0
REACT_S = 0.1  # from the first fault that must stop its arm
STOPPING = (
    "servo-off", "servo-garbage", "servo-delayed", "bus-off", "bus-stuck", "bus-garbage", "bus-delayed",
    "bus-intermittent", "port-off", "agent-off", "agent-garbage",
)  # fmt: skip
STRICT_STEP = 1.02  # of the largest torque, for the rounding to whole counts


@dataclass(frozen=True)
class Pair:
    """Two faults, what they did, and what was not as it must be."""

    seed: int
    cell: str
    faults: tuple[Injection, ...]
    found: Measured
    missed: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        faults = [f"{f.fault} {f.arm} servo {f.servo} at {f.at_s:g} s" for f in self.faults]
        return {
            "seed": self.seed,
            "cell": self.cell,
            "faults": faults,
            "missed": list(self.missed),
            **self.found.document(),
        }


def drawn(seed: int) -> tuple[str, tuple[Injection, ...]]:
    """A cell and two faults: at once, soon after each other, or the second in the hold of the first."""
    rng = random.Random(seed)
    first_s = round(rng.uniform(1.0, 2.5), 3)
    second_s = round(first_s + rng.choice([0.0, rng.uniform(0.0, 0.05), rng.uniform(0.2, 1.0)]), 3)
    faults = tuple(
        Injection(
            fault=name,
            arm=rng.choice(["left", "right"]),
            servo=4 if name.startswith("servo") else None,
            at_s=at_s,
            for_s=round(rng.uniform(0.05, 0.5), 3) if name == "port-off" else float("inf"),
        )
        for name, at_s in zip(rng.sample(STOPPING, 2), (first_s, second_s), strict=True)
    )
    return rng.choice(CELLS), faults


def pair(seed: int) -> Pair:
    """Draw it, run it, judge it.  Raises Refusal."""
    name, faults = drawn(seed)
    cell = load_cell(Path(name), [f"duration_s={DURATION_S}"])
    run = rehearse(cell, faults, seed=seed)
    found = measured(run)
    missed = tuple(_missed(cell, run, found))
    if seed % 5 == 0 and not same(run, rehearse(cell, faults, seed=seed)):
        missed = (*missed, "another run of the same seed has other rows")
    return Pair(seed, name, run.faults, found, missed)


def _missed(cell: Cell, run: Rehearsal, found: Measured) -> Iterator[str]:
    for arm, at in found.stopped_s.items():
        mine = [f.at_s for f in run.faults if f.arm == arm]
        if mine and found.ended[arm] != GONE:
            late = None if at is None else at - (min(mine) - min(f.at_s for f in run.faults))
            if late is None or late > REACT_S:
                yield f"{arm} stopped {'never' if late is None else f'{late:.3g} s after its fault'}"
    for name, arm_run in run.arms.items():
        modes = arm_run.rows["mode"]
        if (np.diff(np.flatnonzero(modes == Mode.TRACK)) > 1).any():
            yield f"{name} went back to the motion"
        bound = cell.arm(name).tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall
        sent = np.abs(arm_run.rows["tau_sent"][:, : len(bound)])
        if np.nanmax(sent / bound) > STRICT_STEP:
            yield f"{name} sent {np.nanmax(sent / bound):.3g} of its largest torque"


def same(one: Rehearsal, other: Rehearsal) -> bool:
    """Whether all rows are equal to the bit."""
    return all(run.rows.tobytes() == other.arms[name].rows.tobytes() for name, run in one.arms.items())
