"""Two runs side by side: every figure that differs, and which run has the better one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from rich import box
from rich.table import Table

from agent.report.numbers import number
from agent.report.quantity import Better, Quantity
from agent.report.results import HEADLINE, Results
from drivers.interface import Refusal

MANY: Final = 1000.0
TOLERANCE: Final = 0.01  # relative, within which two figures are the same


class CompareError(Refusal):
    """Logs that cannot be compared as asked."""


class Change(Enum):
    """What became of a figure from the first run to the second."""

    SAME = ""
    UNKNOWN = "not known"  # of neither
    BETTER = "better"
    WORSE = "worse"
    DIFFERENT = "different"  # where neither way is better
    APPEARED = "only in B"
    GONE = "only in A"


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure of both runs; a value is NaN where that run did not measure it."""

    name: str
    unit: str
    a: float
    b: float
    change: Change

    @property
    def differs(self) -> bool:
        """Whether the runs do, as far as that is known."""
        return self.change not in (Change.SAME, Change.UNKNOWN)

    @property
    def relative(self) -> float:
        """(b − a) / |a|; NaN where it has no meaning."""
        return (self.b - self.a) / abs(self.a) if self.a and math.isfinite(self.a) else float("nan")

    @property
    def words(self) -> str:
        """The change for a person: `better, −12.3 %`."""
        return ", ".join(filter(None, (self.change.value, self.percent if self.change.value else "")))

    @property
    def percent(self) -> str:
        """The relative change for a person; empty where it has no meaning."""
        if not math.isfinite(self.relative):
            return ""
        return f"{100 * self.relative:+.1f} %" if abs(self.relative) < MANY else f"over {MANY:.0f} times"


def compare(a: Results, b: Results) -> list[Difference]:
    """Every figure of either run, headline first; figures closer than TOLERANCE (relative) count as the same.

    None is better or worse where one of the runs cannot be judged.
    """
    first, second = a.flat(), b.flat()
    names = [*HEADLINE, *(n for n in first if n not in HEADLINE), *(n for n in second if n not in first)]
    judged = a.judged and b.judged
    return [_difference(name, first.get(name), second.get(name), judged=judged) for name in names]


def comparison_table(
    a: Results, b: Results, differences: Iterable[Difference], names: tuple[str, str] = ("A", "B")
) -> Table:
    """What differs, for the terminal; the headline figures are shown in any case."""
    title = f"{names[0]}: {label(a)}\n{names[1]}: {label(b)}"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("figure", *names, "change", ""):
        table.add_column(heading, justify="left" if heading in ("figure", "") else "right", overflow="fold")
    colours = {Change.BETTER: "green", Change.WORSE: "red"}
    for d in differences:
        if not d.differs and d.name not in HEADLINE:
            continue
        style = colours.get(d.change, "")
        table.add_row(d.name, number(d.a, d.unit), number(d.b, d.unit), d.percent, d.change.value, style=style)
    return table


def _difference(name: str, a: Quantity | None, b: Quantity | None, *, judged: bool) -> Difference:
    known = a or b
    assert known is not None  # the name came from one of the two
    left, right = (q.value if q else float("nan") for q in (a, b))
    return Difference(name, known.unit, left, right, _change(left, right, known.better if judged else Better.NEITHER))


def _change(a: float, b: float, better: Better) -> Change:
    known = math.isfinite(a), math.isfinite(b)
    if not all(known):
        return Change.GONE if known[0] else Change.APPEARED if known[1] else Change.UNKNOWN
    if math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=0.0):
        return Change.SAME
    if better is Better.NEITHER:
        return Change.DIFFERENT
    return Change.BETTER if (b < a) is (better is Better.LOWER) else Change.WORSE


def label(results: Results) -> str:
    """What a run is, in a line."""
    info = results.info
    law = info.controller.get("kind", "unknown")
    rehearsing = f", REHEARSAL of {', '.join(results.rehearsing)}" if results.rehearsing else ""
    return f"{info.cell}, {law} law, {info.driver}{rehearsing}, {info.rate_hz:g} Hz, cell {info.fingerprint[:8]}"
