"""What the runs of a study say together: counts, quantiles, and which error of reality matters most."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np

from agent.config.cell import Cell
from agent.config.reality import draw
from agent.config.schema.fault import Fault
from agent.config.schema.reality import STIFFNESSES, Reality
from agent.study.lab import faults_of
from agent.study.measure import RunResult, bounds_of, gave_up
from drivers.interface import Vector

QUANTILES: Final = (50, 95, 100)  # %
REACTION: Final = "reaction_s"  # of runs with a fault alone
ENDED_EARLY: Final = "ended_early"  # beside the figures, in what errors of reality go with
FIGURES: Final = (
    "position_error_m",
    "attitude_error_rad",
    "position_beyond_anchor_m",
    "attitude_beyond_anchor_rad",
    "internal_force_mean_N",
    "internal_force_max_N",
    "peak_torque_fraction",
    REACTION,
)
PROMISED: Final = "95"  # % of the runs in which a cell's figures are to be within bounds
ENOUGH_RUNS: Final = 59  # of fewer, all may be within bounds by chance (1 in 20) where 5 % of all realities are not
LEAST_RUNS: Final = 8  # a rank correlation of fewer says nothing


@dataclass(frozen=True)
class Influence:
    """How strongly one error of reality goes with one figure, or with ending early: Spearman's rank correlation."""

    error: str
    figure: str
    correlation: float  # −1 to 1


def ended_early(result: RunResult) -> bool:
    """Whether the run was lost, or tripped before any fault: what its motion would have been is not known."""
    return result.lost or gave_up(result.tripped_s, result.first_fault_s)


def summary(results: Sequence[RunResult]) -> dict[str, Any]:
    """Counts, and quantiles of each figure over all runs, those that ended early as `counted` has them.

    `at_least` has the quantiles that fall on such a run: of every figure but a reaction they say no more than that.
    What the others make of a fault is of the runs that have one; a fault that no other arm notices counts as noticed
    later than any.
    """
    struck = [r for r in results if r.first_fault_s is not None]
    early = [r for r in results if ended_early(r)]
    unknown = _quantiles([float(ended_early(r)) for r in results]) if results else {}
    found = {
        "runs": len(results),
        "lost": sum(r.lost for r in results),
        "tripped": sum(r.tripped for r in results),
        "tripped_by": dict(Counter(sorted(r.tripped_by for r in results if r.tripped))),
        "within_bounds": sum(r.within_bounds for r in results),
        "unsettled": sum(not r.settled for r in results),
        "ended_early": len(early),
        "ended_before_start": sum(_end_s(r) < 0.0 for r in early),
        "counted_from_start": sum(not r.settled and not ended_early(r) for r in results),
        "at_least": [q for q, at in unknown.items() if at],
    } | {figure: _quantiles(counted(struck if figure == REACTION else results, figure)) for figure in FIGURES}
    if struck:
        found["unnoticed"] = sum(r.reaction_s is None for r in struck)
        found["tripped_before_fault"] = sum(gave_up(r.tripped_s, r.first_fault_s) for r in struck)
    return found


def _end_s(result: RunResult) -> float:
    """When the run was lost or an arm of it tripped, the first of both."""
    return min((t for t in (result.tripped_s, result.lost_s) if t is not None), default=math.inf)


def counted(results: Sequence[RunResult], figure: str) -> list[float | None]:
    """One figure of every run; one that ended early, of which the rest is not known, has the largest of all runs.

    The largest number: a plant that diverges may have none.  But for a reaction, which is what it is whatever became of
    the object.
    """
    values = [getattr(r, figure) for r in results]
    if figure == REACTION or not any(ended_early(r) for r in results):
        return values
    largest = max((value for value in values if math.isfinite(value)), default=0.0)
    return [largest if ended_early(r) else value for r, value in zip(results, values, strict=True)]


def judged(cell: Cell, found: Mapping[str, Any]) -> dict[str, Any]:
    """Whether the cell keeps its bounds: nothing lost, nothing tripped, and 95 % of the runs below each bound.

    found: the summary of its runs; of runs with faults an arm that trips after the first does what it should.
    `missed` names what the cell does not keep.
    """
    bounds = bounds_of(cell)
    tripped = "tripped_before_fault" if "tripped_before_fault" in found else "tripped"
    missed = [key for key in ("lost", tripped) if found[key]]
    missed += [figure for figure, bound in bounds.items() if not _kept(found[figure][PROMISED], bound)]
    return {"bounds": bounds, "missed": missed, "holds": not missed}


