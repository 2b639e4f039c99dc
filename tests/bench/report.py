"""What a whole report takes: two arms and a plant at 200 Hz, 100 s and 2000 s, time and memory.

`report_100s` is the report alone, from the first import to the last file; the others are of the command, with the log.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.bench.common import Figure
from tests.support.measured import measured
from tests.support.telemetry.long_log import make_long_log

# by the seconds of the run: how much memory and time the command may take
ALLOWED = {100: (250.0, 10.0), 2000: (500.0, 60.0)}
NAMES = ("report_100s", *(f"report_{s}s_{what}" for s in ALLOWED for what in ("memory", "time", "cpu")))

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

    figures = {"report_100s": Figure(statistics.median(once() for _ in range(3)), "s")}
    for seconds, (memory_MB, time_s) in ALLOWED.items():
        figures |= command(seconds, memory_MB, time_s)
    return figures


def command(seconds: int, memory_MB: float, time_s: float) -> dict[str, Figure]:
    """`coop report` on a synthetic log of so many seconds; baselines are what it may take."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        make_long_log(folder / "run.mcap", seconds)
        took = measured("report", folder / "run.mcap", "--out", folder / "report")
    return {
        f"report_{seconds}s_memory": Figure(took.peak_MB, "MB", baseline=memory_MB),
        f"report_{seconds}s_time": Figure(took.wall_s, "s", baseline=time_s),
        f"report_{seconds}s_cpu": Figure(took.cpu_s, "s"),
    }
