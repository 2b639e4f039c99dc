"""How long a whole report takes: 100 s at 200 Hz of two arms, from the first import to the last file."""

from __future__ import annotations

import statistics
import subprocess
import sys

from tests.bench.common import Figure

NAMES = ("report_100s",)

# the rows are made before the clock starts: they stand for a log that is read already
CHILD = """
import sys, tempfile, time
from pathlib import Path
from tests.support.telemetry.synthetic_run import paper_run
log = paper_run(Path("run.mcap"))
start = time.perf_counter()
from agent.report.report import write_report
with tempfile.TemporaryDirectory() as folder:
    write_report(log, Path(folder))
    sys.stdout.write(str(time.perf_counter() - start))
"""


def bench() -> dict[str, Figure]:
    def once() -> float:
        return float(subprocess.run([sys.executable, "-c", CHILD], check=True, capture_output=True, text=True).stdout)

    return {"report_100s": Figure(statistics.median(once() for _ in range(3)), "s")}
