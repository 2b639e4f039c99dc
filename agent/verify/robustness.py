"""What reality may make of a cell along its trajectory, as findings and figures: instability, and an arm that fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.config import observer
from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.control.models import ArmModel
from agent.verify.alignment_reach import alignment_reach
from agent.verify.criterion import bodies
from agent.verify.criterion.bodies import Pose
from agent.verify.criterion.cases import Aligning, Demand, Loop, Ranges
from agent.verify.criterion.examine import STABLE, Criterion, Found, examine
from agent.verify.disagreement import MEAN_SHARE, Disagreement, disagreement
from agent.verify.finding import Finding, Verdict, judged
from agent.verify.force import mean_bound_N, spare_N
from agent.verify.one_fails import document_of, findings_of
from agent.verify.radius import mended, told
from agent.verify.start import start
from agent.verify.support import Statics, Support
from drivers.interface import Vector

PLACES = 12  # along the trajectory
REACH_PLACES = 6  # for the limits of the alignment
CREEP = 1e-9  # of a motion that dies out, however slowly

_MEANING = {
    Demand.BARE: "an arm whose gripper opens would swing up",
    Demand.HOLDING: "an arm that the others let go of would swing up",
    Demand.RIGID: "the cell would swing up",
    Demand.SOFT: "on grasps this soft the arms would swing against each other",
    Demand.ALIGNING: "the arms would run away from each other; lower ready_per_s",
}


@dataclass(frozen=True)
class Walk:
    """A cell along its trajectory: models (one per arm), joint angles along[k][i] (n,) of arm i at instants[k], s."""

    cell: Cell
    models: Sequence[ArmModel]
    along: Sequence[Sequence[Vector]]
    instants: Sequence[float]

    def some(self, count: int) -> Walk:
        """About so many places, the first among them."""
        every = max(1, -(-len(self.along) // count))
        return Walk(self.cell, self.models, self.along[::every], self.instants[::every])


@dataclass(frozen=True)
class Robustness:
    """What was found, and the places that it speaks of."""

    walk: Walk  # of the criterion
    criterion: Criterion
    instants: Sequence[float]  # of the statics
    support: tuple[Support, ...]  # when one arm fails, by arm; empty for an arm alone
    disagreement: tuple[Disagreement, ...]  # likewise
    reach: tuple[Finding, ...]  # of arms that align themselves

    def document(self) -> dict[str, Any]:
        """For a script."""
        cell, found = self.walk.cell, self.criterion
        return {
            "spectral_radius": found.radius,
            "delay_margin_s": found.delay_margin_s,
            "worst": {d.name.lower(): self._case(w) for d, w in found.worst.items()},
            "one_arm_fails": {
                arm.name: document_of(cell, self.instants, s) for arm, s in zip(cell.arms, self.support, strict=False)
            },
            "internal_wrench": {
                arm.name: {"force_N": d.force_N, "moment_Nm": d.moment_Nm}
                for arm, d in zip(cell.arms, self.disagreement, strict=False)
            },
        }

    def _case(self, found: Found) -> dict[str, Any]:
        case, cell = found.case, self.walk.cell
        return {
            "spectral_radius": found.radius,
            "arm": None if case.arm is None else cell.arms[case.arm].name,
            "t_s": self.walk.instants[case.place],
            "delay_s": case.delay_periods / cell.file.rate_hz,
            "inertia": case.inertia,
            "object": case.load,
            "pads_N_per_m": case.k_t or None,
            "pads_Nm_per_rad": case.k_r or None,
        }

    def findings(self) -> list[Finding]:
        """For a person; refused where servos move the arms, warned of in simulation."""
        cell, found = self.walk.cell, self.criterion
        otherwise = Verdict.REFUSED if cell.file.driver is DriverKind.DYNAMIXEL else Verdict.WARNING
        limit = cell.file.radius_max
        findings = []
        for demand, worst in found.worst.items():
            most = 1.0 - CREEP if demand is Demand.ALIGNING else limit
            unstable = f"{self._meaning(demand)}; take the gains that `coop tune` proposes, or raise rate_hz"
            findings.append(
                judged(
                    f"stable: {demand.value}", self._where(worst),
                    f"{told(worst.radius, most)} ({self.described(worst)})",
                    "< 1" if demand is Demand.ALIGNING else f"≤ {limit:g}", holds=worst.radius <= most,
                    otherwise=otherwise,
                    remedy=mended(worst.radius, cell.file.rate_hz, unstable),
                )
            )  # fmt: skip
        failed = [f for i, s in enumerate(self.support) for f in findings_of(cell, self.instants, i, s)]
        return [*findings, self._margin(otherwise), *failed, *self._internal(), *self.reach, *_unseen(cell)]

    def _meaning(self, demand: Demand) -> str:
        """Of a loop that is unstable; aligning has no part in it where the cell is unstable without."""
        without = [self.criterion.worst[d].radius for d in (Demand.RIGID, Demand.SOFT) if d in self.criterion.worst]
        if demand is Demand.ALIGNING and max(without) >= STABLE:
            return "the cell is unstable without aligning, too"
        return _MEANING[demand]

    def _internal(self) -> list[Finding]:
        cell = self.walk.cell
        each = zip(cell.arms, self.disagreement, spare_N(cell, mean_bound_N(cell) / MEAN_SHARE), strict=False)
        return [
            judged(
                "internal wrench at the stated tolerance", arm.name,
                f"{d.force_N:.2g} N, {d.moment_Nm:.2g} N·m (quadratic sum)", f"≤ {most_N:.3g} N",
                holds=d.force_N <= most_N, otherwise=Verdict.WARNING,
                remedy="calibrate better and say so in [tolerance], let arms align themselves, or take softer gains",
            )
            for arm, d, most_N in each
        ]  # fmt: skip

    def _where(self, found: Found) -> str:
        return "cell" if found.case.arm is None else self.walk.cell.arms[found.case.arm].name

    def described(self, found: Found) -> str:
        """The reality of a case, for a person."""
        case, rate = found.case, self.walk.cell.file.rate_hz
        parts = [f"t = {self.walk.instants[case.place]:.3g} s", f"delay {case.delay_periods / rate * 1e3:.3g} ms"]
        if case.k_t > 0.0:
            parts.append(f"pads {case.k_t:.2g} N/m, {case.k_r:.2g} N·m/rad")
        if case.inertia != 1.0:
            parts.append(f"arms' inertia {case.inertia - 1.0:+.0%}")
        if case.load != 1.0:
            parts.append(f"object {case.load - 1.0:+.0%}")
        return ", ".join(parts)

    def _margin(self, otherwise: Verdict) -> Finding:
        cell, margin_s = self.walk.cell, self.criterion.delay_margin_s
        period_s = 1.0 / cell.file.rate_hz
        wanted_s = _delay_periods(cell)[1] * period_s  # to the bit as margin_s
        text = "none" if margin_s is None else f"{margin_s * 1e3:.3g} ms"
        if margin_s is not None and margin_s >= self.criterion.delay_looked_at_s:
            text += " or more"
        return judged(
            "longest delay with all of this stable", "cell", text, f"≥ {wanted_s * 1e3:.3g} ms",
            holds=margin_s is not None and margin_s >= wanted_s, otherwise=otherwise,
            remedy="take the gains that `coop tune` proposes, or make the loop quicker",
        )  # fmt: skip


def robustness(walk: Walk) -> Robustness:
    """The cell with its own gains, at some places of its trajectory."""
    few, cell = walk.some(PLACES), walk.cell
    at = poses(few)
    found = examine(at, loop_of(cell), ranges_of(cell))
    if len(cell.arms) < 2:
        return Robustness(few, found, walk.instants, (), (), ())
    statics = Statics(cell, walk.models, walk.along, walk.instants)
    support = tuple(statics.without(i) for i in range(len(cell.arms)))
    apart = disagreement(cell, walk.models, at, few.along, few.instants)
    shifted = walk.some(REACH_PLACES)
    reach = alignment_reach(cell, walk.models, shifted.along, shifted.instants)
    if cell.file.controller.alignment.enabled:
        reach.append(start(cell, walk.models, few.along[0]))
    return Robustness(few, found, walk.instants, support, apart, tuple(reach))


def _unseen(cell: Cell) -> list[Finding]:
    """What is stated and none of this counts with."""
    gap_rad = cell.tolerance.backlash_rad
    if not gap_rad:
        return []
    return [Finding("backlash of the gears", "cell", f"up to {gap_rad * 1e3:.3g} mrad, in no figure of this check", "")]


def poses(walk: Walk) -> list[Pose]:
    """All arms at every place."""
    offline = [walk.cell.offline(arm) for arm in walk.cell.arms]
    viscous = [np.array([s.viscous_Nm_s_per_rad.value for s in arm.servos]) for arm in walk.cell.arms]
    return [bodies.pose(walk.models, offline, viscous, q) for q in walk.along]


def loop_of(cell: Cell) -> Loop:
    """The cell's loop as its agents run it."""
    gains = tuple(cell.offline(arm).gains for arm in cell.arms)
    return Loop(1.0 / cell.file.rate_hz, gains, observer.build(cell.file), _aligning(cell))


def _aligning(cell: Cell) -> Aligning | None:
    spec = cell.file.controller.alignment
    if not spec.enabled or len(cell.arms) < 2:
        return None
    return Aligning(cell.anchor, max(spec.ready_per_s, spec.track_per_s))


def _delay_periods(cell: Cell) -> tuple[float, float]:
    """The shortest and the longest delay that the cell states, its jitter in it."""
    stated, periods = cell.tolerance, cell.file.delay_periods
    jitter = stated.delay_jitter_s * cell.file.rate_hz
    return max(stated.delay[0] * periods - jitter, 0.0), stated.delay[1] * periods + jitter


def ranges_of(cell: Cell) -> Ranges:
    """How far reality may be, as the cell states it."""
    stated, (shortest, longest) = cell.tolerance, _delay_periods(cell)
    return Ranges(
        delay_periods=(shortest, cell.file.delay_periods, longest),
        inertia_error=cell.inertia_error,
        object_error=stated.object,
        friction=stated.friction[0],
        pads_N_per_m=stated.pads_N_per_m,
        pads_Nm_per_rad=stated.pads_Nm_per_rad,
        pads_damping_ratio=stated.pads_damping_ratio,
    )
