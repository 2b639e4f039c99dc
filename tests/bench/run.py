"""The paper's 100 s, all processes and the recorder: simulated over wall time, beside the same loop in one process.

Both are taken in turn and the medians compared: on a shared machine one core may lose a third of its speed for seconds.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import configs
from agent.config.cell import Cell, load_cell
from tests.bench.common import Figure
from tests.support.plant.inprocess import simulate

NAMES = ("run_real_time_factor",)
BASELINE_S = 20.0
ROUNDS = 5


def bench() -> dict[str, Figure]:
    """Baseline: plant and both agents in one process, no sockets, no log."""
    paper = configs.CELLS_DIR / "paper.toml"
    cell = load_cell(paper)
    rounds = [(one_process(cell), all_processes(paper)) for _ in range(ROUNDS)]
    baseline, value = (statistics.median(column) for column in zip(*rounds, strict=True))
    return {"run_real_time_factor": Figure(value, "x", baseline)}


def one_process(cell: Cell) -> float:
    """Simulated over wall time of the loop in this process."""
    begin = time.perf_counter()
    simulate(cell, BASELINE_S)
    return BASELINE_S / (time.perf_counter() - begin)


def all_processes(path: Path) -> float:
    """Simulated over wall time that `coop run` reports of a whole run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [sys.executable, "-m", "agent.cli", "run", str(path), "--out", str(out)]
        subprocess.run(command, check=True, capture_output=True)
        factor: float = json.loads((out / "results.json").read_text())["real_time_factor"]
        return factor
