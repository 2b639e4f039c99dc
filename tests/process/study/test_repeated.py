"""A run of a study and `coop run` of its cell file are one motion, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.log.read import read_log
from agent.study.lab import Laboratory, Run
from agent.study.measure import measure
from agent.study.study import worst_cell
from agent.telemetry.row.sample import MAX_JOINTS
from tests.support.coop import coop
from tests.support.study import cell


@pytest.mark.long  # test_network_independence.py compares processes with the laboratory, too
def test_the_worst_run_of_a_study_is_repeated_by_coop_run(tmp_path: Path) -> None:
    studied = Laboratory(cell("simulation.ready_s=0.1", "controller.alignment.ready_per_s=2.0"))
    path = tmp_path / "worst.toml"
    path.write_bytes(worst_cell(studied.cell, measure(studied, None, index=3, seed=11)))
    coop("run", path, "--no-report", "--out", tmp_path / "out")
    log = read_log(tmp_path / "out" / "run.mcap")
    rows = log.plant
    assert rows is not None
    repeated, told = measure(Laboratory(load_cell(path)), None), json.loads((tmp_path / "out/results.json").read_text())
    assert told["peak_torque_fraction"]["worst"]["value"] == pytest.approx(repeated.peak_torque_fraction)
    assert told["internal_force_mean_N"] == pytest.approx(repeated.internal_force_mean_N, rel=0.02)
    run, seen = Run(Laboratory(load_cell(path)), None), []
    for tick in range(120):
        if tick % 4 == 0:
            seen.append(run.observe())
        run.advance()
    assert len(rows) == len(seen) + 1  # the plant also sees the end of the last tick
    rows = rows[: len(seen)]
    assert np.array_equal(np.array([s.p_object for s in seen]), rows["p_object"])
    assert np.array_equal(
        np.array([s.dq for s in seen]), rows["dq"][:, [0, 1, 2, MAX_JOINTS, MAX_JOINTS + 1, MAX_JOINTS + 2]]
    )
    assert np.array_equal(np.array([s.grasp_wrench.ravel() for s in seen]), rows["grasp_wrench"][:, :12])
    left, right = (log.agents[name] for name in ("left", "right"))
    assert np.ptp(right["t"] - left["t"]) < 1e-9
    skews = [rows["t"][0] + 0.1 for rows in (left, right)]
    assert min(skews) >= 0.0
    assert skews[0] != skews[1]
