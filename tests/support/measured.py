"""A command of `coop` in a process of its own, with the memory and time that it took."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

# VmHWM and not ru_maxrss: that one begins with the memory of the process that starts the command
CHILD = """
import json, re, sys, time
from pathlib import Path
begin, told = time.perf_counter(), Path(sys.argv.pop(1))
from agent.cli.main import main
try:
    main()
finally:
    peak_kB = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]
    figures = {"peak_MB": int(peak_kB) / 1e3, "wall_s": time.perf_counter() - begin, "cpu_s": time.process_time()}
    told.write_text(json.dumps(figures))
"""


@dataclass(frozen=True)
class Measured:
    """What a command took."""

    peak_MB: float  # of memory that was resident at once
    wall_s: float
    cpu_s: float


def measured(*arguments: str | Path) -> Measured:
    """Run `coop` with these arguments; raises CalledProcessError when it fails."""
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "figures.json"
        command = [sys.executable, "-c", CHILD, str(told), *map(str, arguments)]
        subprocess.run(command, check=True, capture_output=True, text=True)
        return Measured(**json.loads(told.read_text()))
