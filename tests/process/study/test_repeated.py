"""A run of a study and `coop run` of its cell file are one motion, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.reality import draw
from agent.config.schema.fault import Fault, FaultKind
from agent.log.read import read_log
from agent.modes import Mode
from agent.process.arranged import REASON
from agent.study.lab import Laboratory, Run
from agent.study.measure import measure
from agent.study.study import worst_cell
from agent.telemetry.row.sample import MAX_JOINTS
from sim_backend.physics.snapshot import Observation
from tests.support.loaded import coop
from tests.support.study import cell

STRUCK = (("hold", "right", 0.201), ("locked", "left", 0.25), ("limp", "right", 0.3), ("open", "left", 0.402))


def test_what_befell_the_worst_run_of_a_study_befalls_its_arms_in_coop_run_in_the_same_cycle(tmp_path: Path) -> None:
    pads = "simulation.grasp={stiffness_N_per_m=1e5, stiffness_Nm_per_rad=100.0}"
    studied = Laboratory(cell("simulation.ready_s=0.1", pads, "simulation.observe_rate_hz=200.0"))
    faults = [Fault(kind=FaultKind(kind), arm=arm, at_s=at_s) for kind, arm, at_s in STRUCK]
    path = tmp_path / "worst.toml"
    path.write_bytes(worst_cell(studied.cell, measure(studied, None, index=3, seed=11, faults=faults), faults))
    coop("run", path, "--no-report", "--out", tmp_path / "out")
    log = read_log(tmp_path / "out" / "run.mcap")
    assert log.plant is not None
    reality = draw(studied.cell.file.tolerance, 11, studied.cell)
    run, seen = Run(studied, reality, faults), list[Observation]()
    for _ in range(120):
        seen.append(run.observe())
        run.advance()
    rows = log.plant[: len(seen)]
    for name in ("p_object", "quat_object", "v_object"):
        assert np.array_equal(np.array([getattr(s, name) for s in seen]), rows[name]), name
    for name in ("q", "dq", "tau_applied", "tau_friction"):
        both = rows[name].reshape(len(seen), -1, MAX_JOINTS)[:, :2, :3].reshape(len(seen), 6)
        assert np.array_equal(np.array([getattr(s, name) for s in seen]), both), name
    assert np.array_equal(np.array([s.grasp_wrench.ravel() for s in seen]), rows["grasp_wrench"][:, :12])
    told, row = json.loads((tmp_path / "out/results.json").read_text()), measure(studied, reality, 3, 11, faults)
    assert told["max_position_error_m"] == pytest.approx(row.position_error_m, rel=1e-12)
    assert told["max_attitude_error_rad"] == pytest.approx(row.attitude_error_rad, rel=1e-10)
    assert told["internal_force_mean_N"] == pytest.approx(row.internal_force_mean_N, rel=1e-2)
    held = log.agents["right"]["mode"] == Mode.HOLD
    assert np.flatnonzero(held)[0] == 20 + 41 + 1, "stopped in the cycle of 0.205 s, it holds in the next"
    assert held[-1], "to the end: its operator lets nothing go"
    assert [(event.source, event.text) for event in log.events if event.text == REASON] == [("right", REASON)]


def test_with_unequal_shares_a_report_and_a_study_have_one_internal_force(tmp_path: Path) -> None:
    path = tmp_path / "unlike.toml"
    shares = ("object.mass_kg=0.3", "arms.left.load_share=0.1", "arms.right.load_share=0.9")
    short = ("duration_s=2.0", "report.transient_s=1.0", "simulation.ready_s=0.5", "simulation.observe_rate_hz=200.0")
    path.write_bytes(load_cell(Path("two_wx200"), [*short, *shares]).toml)
    coop("run", path, "--no-report", "--out", tmp_path / "out")
    told = json.loads((tmp_path / "out/results.json").read_text())
    studied = measure(Laboratory(load_cell(path)), None)
    assert told["internal_force_mean_N"] == pytest.approx(studied.internal_force_mean_N, rel=1e-2)
    assert told["internal_force_mean_N"] < 0.3
    assert told["arms"]["left"]["internal_realised"]["max_force_N"] > 1.0, "the paper's projection has the shares in it"


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
