"""Under memory pressure: everything that the kernel may page out of the agent's process is asked for, before and after.

The kernel pages out what a process advises it to (MADV_PAGEOUT), as it would by itself when memory is short.
"""

from __future__ import annotations

import ctypes
import gc
import json
import mmap
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.doctor.host import fifo_granted
from agent.host.realtime import RealtimeError, become_realtime, quiet_memory
from agent.loop import Agent, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from drivers.interface import JointState, Vector
from tests.support.starts import start_joints

ROOT = Path(__file__).parents[3]
PAGEOUT = 21
TICKS = 300


@pytest.mark.fault("P4")
def test_a_locked_agent_has_no_major_fault_and_no_collection_under_memory_pressure() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "tests.unit.host.test_quiet_memory"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(ran.stdout)
    if "refused" in found:
        pytest.skip(f"this host does not give the rights: {found['refused']}")
    assert found["before"]["faults"] > 0, "the pressure is felt where nothing is locked"
    assert found["before"]["collections"] > 0, "and so is the collector where it is on"
    assert found["locked"] == {"faults": 0, "collections": 0}


@pytest.mark.skipif(not fifo_granted(), reason="this host gives no real-time priority")
@pytest.mark.parametrize("priority", [pytest.param(1, marks=pytest.mark.long), 80])
def test_an_agent_locks_its_memory_before_the_unit_counts_the_time_that_it_does_not_sleep(priority: int) -> None:
    """LimitRTTIME of the shipped units; to lock what an agent has loaded takes longer."""
    code = (
        "import agent.process.agent as a, time; from agent.host.realtime import leave_realtime; a.quiet_memory()\n"
        f"a.become_realtime({priority}); print(a.granted().real, a.granted().locked_bytes > 100e6)\n"
        "leave_realtime(); print(a.granted().policy)\n"
        "begin = time.process_time()\nwhile time.process_time() < begin + 0.15: pass"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, preexec_fn=_limit
    )
    assert (ran.returncode, ran.stdout.split()) == (0, ["True", "True", "SCHED_OTHER"]), ran.stderr


@pytest.mark.skipif(not fifo_granted(), reason="this host gives no real-time priority")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become the user of a unit")
def test_a_user_without_privileges_gives_real_time_back_too() -> None:
    """The units' user, who got it by LimitRTPRIO alone."""
    code = (
        "import os; from agent.host.realtime import *; become_realtime(10)\n"
        "os.setgid(65534); os.setuid(65534); leave_realtime(); print(granted().policy)"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout.split()) == (0, ["SCHED_OTHER"]), ran.stderr


def _limit() -> None:
    (text,) = re.findall(r"LimitRTTIME=(\d+)ms:(\d+)ms", (ROOT / "systemd" / "coop-agent@.service").read_text())
    resource.setrlimit(resource.RLIMIT_RTTIME, (1000 * int(text[0]), 1000 * int(text[1])))


def _press() -> None:
    """Give back every page that may be given back."""
    libc = ctypes.CDLL(None)
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for line in Path("/proc/self/maps").read_text().splitlines():
        begin, end = (int(text, 16) for text in line.split(" ", 1)[0].split("-"))
        if end < 1 << 63 and "[v" not in line:  # all but the kernel's own
            libc.madvise(begin, end - begin, PAGEOUT)


def _counts() -> tuple[int, int]:
    return resource.getrusage(resource.RUSAGE_SELF).ru_majflt, sum(g["collections"] for g in gc.get_stats())


def _run(agent: Agent, q: Vector, file: mmap.mmap) -> dict[str, int]:
    """Ticks of the agent with pressure between them, and what they cost; a file that is mapped stands for libraries."""
    faults, collections = _counts()
    memory, still, made = initial_memory(agent), np.zeros(len(q)), []
    for k in range(TICKS):
        if k % 100 == 50:
            _press()
        memory = step(agent, JointState(0, q, still, still), k * agent.period_s, Mode.READY, memory).memory
        made += [[k] for _ in range(50)]  # what a collector counts
        sum(file[:: mmap.PAGESIZE])  # what was paged out
    after = _counts()
    return {"faults": after[0] - faults, "collections": after[1] - collections}


def _main(path: Path) -> dict[str, object]:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    agent, q = build_agent(cell, cell.arms[0]), start_joints(cell)[0]
    path.write_bytes(os.urandom(1 << 20))
    with path.open("r+b") as written:
        os.fsync(written.fileno())
        file = mmap.mmap(written.fileno(), 0)
    found: dict[str, object] = {"before": _run(agent, q, file)}
    quiet_memory()
    try:
        become_realtime(1)
    except RealtimeError as error:
        return {"refused": str(error)}
    found["locked"] = _run(agent, q, file)
    return found


if __name__ == "__main__":
    # on a disk, for what lies in memory is never paged out of it, and where neither git nor a package being built looks
    place = ROOT / ".pytest_cache" / f"pressure-{os.getpid()}"
    place.parent.mkdir(exist_ok=True)
    try:
        sys.stdout.write(json.dumps(_main(place)))
    finally:
        place.unlink(missing_ok=True)
