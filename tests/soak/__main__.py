"""`make soak`: every cell runs for long, and the recorder under load; memory, descriptors and threads stay flat, no row
is lost.

SOAK_S: simulated seconds of each cell (default 1000).  SOAK_RATE_S: seconds of `recorder-rate` (60), four arms at
500 Hz in real time.  SOAK_FLAT_S: seconds of arms' time of `recorder-flat` (7200), as fast as it goes.
SOAK_HOURS_S: of `recorder-hours` (600), in one process, from which what two hours would add is worked out.
SOAK_ONLY: take the cells and entries whose name holds this text.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Final

import psutil

import configs
from agent.log.read import read_log
from tests.soak.hours import hours
from tests.soak.recorder import complete, flat
from tests.soak.watch import Series, grown, say
from tests.support.coop import COOP

LOOK_EVERY_S = 1.0
COMMAND: Final = "the command itself"


def main() -> int:
    """Run all; 0 when nothing grew and nothing was lost."""
    duration_s = float(os.environ.get("SOAK_S", "1000"))
    only = os.environ.get("SOAK_ONLY", "")
    complaints = []
    for cell in sorted(configs.CELLS_DIR.glob("*.toml")):
        if only in cell.stem:
            with tempfile.TemporaryDirectory() as folder:
                complaints += [f"{cell.stem}: {text}" for text in soak(cell, duration_s, Path(folder) / "out")]
    for name, (check, variable, seconds) in _RECORDER.items():
        if only in name:
            with tempfile.TemporaryDirectory() as folder:
                given_s = float(os.environ.get(variable, seconds))
                complaints += [f"{name}: {text}" for text in check(Path(folder), given_s)]
    for complaint in complaints:
        say(f"GREW OR LOST  {complaint}")
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
    # the run itself makes its report in the end, which is not looked at
    complaints = grown({name: each for name, each in processes.items() if name != COMMAND}) + lost(out)
    say(f"{cell.stem}: {duration_s:g} s in {time.monotonic() - begin_s:.0f} s, {len(processes)} processes")
    return complaints


def watched(run: subprocess.Popen[str]) -> dict[str, Series]:
    """Samples of the run and its processes, by their names, until it ends."""
    series: dict[str, Series] = defaultdict(Series)
    parent = psutil.Process(run.pid)
    while run.poll() is None:
        for process in [parent, *parent.children()]:
            try:
                series[COMMAND if process is parent else process.name()].look(process)
            except psutil.Error:  # it has just ended
                continue
        time.sleep(LOOK_EVERY_S)
    return series


def lost(out: Path) -> list[str]:
    """Rows that are not there."""
    results = json.loads((out / "results.json").read_text())
    log = read_log(out / "run.mcap")
    complaints = [f"{arm}: {len(log.gaps[arm])} gaps, first {log.gaps[arm][0]}" for arm in log.agents if log.gaps[arm]]
    if not results["complete"] or results["rows_expected"] != results["rows_recorded"]:
        complaints.append(f"{results['rows_recorded']} rows of {results['rows_expected']}")
    return complaints


_RECORDER: Final[dict[str, tuple[Callable[[Path, float], list[str]], str, str]]] = {
    "recorder-rate": (complete, "SOAK_RATE_S", "60"),
    "recorder-hours": (hours, "SOAK_HOURS_S", "600"),
    "recorder-flat": (flat, "SOAK_FLAT_S", "7200"),
}


if __name__ == "__main__":
    sys.exit(main())
