"""From the log of a run to a calibrated cell, by the command a person types."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from tests.support.command import coop
from tests.support.coop import coop as run_process

REALITY = (
    "simulation.reality.arms.left.base_m=[0.006,0.0,-0.005]",
    "simulation.reality.arms.left.zeros_rad=[0.012,-0.01,0.014]",
    "simulation.reality.arms.right.zeros_rad=[-0.01,0.013,-0.012]",
    "simulation.reality.pads_N_per_m=1e4",
    "simulation.reality.pads_Nm_per_rad=50.0",
)
UNSURE = ("tolerance.base_m=0.01", "tolerance.zeros_rad=0.017")


@pytest.mark.long  # tests/unit/process/test_floats.py has the way from a log to a cell without processes
def test_a_run_becomes_a_cell_whose_arms_agree(tmp_path: Path) -> None:
    real = [word for key in REALITY for word in ("--set", key)]
    done = run_process("run", "two_wx200", *real, "--duration", 7, "--no-report", "--out", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    unsure = [word for key in UNSURE for word in ("--set", key)]
    done = coop("calibrate", "run/run.mcap", "--out", "new", "--json", *unsure, cwd=tmp_path)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["disagreement_before"]["rms_m"] > 2e-3
    assert found["disagreement_after"]["rms_m"] < 0.5e-3
    assert found["disagreement_after"]["rms_rad"] < 1e-3
    written = tmp_path / found["written"]
    assert (tmp_path / "new" / "two_wx200_calibrated.png").read_bytes().startswith(b"\x89PNG")
    assert load_cell(written).arms[0].entry.arm_file == "two_wx200_calibrated_left.toml"
