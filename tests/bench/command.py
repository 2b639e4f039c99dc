"""CPU of the commands that a person waits for; baseline: what this machine is allowed, by its bare pinocchio calls."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence

import configs
from tests.bench.common import Figure, median_us
from tests.bench.control import BASELINE_CALLS, SIX, bare_calls, make_agent

NAMES = ("coop_help_cpu_s", "coop_check_cpu_s")

REPEATS = 11
BOUNDED_AT_US = 5.4  # bare 6-DoF calls of the machine that the bounds are for
HELP_S, CHECK_S = 0.2, 0.6


def bench() -> dict[str, Figure]:
    """Median CPU, user and system, of a whole process with warm caches; a ratio up to 1 keeps the bound."""
    bare = bare_calls(make_agent(*SIX))
    paper = str(configs.CELLS_DIR / "paper.toml")
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        for name, line, bound in (("help", ["--help"], HELP_S), ("check", ["check", paper], CHECK_S)):
            before_us = median_us(bare, BASELINE_CALLS, REPEATS)
            cpu_s = statistics.median([cpu(line, cache) for _ in range(REPEATS + 1)][1:])
            speed_us = statistics.fmean((before_us, median_us(bare, BASELINE_CALLS, REPEATS)))
            found[f"coop_{name}_cpu_s"] = Figure(cpu_s, "s", bound * speed_us / BOUNDED_AT_US)
    return found


def cpu(line: Sequence[str], cache: str) -> float:
    """CPU of one `coop`, s; its bytecode is kept in `cache`, as an installation keeps it beside the sources."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "agent.cli", *line], env=environment | {"PYTHONPYCACHEPREFIX": cache},
        check=True, capture_output=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
