"""A study on two processes against the same runs in one, and a run of it against the welded loop of other tests."""

from __future__ import annotations

import time
from collections.abc import Callable

from agent.study.lab import Laboratory
from agent.study.measure import measure, run_once
from agent.study.plan import load_plan, seed_of
from agent.study.work import here, in_processes
from tests.bench.common import Figure
from tests.support.study import GAINS, PAPER

NAMES = ("study_two_processes", "study_200_runs_of_60_s", "study_run_real_time_factor")
RUNS = 24
RUN_S = 10.0
WHOLE_S = 200 * 60.0  # simulated, of a study as people run it
BRIEFLY = [*GAINS, "duration_s=0.04", "report.transient_s=0.01"]  # as good as no run: the object is seen every 20 ms


def bench() -> dict[str, Figure]:
    """`study_two_processes`: wall time of two processes, their start included, and of one; half is the ideal.

    `study_200_runs_of_60_s`: the same, worked out for a whole study, which starts its processes once too: of the short
    one their start is about a ninth.
    `study_run_real_time_factor`: of a run on soft pads, and of one on welded grasps.
    """
    plan = load_plan(PAPER, runs=RUNS, overrides=[*GAINS, f"duration_s={RUN_S}", "report.transient_s=1.0"])
    tasks, lab = plan.tasks(), Laboratory(plan.cells[0])
    two, one = seconds(lambda: list(in_processes(tasks, 2))), seconds(lambda: list(here(tasks)))
    begin = load_plan(PAPER, runs=2, overrides=BRIEFLY)
    start, whole = seconds(lambda: list(in_processes(begin.tasks(), 2))), WHOLE_S / (RUNS * RUN_S)
    soft = min(seconds(lambda: run_once(lab, 0, seed_of(0, 0))) for _ in range(3))
    welded = min(seconds(lambda: measure(lab, None)) for _ in range(3))
    return {
        "study_two_processes": Figure(two, "s", one),
        "study_200_runs_of_60_s": Figure(start + (two - start) * whole, "s", one * whole),
        "study_run_real_time_factor": Figure(RUN_S / soft, "x", RUN_S / welded),
    }


def seconds(what: Callable[[], object]) -> float:
    begin = time.perf_counter()
    what()
    return time.perf_counter() - begin
