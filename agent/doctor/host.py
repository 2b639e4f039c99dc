"""Is this host fit to run an arm in real time?  Facts are read, then judged by a pure function."""

from __future__ import annotations

import math
import os
import resource
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agent.host.clock import ClockState, read_clock
from agent.host.latency import LATE_SHARE, Fitness, Latency, files, newest
from agent.operator.local import CLOCK_WARN_S
from agent.verify.finding import Finding, Verdict, judged, warning

WHERE = "host"
PRIORITY = 80  # what the agent's unit grants
CAP_IPC_LOCK = 14


@dataclass(frozen=True, slots=True)
class HostFacts:
    """What was read."""

    fifo: bool  # this user may have SCHED_FIFO at PRIORITY
    rtprio_limit: int
    memlock_bytes: float  # inf: no limit
    governors: frozenset[str]  # empty: the machine has none to choose
    preempt_rt: bool
    kernel: str
    cores: int
    clock: ClockState
    log_folder: Path  # or the nearest parent that exists
    log_free_bytes: int
    versions: str
    latency: Latency | None = None  # the last test that is kept


def read_facts(log_folder: Path, versions: str) -> HostFacts:
    """Look at this host."""
    folder = log_folder.absolute()
    while not folder.exists():
        folder = folder.parent
    return HostFacts(
        fifo=fifo_granted(),
        rtprio_limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[1],
        memlock_bytes=_memlock_bytes(),
        governors=_governors(),
        preempt_rt=_preempt_rt(),
        kernel=os.uname().release,
        cores=len(os.sched_getaffinity(0)),
        clock=read_clock(),
        log_folder=folder,
        log_free_bytes=shutil.disk_usage(folder).free,
        versions=versions,
        latency=newest(files(os.environ)),
    )


def judge(facts: HostFacts, arms: int, log_bytes: float, rate_hz: float) -> list[Finding]:
    """Findings for `arms` arms on this host at a rate, and a run whose log takes `log_bytes`."""
    return [
        *_real_time(facts), latency_finding(facts.latency, rate_hz), *_processor(facts, arms), _clock_finding(facts),
        *_rest(facts, log_bytes),
    ]  # fmt: skip


def latency_finding(latency: Latency | None, rate_hz: float) -> Finding:
    """What the last latency test says for a loop of this rate."""
    bound = f"late ≤ {LATE_SHARE / rate_hz * 1e3:g} ms at {rate_hz:g} Hz, in real time and under load"
    if latency is None:
        return warning("wake-up latency", WHERE, "not measured", bound, "run `coop latency-test` for some minutes")
    return judged(
        "wake-up latency", WHERE, f"{latency.fitness(rate_hz)}: {latency.text}", bound,
        holds=latency.fitness(rate_hz) is Fitness.FIT, otherwise=Verdict.WARNING,
        remedy="a real-time kernel, cores of its own, a fixed CPU frequency; then `coop latency-test` again",
    )  # fmt: skip


def _real_time(facts: HostFacts) -> Sequence[Finding]:
    unit = "the units in systemd/ grant it to the agents; for other users: /etc/security/limits.d"
    memlock = "no limit" if math.isinf(facts.memlock_bytes) else f"{facts.memlock_bytes / 2**20:.0f} MB"
    return (
        judged(
            "real-time priority", WHERE,
            f"SCHED_FIFO {PRIORITY} {'granted' if facts.fifo else f'refused (RLIMIT_RTPRIO {facts.rtprio_limit})'}",
            f"SCHED_FIFO {PRIORITY}", holds=facts.fifo, remedy=unit, otherwise=Verdict.WARNING,
        ),
        judged(
            "locked memory (RLIMIT_MEMLOCK)", WHERE, memlock, "no limit", holds=math.isinf(facts.memlock_bytes),
            remedy=unit, otherwise=Verdict.WARNING,
        ),
        judged(
            "kernel", WHERE, f"{facts.kernel}{', PREEMPT_RT' if facts.preempt_rt else ', not PREEMPT_RT'}",
            "PREEMPT_RT", holds=facts.preempt_rt, otherwise=Verdict.WARNING,
            remedy="install a real-time kernel (in the mainline kernel since 6.12)",
        ),
    )  # fmt: skip


def _processor(facts: HostFacts, arms: int) -> Sequence[Finding]:
    governors = ", ".join(sorted(facts.governors)) or "none to choose on this machine"
    return (
        judged(
            "CPU frequency governor", WHERE, governors, "performance", holds=facts.governors <= {"performance"},
            otherwise=Verdict.WARNING, remedy="sudo cpupower frequency-set -g performance",
        ),
        judged(
            "processor cores", WHERE, str(facts.cores), f"one per agent, at least {arms}", holds=facts.cores >= arms,
            otherwise=Verdict.WARNING, remedy="use a host with more cores, or a host per arm",
        ),
    )  # fmt: skip


def _clock_finding(facts: HostFacts) -> Finding:
    clock = facts.clock
    return judged(
        "clock", WHERE, clock.text,
        f"synchronised, error ≤ {CLOCK_WARN_S * 1e3:g} ms",
        holds=clock.synchronised and clock.max_error_s <= CLOCK_WARN_S, otherwise=Verdict.WARNING,
        remedy="install chrony; without effect where one host has all arms",
    )  # fmt: skip


def _rest(facts: HostFacts, log_bytes: float) -> Sequence[Finding]:
    return (
        judged(
            f"room for logs in {facts.log_folder}", WHERE, f"{facts.log_free_bytes / 2**30:.2f} GB",
            f"at least {log_bytes / 2**30:.2f} GB for one run of this cell", holds=facts.log_free_bytes >= log_bytes,
            remedy="free space, or name another folder with --logs",
        ),
        Finding("versions", WHERE, facts.versions, ""),
    )  # fmt: skip


def fifo_granted() -> bool:
    """Whether this host gives this process SCHED_FIFO; takes it for a moment."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    os.sched_setscheduler(0, policy, parameter)
    return True


def _memlock_bytes() -> float:
    soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    capable = False
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("CapEff:"):
            capable = bool(int(line.split()[1], 16) >> CAP_IPC_LOCK & 1)
    return math.inf if capable or soft == resource.RLIM_INFINITY else soft


def _governors() -> frozenset[str]:
    files = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return frozenset(file.read_text().strip() for file in files)


def _preempt_rt() -> bool:
    marker = Path("/sys/kernel/realtime")
    return (marker.exists() and marker.read_text().strip() == "1") or "PREEMPT_RT" in os.uname().version
