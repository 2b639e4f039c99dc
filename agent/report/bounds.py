"""What a run that had to keep the bounds of its cell is told when it has not."""

from __future__ import annotations

import math

from agent.report.results import Judgement, Results
from drivers.interface import Refusal


class BoundsMissed(Refusal):
    """A bound of the cell file is exceeded, or was not shown to be kept; or the object was not."""

    exit_code = 6


def require_bounds(results: Results) -> None:
    """Raise BoundsMissed unless the results are within bounds."""
    if results.within_bounds:
        return
    info = results.info
    missed = {b: verdict for b in info.bounds if (verdict := results.verdict(b)) is not Judgement.MET}
    lost = [] if results.loss is None else [f"{what.lower()} {figure}" for what, figure, _ in results.loss.lines()]
    remedy = "see the report"
    if Judgement.NOT_SHOWN in missed.values() and not lost and results.judged:
        remedy = f"errors count from {info.transient_s:g} s on, while all arms follow the trajectory: let it run longer"
    wanted = ["the object held by all arms"] if lost else []
    raise BoundsMissed(
        f"bounds of cell {info.cell}",
        found=", ".join([*lost, *(_said(b.value, results.headline(b.value), v) for b, v in missed.items() if v)]),
        expected=", ".join([*wanted, *(f"{b.value} ≤ {info.bounds[b]:g}" for b in missed)]),
        remedy=remedy,
    )


def _said(figure: str, value: float, verdict: Judgement) -> str:
    return f"{figure} not measured" if math.isnan(value) else f"{figure} {value:.3g} {verdict.value}"
