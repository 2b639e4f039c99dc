"""How late this host wakes a control loop, while the loop works and, if asked for, while everything else does too.

The loop is that of an agent: absolute deadlines, work in every cycle, missed cycles left out.  What is kept is a
histogram, so a test of days takes no more memory than one of seconds.
"""

from __future__ import annotations

import bisect
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from agent.atomic import WriteError, make_folder, write_atomically
from agent.host.realtime import RealTime
from drivers.interface import Clock

SCHEMA = 1
WORK_SHARE = 0.3  # of the period: what a cycle of six joints takes at 500 Hz
LATE_SHARE = 0.5  # of the period: a loop that wakes later has no time left for its cycle
EDGES_US: tuple[float, ...] = tuple(
    round(10.0 ** (k / 10.0), 3) for k in range(71)
)  # 1 µs to 10 s; a bin is a quarter wider than the last

SYSTEM_FILE = Path("/var/lib/coop-host/latency.json")  # which an agent's unit may read

# Work for one core: compute, memory, disk; ends with whoever started it.
_LOAD = """
import ctypes, os, tempfile, zlib
ctypes.CDLL(None).prctl(1, 15, 0, 0, 0)
if os.getppid() != int(__import__("sys").argv[1]): raise SystemExit
data = os.urandom(1 << 20)
with tempfile.TemporaryFile() as file:
    while True:
        block = bytearray(16 << 20)
        block[::4096] = b"x" * len(block[::4096])
        zlib.compress(data, 6)
        file.seek(0); file.write(data); file.flush(); os.fsync(file.fileno())
"""


class Fitness(StrEnum):
    """What the test says of the host at one rate."""

    FIT = "fit"
    DOUBTFUL = "doubtful"  # one cycle in a thousand may be later than it should
    UNFIT = "unfit"