def verdict(found: Mapping[str, Any]) -> str:
    """Whether a cell keeps its bounds, in words; found: its summary with what `judged` says."""
    runs = "1 run" if found["runs"] == 1 else f"{found['runs']} runs"
    struck = "unnoticed" in found
    noticed = f"; the others noticed it in {found['runs'] - found['unnoticed']} of {runs}" if struck else ""
    if found["holds"]:
        kept = f"holds: {runs}, none lost, none tripped{' before the fault' if struck else ''}"
        kept += f", {PROMISED} % of them below every bound{noticed}"
        if found["runs"] < ENOUGH_RUNS:
            kept += f"; too few to say it of {PROMISED} % of all realities, which takes {ENOUGH_RUNS} or more"
        return kept
    by = ", ".join(f"{name} {count}" for name, count in found["tripped_by"].items())
    words = {
        "lost": f"{found['lost']} lost",
        "tripped": f"{found['tripped']} tripped ({by})",
        "tripped_before_fault": f"{found.get('tripped_before_fault')} tripped before the fault",
    }
    missed = [words.get(key, f"{PROMISED} % quantile of {key} above its bound") for key in found["missed"]]
    return f"does not hold: of {runs} {', '.join(missed)}{noticed}"


def counting(cell: Cell, found: Mapping[str, Any], faults: Sequence[Fault]) -> str:
    """From when to when errors and forces of the cell's runs count, in words; found: the summary of the runs.

    faults: the study's, beside the cell's own.
    """
    words = f"Errors and forces count from {cell.file.report.transient_s:g} s on, until the first arm trips."
    if early := found["ended_early"]:
        ended = "Lost, or tripped before the fault" if "unnoticed" in found else "Lost or tripped"
        before = f" ({found['ended_before_start']} before the start)" if found["ended_before_start"] else ""
        words += (
            f" {ended}: {early} of {found['runs']}{before}; how they would have gone on is not known, so each counts as"
            " the largest of all runs in every figure, and a quantile that falls on one is marked ≥."
        )
    if found["counted_from_start"]:
        words += (
            " Tripped for a fault too early for that, and counted from the start with its error: "
            f"{found['counted_from_start']}."
        )
    if every := faults_of(cell, faults):
        words += f" In every run: {', '.join(fault.told for fault in every)}; they count on after it."
    return words


def _kept(value: float | None, bound: float) -> bool:
    return value is not None and value <= bound


def quantile(found: Mapping[str, Any], figure: str, q: str) -> str:
    """One quantile of a summary in words: – for none, ≥ where it falls on a run that ended early."""
    value = found[figure][q]
    if value is None:
        return "–"
    return f"{'≥ ' if figure != REACTION and q in found['at_least'] else ''}{value:.4g}"


def _quantiles(values: Sequence[float | None]) -> dict[str, float | None]:
    """Smallest value that so many percent do not exceed; one that is None is larger than any, and so is none at all."""
    known = [math.inf if v is None else v for v in values] or [math.inf]
    found = {str(q): float(np.percentile(known, q, method="inverted_cdf")) for q in QUANTILES}
    return {q: value if math.isfinite(value) else None for q, value in found.items()}


