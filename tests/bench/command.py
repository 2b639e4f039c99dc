"""CPU of the commands that a person waits for; baseline: what this machine is allowed, by its bare pinocchio calls."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence

import configs
from tests.bench.common import Figure, median_us
from tests.bench.control import BASELINE_CALLS, SIX, make_agent, rigid_body_terms_of

REPEATS = 15
BOUNDED_AT_US = 5.4  # bare 6-DoF calls of the machine that the bounds are for
COMMANDS = {  # what is typed, and its bound there, s
    "coop_help_cpu_s": (["--help"], 0.2),
    "coop_check_cpu_s": (["check", str(configs.CELLS_DIR / "paper.toml")], 0.6),
}
NAMES = tuple(COMMANDS)


def bench() -> dict[str, Figure]:
    """CPU, user and system, of a whole process with warm caches; a ratio up to 1 keeps the bound.

    The least of many, of both: what else the machine does makes a start slower by half, and a tight loop hardly.
    """
    bare = rigid_body_terms_of(make_agent(*SIX))
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        for name, (line, bound_s) in COMMANDS.items():
            cpu(line, cache)
            rounds = [(cpu(line, cache), median_us(bare, BASELINE_CALLS, 3)) for _ in range(REPEATS)]
            cpu_s, bare_us = (min(values) for values in zip(*rounds, strict=True))
            found[name] = Figure(cpu_s, "s", bound_s * bare_us / BOUNDED_AT_US)
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
