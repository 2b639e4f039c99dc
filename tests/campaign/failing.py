"""`make failing`: one arm fails in a random cell at a random instant; what `coop check` says of the object comes true.

FAILING_N: cases (default 60).  FAILING_SEED: of the first one (0).  About eight minutes of CPU.
Half of the cases are as their file says, whose tolerance is then none, half in a reality drawn within the shipped one;
the object is 0.5 to 2 times as heavy as shipped, and the arms know that.  Beside half of the limp arms it is so heavy
that the others give 0.8 to 1.2 of their torque bound: there it falls or not by little, and may take seconds.
Wrong is an object that goes further than `HELD_SAG_M` where check says that it is held (limp), or that the others bear
what they must (locked, holding), one that stays where check says that it is not held, and an arm that holds before
anything has failed.  `may fall` is never wrong, so the cases in which it is said are told.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from agent.config.cell import Cell, load_cell, placement
from agent.config.reality import draw
from agent.config.schema.fault import Fault, FaultKind
from agent.config.schema.reality import Reality
from agent.control.models import ArmModel
from agent.study.lab import Laboratory, Run
from agent.verify.check import reach
from agent.verify.support import HELD_SAG_M, Fate, Statics, Support
from drivers.interface import DriverError, Vector
from sim_backend.physics.spec import PlantError
from tests.soak.watch import say

CELLS: Final = ("paper_real", "two_wx200", "two_models", "three_wx250s", "four_wx250s")
KINDS: Final = (FaultKind.LIMP, FaultKind.LIMP, FaultKind.HOLD, FaultKind.LOCKED)  # what can fall, twice as often
READY_S: Final = 2.0
LATEST_S: Final = 10.0  # behind the start: the fault
LOOK_S: Final = 8.0  # behind the fault: where friction bears a part, the object creeps for seconds before it falls
NEAR: Final = (0.8, 1.2)  # of the torque bound
HEAVY: Final = (0.3, 8.0)  # times the shipped object, to come that near
AHEAD_S: Final = (0.0, 0.25, 0.5)  # places of the statics: the others go on until they notice
EXACT: Final = (
    *(f"tolerance.{key}=0.0" for key in ("masses", "object", "torque_constant")),
    "tolerance.friction=[1.0, 1.0]",
)


@dataclass(frozen=True)
class Case:
    """One arm of one cell that fails."""

    cell: Cell
    reality: Reality | None  # None: as the file says
    fault: Fault
    words: str


def case(seed: int) -> Case:
    """Drawn from this seed."""
    rng = np.random.default_rng(seed)
    name, kind = CELLS[seed % len(CELLS)], KINDS[int(rng.integers(len(KINDS)))]
    shipped, heavy, exact = load_cell(Path(name)), float(rng.uniform(0.5, 2.0)), bool(rng.integers(2))
    arm, at_s = shipped.arms[int(rng.integers(len(shipped.arms)))].name, round(float(rng.uniform(0.5, LATEST_S)), 2)
    fault = Fault(kind=kind, arm=arm, at_s=at_s)
    if kind is FaultKind.LIMP and rng.integers(2):
        heavy = near_the_bound(name, fault, float(rng.uniform(*NEAR)))
    cell = loaded(name, heavy, exact=exact)
    words = f"{name}, {arm} {kind.value} at {at_s:g} s, object × {heavy:.2f}, {'as filed' if exact else 'errors'}"
    return Case(cell, None if exact else draw(cell.file.tolerance, seed, cell), fault, words)


def loaded(name: str, heavy: float, *, exact: bool) -> Cell:
    """A shipped cell with an object that is so many times as heavy."""
    spec = load_cell(Path(name)).file.object
    changes = [f"object.mass_kg={heavy * spec.mass_kg}", f"simulation.ready_s={READY_S}"]
    inertia = spec.inertia_kg_m2.model_dump().items()
    changes += [f"object.inertia_kg_m2.{axis}={heavy * value}" for axis, value in inertia if value]
    return load_cell(Path(name), [*changes, *(EXACT if exact else ())])


def near_the_bound(name: str, fault: Fault, part: float) -> float:
    """Times the shipped object with which the others of a limp arm give this part of their torque bound."""
    light, heavy = (_limp_share(loaded(name, times, exact=True), fault) for times in (1.0, 2.0))
    bound = part * load_cell(Path(name)).file.safety.tau_max_fraction_of_stall
    return float(np.clip(1.0 + (bound - light) / (heavy - light), *HEAVY))


def _limp_share(cell: Cell, fault: Fault) -> float:
    return predicted(cell, Laboratory(cell).q_start, fault).limp.most.share


def predicted(cell: Cell, q_start: Sequence[Vector], fault: Fault) -> Support:
    """What `coop check` says, at the places at which it can happen."""
    models, along, q = [cell.model(arm) for arm in cell.arms], [], list(q_start)
    instants = [fault.at_s + ahead for ahead in AHEAD_S]
    for t in instants:
        q = list(_placed(cell, models, q, t))
        along.append(q)
    return Statics(cell, models, along, instants).without(cell.index(fault.arm))


def _placed(cell: Cell, models: Sequence[ArmModel], q: Sequence[Vector], t: float) -> Iterator[Vector]:
    desired = cell.trajectory().at(t)
    T = placement(desired.p, desired.quat)
    for arm, model, near in zip(cell.arms, models, q, strict=True):
        yield reach(arm, model, T, near, "")


def sagged_m(lab: Laboratory, one: Case) -> tuple[float, str]:
    """Largest way of the object from where it would have gone with the others until they noticed; inf: thrown.

    With it who held before the fault and why, or nothing.
    """
    run, trajectory, fault = Run(lab, one.reality, (one.fault,)), lab.cell.trajectory(), one.fault
    away, begin, held_s = 0.0, np.zeros(3), math.inf
    while run.t < fault.at_s + LOOK_S:
        looking = run.t >= fault.at_s
        if run.trips and not looking:
            return 0.0, run.trips[0].told
        if looking and not begin.any():
            begin = run.observe().p_object - np.array(trajectory.at(run.t).p)
        try:
            run.advance()
        except (PlantError, DriverError):
            return math.inf, ""
        if looking:
            held_s = min([held_s, *(trip.t for trip in run.trips)])
            there = np.array(trajectory.at(min(run.t, held_s)).p) + begin
            away = max(away, float(np.linalg.norm(run.observe().p_object - there)))
    return away, ""


def wrong(said: Support, kind: FaultKind, cell: Cell, away_m: float) -> bool:
    """Whether the plant did what check says that it does not."""
    if kind is FaultKind.LIMP:
        return (said.fate is Fate.HELD and away_m > HELD_SAG_M) or (said.fate is Fate.NOT_HELD and away_m <= HELD_SAG_M)
    load = (said.locked if kind is FaultKind.LOCKED else said.holding).most
    return load.share <= cell.file.safety.tau_max_fraction_of_stall and away_m > HELD_SAG_M


def main() -> int:
    """All cases; 0 when check is right in each."""
    count, first = int(os.environ.get("FAILING_N", "60")), int(os.environ.get("FAILING_SEED", "0"))
    bad, open_ = 0, 0
    for seed in range(first, first + count):
        one = case(seed)
        lab = Laboratory(one.cell)
        said, (away_m, early) = predicted(one.cell, lab.q_start, one.fault), sagged_m(lab, one)
        if early:
            say(f"{seed} {one.words}: WRONG, held before it: {early}")
            bad += 1
            continue
        mistaken = wrong(said, one.fault.kind, one.cell, away_m)
        bad += mistaken
        limp = one.fault.kind is FaultKind.LIMP
        open_ += limp and said.fate is Fate.MAY_FALL
        load = (said.locked if one.fault.kind is FaultKind.LOCKED else said.holding).most
        words = (
            f"{said.fate.value}, {said.limp.most.share:.0%} of stall, {said.sag_m * 1e3:.1f} mm"
            if limp
            else f"{load.share:.0%} of stall"
        )
        say(f"{seed} {one.words}: check {words}; went {away_m * 1e3:.1f} mm{'  WRONG' if mistaken else ''}")
    say(f"{count} cases: check is right in {count - bad}, of which {open_} may fall")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
