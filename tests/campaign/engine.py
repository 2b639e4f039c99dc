"""`make engine`: the shipped cells in MuJoCo beside our own plant, as their files say, in realities, with failing arms.

The controllers, monitors and servos' effects are the product's; bodies, pads, friction of the joints and integration
are the other engine's.  ENGINE_S: seconds of each run (12).  ENGINE_SEEDS: realities of each cell (2).
ENGINE_ONLY=TEXT: runs whose name has it.
Wrong is a run in either engine that loses the object, trips without a fault, leaves the bounds of a study, or in which
an arm fails and nobody holds; and errors or forces of the two that are further apart than `APART`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

import numpy as np

from agent.config.cell import Cell, load_cell
from agent.config.reality import draw
from agent.config.schema.fault import Fault, FaultKind
from agent.config.schema.reality import Reality
from agent.study.lab import Laboratory
from agent.study.measure import RunResult, measure
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.physics.spec import PlantSpec
from tests.soak.watch import say
from tests.support.plant.mujoco_plant import MujocoPlant

CELLS: Final = ("paper_real", "two_wx200", "two_models", "paper_adaptive", "three_wx250s", "four_wx250s")
FAULTS_S: Final = (5.0, 10.0)  # an arm fails where the motion is quickest between these
KINDS: Final = (FaultKind.LIMP, FaultKind.HOLD, FaultKind.LOCKED)
APART: Final = {
    "position_error_m": 0.5e-3,
    "attitude_error_rad": 1.5e-3,
    "internal_force_mean_N": 0.15,
    "peak_torque_fraction": 0.02,
}


@dataclass(frozen=True)
class Case:
    """One cell in one reality (None: as its file says), with or without an arm that fails."""

    cell: Cell
    reality: Reality | None
    faults: tuple[Fault, ...]
    words: str


def cases(duration_s: float, seeds: int) -> Iterator[Case]:
    """Of every cell: as its file says, in realities, and each kind of failing arm."""
    for name in CELLS:
        changes = [f"duration_s={duration_s}", f"report.transient_s={duration_s / 3.0}"]
        cell = load_cell(Path(name), changes)
        yield Case(cell, None, (), "as its file says")
        for seed in range(1, seeds + 1):
            yield Case(cell, draw(cell.file.tolerance, seed, cell), (), f"reality {seed}")
        for kind in KINDS:
            fault = Fault(kind=kind, arm=cell.arms[0].name, at_s=quickest_s(cell))
            yield Case(cell, None, (fault,), f"{fault.arm} {kind}")


def quickest_s(cell: Cell) -> float:
    """When an arm of this cell fails."""
    motion = cell.trajectory()
    times: list[float] = np.linspace(*FAULTS_S, 41).tolist()
    return max(times, key=lambda t: float(np.linalg.norm(motion.at(t).v)))


def mujoco_plant(spec: PlantSpec) -> AnyPlant:
    """MuJoCo in the place of our plant."""
    return cast(AnyPlant, MujocoPlant(spec))


def missed(case: Case, found: RunResult) -> list[str]:
    """What a run does not keep."""
    if case.faults:
        return [] if found.reaction_s is not None else ["nobody holds"]
    return [] if found.within_bounds else [found.why or "outside the bounds of a study"]


def told(case: Case, found: RunResult) -> str:
    """Its figures."""
    if case.faults:
        return "noticed by nobody" if found.reaction_s is None else f"noticed after {found.reaction_s * 1e3:.0f} ms"
    return (
        f"{found.position_error_m * 1e3:.2f} mm, {found.attitude_error_rad * 1e3:.2f} mrad, "
        f"{found.internal_force_mean_N:.2f} N, {found.peak_torque_fraction:.0%} of stall"
    )


def apart(case: Case, ours: RunResult, other: RunResult) -> list[str]:
    """Figures of the two engines that differ by more than they may."""
    if case.faults:
        return []
    differences = {figure: abs(getattr(ours, figure) - getattr(other, figure)) for figure in APART}
    return [f"{figure} apart by {d:.3g}" for figure, d in differences.items() if d > APART[figure]]


def main() -> int:
    """Exit code 1 when a run is wrong."""
    duration_s, seeds = float(os.environ.get("ENGINE_S", "12")), int(os.environ.get("ENGINE_SEEDS", "2"))
    only, wrong = os.environ.get("ENGINE_ONLY", ""), 0
    engines: tuple[Callable[[PlantSpec], AnyPlant], ...] = (build_plant, mujoco_plant)
    for case in cases(duration_s, seeds):
        name = f"{case.cell.file.name}, {case.words}"
        if only not in name:
            continue
        ours, other = (measure(Laboratory(case.cell, build), case.reality, faults=case.faults) for build in engines)
        bad = [*missed(case, ours), *(f"MuJoCo: {what}" for what in missed(case, other)), *apart(case, ours, other)]
        wrong += bool(bad)
        say(f"{name}: {told(case, ours)}; MuJoCo: {told(case, other)}{'; WRONG: ' + ', '.join(bad) if bad else ''}")
    say(f"{wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
