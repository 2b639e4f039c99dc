"""Runs that tests share the way of: each goes on as if it had been carried out by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.schema.fault import Fault, FaultKind
from agent.study.lab import Laboratory, Run
from tests.support.branched import branched, ways


def same(one: Run, two: Run) -> bool:
    memories = [np.array([place.memory.flatten() for place in run.places]).tobytes() for run in (one, two)]
    plants = [(run.plant.q.tobytes(), run.plant.dq.tobytes(), run.peak_Nm.tobytes()) for run in (one, two)]
    return memories[0] == memories[1] and plants[0] == plants[1] and one.trips == two.trips


def test_a_branch_is_what_a_run_with_these_faults_would_be_to_the_bit_and_changes_none_beside_it() -> None:
    lab = Laboratory(load_cell(Path("two_wx200"), ["simulation.ready_s=0.05"]))
    until, faults = ways(lab), [Fault(kind=kind, arm="left", at_s=0.1) for kind in (FaultKind.OPEN, FaultKind.LIMP)]
    runs = [branched(until(0.1), lab, fault) for fault in faults] + [until(0.15)]
    alone = [Run(lab, None, [fault]) for fault in faults] + [Run(lab, None)]
    for run in (*runs[:2], *alone):
        while run.t < 0.15:
            run.advance()
    assert [[same(run, other) for other in runs] for run in alone] == np.eye(3, dtype=bool).tolist()


def test_no_branch_has_a_fault_that_comes_too_late() -> None:
    lab = Laboratory(load_cell(Path("two_wx200"), ["simulation.ready_s=0.05"]))
    with pytest.raises(AssertionError, match="too late"):
        branched(ways(lab)(0.02), lab, Fault(kind=FaultKind.LIMP, arm="left", at_s=0.01))
