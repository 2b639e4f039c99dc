"""`make soak`: every cell runs for long; memory, descriptors and threads of each process stay flat, no row is lost.

SOAK_S: simulated seconds of each cell (default 1000).  SOAK_ONLY: take the cells whose name holds this text.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import psutil

import configs
from agent.log.read import read_log
from tests.soak.flat import growth
from tests.support.coop import COOP

LOOK_EVERY_S = 1.0
SHORTEST_S = 20.0  # a process that lived for less says nothing
RISE_MAX = {"memory_MB": 2.0, "descriptors": 1.0, "threads": 1.0}


@dataclass
class Series:
    """Samples of one process."""

    t: list[float] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


def main() -> int:
    """Run all; 0 when nothing grew and nothing was lost."""
    duration_s = float(os.environ.get("SOAK_S", "1000"))
    only = os.environ.get("SOAK_ONLY", "")
    complaints = []
    for cell in sorted(configs.CELLS_DIR.glob("*.toml")):
        if only in cell.stem:
            with tempfile.TemporaryDirectory() as folder:
                complaints += [f"{cell.stem}: {text}" for text in soak(cell, duration_s, Path(folder) / "out")]
    for complaint in complaints:
        _say(f"GREW OR LOST  {complaint}")
    return 1 if complaints else 0


def soak(cell: Path, duration_s: float, out: Path) -> list[str]:
    """What is wrong with one run of a cell."""
    command = [*COOP, "run", str(cell), "--duration", str(duration_s), "--out", str(out)]
    begin_s = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as run:
        processes = watched(run)
        _, err = run.communicate()
    if run.returncode != 0:
        return [f"exit code {run.returncode}: {err.strip()}"]
    complaints = grown(processes) + lost(out)
    _say(f"{cell.stem}: {duration_s:g} s in {time.monotonic() - begin_s:.0f} s, {len(processes)} processes")
    return complaints


def watched(run: subprocess.Popen[str]) -> dict[str, Series]:
    """Samples of the run and its processes, by their words, until it ends."""
    series: dict[str, Series] = defaultdict(Series)
    parent = psutil.Process(run.pid)
    while run.poll() is None:
        for process in [parent, *parent.children()]:
            try:
                with process.oneshot():
                    name = " ".join(Path(word).name for word in process.cmdline()[3:9])
                    memory = process.memory_info()
                    taken = {
                        "memory_MB": (memory.rss - memory.shared) / 1e6,  # rings are shared and fill at first
                        "descriptors": float(process.num_fds()),
                        "threads": float(process.num_threads()),
                    }
            except psutil.Error:  # it has just ended
                continue
            series[name].t.append(time.monotonic())
            for what, value in taken.items():
                series[name].values[what].append(value)
        time.sleep(LOOK_EVERY_S)
    return series


def grown(processes: dict[str, Series]) -> list[str]:
    """What rose after the run had settled; the run itself makes its report in the end, which is not looked at."""
    complaints = []
    for name, series in processes.items():
        if name.startswith("run ") or series.t[-1] - series.t[0] < SHORTEST_S:
            continue
        for what, most in RISE_MAX.items():
            found = growth(series.t, series.values[what])
            _say(f"  {name}: {what} {found.settled:.1f} → {found.last:.1f}")
            if found.rise > most:
                complaints.append(f"{name}: {what} rose by {found.rise:.1f}, at most {most:g} is allowed")
    return complaints


def lost(out: Path) -> list[str]:
    """Rows that are not there."""
    results = json.loads((out / "results.json").read_text())
    log = read_log(out / "run.mcap")
    complaints = [f"{arm}: {len(log.gaps[arm])} gaps, first {log.gaps[arm][0]}" for arm in log.agents if log.gaps[arm]]
    if not results["complete"] or results["rows_expected"] != results["rows_recorded"]:
        complaints.append(f"{results['rows_recorded']} rows of {results['rows_expected']}")
    return complaints


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