@dataclass
class Histogram:
    """Of how late the cycles began, s."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(EDGES_US) + 1))
    cycles: int = 0
    missed: int = 0
    max_s: float = 0.0

    def add(self, late_s: float) -> None:
        """One cycle."""
        self.counts[bisect.bisect_left(EDGES_US, late_s * 1e6)] += 1
        self.cycles += 1
        self.max_s = max(self.max_s, late_s)

    def share_s(self, share: float) -> float:
        """What this share of the cycles did not exceed: an edge of a bin, or the largest of all."""
        wanted, seen = math.ceil(share * self.cycles), 0
        for edge_us, count in zip(EDGES_US, self.counts, strict=False):
            seen += count
            if seen >= wanted:
                return min(edge_us * 1e-6, self.max_s)
        return self.max_s


@dataclass(frozen=True)
class Latency:
    """A finished test."""

    utc_ns: int
    kernel: str
    cores: int
    seconds: float
    rate_hz: float
    loaded: bool
    real_time: RealTime
    histogram: Histogram

    def fitness(self, rate_hz: float) -> Fitness:
        """For a loop of this rate."""
        bound_s = LATE_SHARE / rate_hz
        if not self.histogram.cycles or self.histogram.share_s(0.999) > bound_s:
            return Fitness.UNFIT
        fine = self.histogram.max_s <= bound_s and self.real_time.real and self.loaded
        return Fitness.FIT if fine else Fitness.DOUBTFUL

    @property
    def text(self) -> str:
        """In words, but for the judgement."""
        found = self.histogram
        load = "under load" if self.loaded else "without load"
        return (
            f"late ≤ {found.max_s * 1e3:.2f} ms, 99.9 % ≤ {found.share_s(0.999) * 1e3:.2f} ms in {self.seconds:.0f} s "
            f"at {self.rate_hz:g} Hz {load}, {self.real_time.policy} {self.real_time.priority}"
        )

    def document(self) -> dict[str, Any]:
        """As it is kept."""
        found = self.histogram
        return {
            "schema": SCHEMA,
            **{name: getattr(self, name) for name in ("utc_ns", "kernel", "cores", "seconds", "rate_hz", "loaded")},
            "real_time": asdict(self.real_time),
            "fitness": self.fitness(self.rate_hz).value,
            "cycles": found.cycles,
            "missed": found.missed,
            "late_s": {
                "p50": found.share_s(0.5), "p99": found.share_s(0.99), "p99_9": found.share_s(0.999),
                "max": found.max_s,
            },
            "edges_us": list(EDGES_US),
            "counts": found.counts,
        }  # fmt: skip

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Latency:
        """Of a document.  Raises ValueError when it is none."""
        try:
            if document["schema"] != SCHEMA or len(document["counts"]) != len(EDGES_US) + 1:
                raise ValueError("not a latency test of this version")
            counts = [int(count) for count in document["counts"]]
            found = Histogram(counts, sum(counts), int(document["missed"]), float(document["late_s"]["max"]))
            return cls(
                int(document["utc_ns"]), str(document["kernel"]), int(document["cores"]), float(document["seconds"]),
                float(document["rate_hz"]), document["loaded"] is True, RealTime(**document["real_time"]), found,
            )  # fmt: skip
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"not a latency test: {error!r}") from error


def measure(seconds: float, rate_hz: float, clock: Clock, stop: Callable[[], bool]) -> Histogram:
    """Wake, work, sleep, until the time is over or a stop is asked for."""
    period_ns = round(1e9 / rate_hz)
    work_ns = round(WORK_SHARE * period_ns)
    found = Histogram()
    begin_ns = clock.now_ns() + period_ns
    tick, ticks = 0, round(seconds * rate_hz)
    while tick < ticks and not stop():
        deadline_ns = begin_ns + tick * period_ns
        clock.sleep_until(deadline_ns)
        woken_ns = clock.now_ns()
        found.add((woken_ns - deadline_ns) * 1e-9)
        while clock.now_ns() - woken_ns < work_ns:
            pass
        missed = max(0, (clock.now_ns() - deadline_ns) // period_ns)
        found.missed += missed
        tick += 1 + missed
    return found


@contextmanager
def load(cores: int) -> Iterator[None]:
    """Keep these many cores, the memory and the disk busy with processes of a normal priority."""
    workers = [
        subprocess.Popen([sys.executable, "-S", "-c", _LOAD, str(os.getpid())], stdin=subprocess.DEVNULL)
        for _ in range(cores)
    ]
    try:
        yield
    finally:
        for worker in workers:
            worker.kill()
        for worker in workers:
            worker.wait()


def files(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Where results are kept: of this user, and of the host."""
    home = environment.get("XDG_STATE_HOME") or (environment.get("HOME") and f"{environment['HOME']}/.local/state")
    return (*([Path(home) / "coop" / "latency.json"] if home else []), SYSTEM_FILE)


def own_file(environment: Mapping[str, str], uid: int) -> Path:
    """Where this user keeps a result: root for the host."""
    return SYSTEM_FILE if uid == 0 else files(environment)[0]


def require_own(path: Path) -> None:
    """Refuse a place where something else than an earlier result lies.  Raises WriteError."""
    if os.path.lexists(path) and newest([path]) is None:
        raise WriteError(
            f"file {path}", found="what is no latency test", expected="none, or an earlier one, which is replaced",
            remedy="name another",
        )  # fmt: skip


def keep(path: Path, latency: Latency) -> None:
    """Keep the result.  Raises Refusal."""
    make_folder(path.parent)
    document = json.dumps(latency.document(), indent=1).encode()
    write_atomically(path, document, mode=0o644)  # agents of other users read root's, whatever its umask


def newest(paths: Sequence[Path]) -> Latency | None:
    """The last test that is kept and can be read."""
    found = []
    for path in paths:
        try:
            found.append(Latency.of(json.loads(path.read_bytes())))
        except (OSError, ValueError, RecursionError):
            continue
    return max(found, key=lambda latency: latency.utc_ns, default=None)


def finished(seconds: float, rate_hz: float, *, loaded: bool, real_time: RealTime, histogram: Histogram) -> Latency:
    """The result of a test on this host, now."""
    cores = len(os.sched_getaffinity(0))
    return Latency(time.time_ns(), os.uname().release, cores, seconds, rate_hz, loaded, real_time, histogram)
