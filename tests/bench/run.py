"""The paper's 100 s, all processes and the recorder: simulated over wall time, beside the same loop in one process."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import configs
from agent.config.cell import load_cell
from tests.bench.common import Figure
from tests.support.plant.inprocess import simulate

NAMES = ("run_real_time_factor",)
BASELINE_S = 20.0


def bench() -> dict[str, Figure]:
    """Baseline: plant and both agents in one process, no sockets, no log."""
    paper = configs.CELLS_DIR / "paper.toml"
    begin = time.perf_counter()
    simulate(load_cell(paper), BASELINE_S)
    baseline = BASELINE_S / (time.perf_counter() - begin)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        subprocess.run(
            [sys.executable, "-m", "agent.cli", "run", str(paper), "--out", str(out)], check=True, capture_output=True
        )
        results = json.loads((out / "results.json").read_text())
    return {"run_real_time_factor": Figure(results["real_time_factor"], "x", baseline)}
