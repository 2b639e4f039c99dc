"""What a run shows, held against the bounds of its row."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.config.cell import load_cell
from agent.config.files import cell_path
from agent.faults.catalogue import Shown, Within
from agent.faults.measure import GONE, Measured, measured
from agent.faults.rehearse import rehearse


class RowResult(enum.StrEnum):
    """Of a row, or of one of its runs."""

    MET = "met"
    MISSED = "missed"
    NOT_TESTED = "not tested"


@dataclass(frozen=True)
class Judged:
    """A run of a row: its figures, and in words what they miss."""

    shown: Shown
    measured: Measured
    missed: tuple[str, ...]

    @property
    def verdict(self) -> RowResult:
        """Whether it holds all of its bounds."""
        return RowResult.MISSED if self.missed else RowResult.MET

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "cell": self.shown.cell,
            "faults": [fault.model_dump(mode="json", exclude_defaults=True) for fault in self.shown.faults],
            "bound": self.shown.within.described(),
            "verdict": self.verdict.value,
            "missed": list(self.missed),
            **self.measured.document(),
        }


def show(shown: Shown, seed: int = 1) -> Judged:
    """Do the run and judge it.  Raises Refusal."""
    cell = load_cell(cell_path(Path(shown.cell)), [f"duration_s={shown.duration_s}", *shown.set])
    found = measured(rehearse(cell, shown.faults, seed=seed))
    return Judged(shown, found, tuple(misses(found, shown.within)))


def misses(found: Measured, within: Within) -> Iterator[str]:
    """Each bound that is not held, with the figure."""
    if within.goes_on:
        stopped = [arm for arm, at in found.stopped_s.items() if at is not None]
        if stopped:
            yield f"{' and '.join(stopped)} left the motion: {found.noticed}"
    yield from _late("noticed", found.noticed_s, within.noticed_s)
    harmless = within.or_grown_N is not None and found.grown_N <= within.or_grown_N
    if within.reacted_s is not None and not harmless:
        for arm, at in found.stopped_s.items():
            if (arm in within.who or not within.who) and found.ended[arm] != GONE:
                yield from _late(f"{arm} stopped", at, within.reacted_s)
    for name, value, bound, unit in (
        ("internal force", found.internal_N, within.internal_N, "N"),
        ("internal force grown by", found.grown_N, within.grown_N, "N"),
        ("sag", found.sag_m, within.sag_m, "m"),
        ("joints moved", found.moved_rad, within.moved_rad, "rad"),
        ("fastest joint", found.speed_rad_per_s, within.speed_rad_per_s, "rad/s"),
        ("arm and twin apart", found.apart_rad, within.apart_rad, "rad"),
        ("the others' fastest joint", found.others_rad_per_s, within.others_rad_per_s, "rad/s"),
        ("the object falls at", found.fall_m_per_s, within.fall_m_per_s, "m/s"),
        ("the object moved by", found.strayed_m, within.strayed_m, "m"),
        ("a value used was off by", found.misled_rad, within.misled_rad, "rad"),
    ):
        if bound is not None and not value <= bound:
            yield f"{name} {value:.3g} {unit}, not ≤ {bound:g}"


def _late(what: str, value: float | None, bound: float | None) -> Iterator[str]:
    if bound is None:
        return
    if value is None:
        yield f"{what} never, not ≤ {bound:g} s"
    elif not value <= bound:
        yield f"{what} after {value:.3g} s, not ≤ {bound:g}"
