"""Which poses of a run are shown as the actual ones, and how long its start is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from agent.report.prepared import Prepared
from agent.report.results import Results
from agent.report.series import Array, PoseSeries

START_MIN_S, START_DECAYS = 0.5, 4.0  # the start is shown for this many times the longest decay
SEEN_BY: Final = "actual, seen by "
LETTERS: Final = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"  # names of runs that are compared


def object_series(run: Prepared) -> Iterator[tuple[str, PoseSeries]]:
    """What is drawn as the actual pose: the true one where the log holds it, otherwise every arm's own view."""
    if run.true is not None:
        yield "actual", run.true
    else:
        yield from ((f"{SEEN_BY}{name}", run.pose(name)) for name in run.rows)


def start_s(run: Prepared) -> float:
    """How long the start figure is: until the errors of the start have decayed."""
    decays = [START_MIN_S]
    for _, s in object_series(run):
        for error in (s.position_error, s.attitude_error):
            above = np.flatnonzero(error > 0.1 * error[:1])  # nothing of an arm without a fresh state
            if len(above) and s.t[above[-1]] < run.info.transient_s:
                decays.append(START_DECAYS * float(s.t[above[-1]] - s.t[0]))
    return min(max(decays), run.info.duration_s)


@dataclass(frozen=True, slots=True)
class ErrorSeries:
    """The size of the errors of one run over its time."""

    t: Array
    position: Array  # m
    attitude: Array  # rad
    start_s: float  # the errors of the start have decayed by then
    transient_s: float


@np.errstate(over="ignore", invalid="ignore")  # poses of a run that went astray: what is no number counts as none
def error_series(run: Prepared) -> ErrorSeries:
    """Of the true pose where the log holds it, otherwise as the first arm sees it; empty without a row."""
    series = next((s for _, s in object_series(run)), None)
    if series is None or not len(series.t):
        return ErrorSeries(np.empty(0), np.empty(0), np.empty(0), 1.0, 0.0)
    return ErrorSeries(series.t, series.position_error, series.attitude_error, start_s(run), run.info.transient_s)


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run of a comparison, in what is left of it when its log is closed."""

    log: Path
    results: Results
    settings: dict[str, str]
    errors: ErrorSeries