def errors_of(real: Reality, cell: Cell) -> dict[str, float]:
    """Sizes of a reality's errors, one number each: of poses how far two arms disagree, of scales what they are.

    Poses are as `..._largest` the size of that of the arm with the largest, too: an arm checks its own start, whatever
    the others share.  Scales are the mean of the arms, and as `..._off` how far they are from 1, whichever way.
    """
    arms = list(real.arms.values())
    believed_s = cell.file.simulated_delay_s
    delay = 1.0 if real.delay_s is None or not believed_s else real.delay_s / believed_s
    poses = {key: [getattr(a, key) for a in arms] for key in ("base_m", "base_rad", "grasp_m", "grasp_rad")}
    scales = {
        "masses": [a.masses * k for a in arms for k in a.link_masses or (1.0,)],
        "object": [real.object],
        "friction": [a.friction * k for a in arms for k in a.joint_friction or (1.0,)],
        "delay": [delay],
    }
    return {
        **{name: _disagreement(values) for name, values in poses.items()},
        "zeros_rad": float(np.linalg.norm([z for a in arms for z in a.zeros_rad])),
        "object_centre_m": float(np.linalg.norm(real.object_centre_m)),
        "torque_constant": float(np.linalg.norm([k - 1.0 for a in arms for k in a.torque_constant])),
        **{key: _pads(real, key) for key in STIFFNESSES},
        "backlash_rad": float(np.linalg.norm([b for a in arms for b in a.backlash_rad])),
        "delay_jitter_s": real.delay_jitter_s,
        "breakaway_Nm": float(np.linalg.norm([b for a in arms for b in a.breakaway_Nm])),
        "load_friction": float(np.linalg.norm([f for a in arms for f in a.load_friction])),
        "skew_s": max(a.skew_s for a in arms) - min(a.skew_s for a in arms),
        **{f"{name}_largest": max(map(_size, values)) for name, values in poses.items()},
        **{name: float(np.mean(values)) for name, values in scales.items()},
        **{f"{name}_off": float(np.mean([abs(x - 1.0) for x in values])) for name, values in scales.items()},
    }


def _pads(real: Reality, key: str) -> float:
    """Stiffness of the grasps, of unlike ones their geometric mean."""
    each = [getattr(arm, key) or getattr(real, key) or 0.0 for arm in real.arms.values()]
    return each[0] if len(set(each)) == 1 else float(np.prod(np.array(each) ** (1.0 / len(each))))


def _disagreement(values: Sequence[tuple[float, float, float]]) -> float:
    """Largest distance of two arms' errors, or the size of the only one's."""
    return max((_size(np.subtract(a, b)) for a, b in combinations(values, 2)), default=_size(values[0]))


def _size(vector: Sequence[float] | Vector) -> float:
    return float(np.linalg.norm(vector))


def influences(cell: Cell, results: Sequence[RunResult]) -> list[Influence]:
    """Every error of reality that varies against every figure that varies, the strongest first; none of few runs.

    Before all figures comes ending early, where some runs did and some did not: an error that decides over it comes
    before one that strains the others.
    """
    if len(results) < LEAST_RUNS:
        return []
    drawn = [errors_of(draw(cell.file.tolerance, r.seed, cell), cell) for r in results]
    errors = {key: np.array([d[key] for d in drawn]) for key in drawn[0]}
    every = {figure: counted(results, figure) for figure in FIGURES}
    figures = {figure: np.array(values, dtype=np.float64) for figure, values in every.items() if None not in values}
    figures[ENDED_EARLY] = np.array([ended_early(r) for r in results], dtype=np.float64)
    found = [
        Influence(error, figure, _spearman(x, y))
        for error, x in errors.items()
        for figure, y in figures.items()
        if np.ptp(x) > 0.0 and np.ptp(y) > 0.0
    ]
    return sorted(found, key=lambda i: (i.figure != ENDED_EARLY, -abs(i.correlation)))


def _spearman(x: Vector, y: Vector) -> float:
    """Spearman's rank correlation: Pearson's, of the ranks, ties having the mean of theirs."""
    return float(np.corrcoef(_ranks(x), _ranks(y))[0, 1])


def _ranks(x: Vector) -> Vector:
    """The rank of each number, 1 for the least; without the 0.6 s that `import scipy.stats` costs every study."""
    _, which, counts = np.unique(x, return_inverse=True, return_counts=True)
    ranks: Vector = (np.cumsum(counts) - (counts - 1) / 2)[which]
    return ranks


def worst(results: Sequence[RunResult]) -> RunResult:
    """The run to look at first: lost soonest, else tripped soonest, else with the largest internal force.

    With faults, for which the others are to trip: lost soonest, else tripped soonest before the first of them, else
    noticed by nobody, with the largest internal force, else noticed latest; runs without a fault come behind those.
    """

    def badness(result: RunResult) -> tuple[int, float, int]:
        if result.lost_s is not None:
            return 0, result.lost_s, result.index
        if result.tripped_s is not None and gave_up(result.tripped_s, result.first_fault_s):
            return 1, result.tripped_s, result.index
        if result.reaction_s is not None:
            return 3, -result.reaction_s, result.index
        return 4 if result.first_fault_s is None else 2, -result.internal_force_mean_N, result.index

    return min(results, key=badness)
