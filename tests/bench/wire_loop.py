"""The control loop of the real driver on an emulated bus with its timing, plant and all on this machine.

Late cycles are printed beside those of an empty loop at the same rate in the same run: the difference is ours, the
rest is the machine's.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import configs
from agent.log.read import read_log
from drivers.clock import MonotonicClock
from tests.bench.common import Figure

CASES = {
    # name: cell, arm that is looked at, rate, overrides
    "wire_200hz_7": ("two_wx200", "left", 200, ()),
    "wire_400hz_9": (
        "two_models", "right", 400,
        ("rate_hz=400", "arms.left.dynamixel.baud=3000000", "arms.right.dynamixel.baud=3000000"),
    ),
}  # fmt: skip
PARTS = ("read", "step", "write")
SPLIT = tuple(f"{part}_{q}" for part in PARTS for q in ("p50", "p99", "max"))
NAMES = tuple(f"{case}_{x}" for case in CASES for x in ("late_per_1000", "no_reply_per_1000", "cpu", *SPLIT))
SECONDS = 10
LATE_S = 1e-3


def bench() -> dict[str, Figure]:
    """Per case: late cycles, cycles without a reply, share of a core of the agent, and where a cycle's time goes."""
    figures: dict[str, Figure] = {}
    for case, (cell, arm, rate_hz, overrides) in CASES.items():
        empty = empty_loop(rate_hz)
        with tempfile.TemporaryDirectory() as folder:
            rows, cpu = one_run(cell, arm, overrides, Path(folder))
        figures |= {f"{case}_{name}": figure for name, figure in split(rows, cpu, empty).items()}
    return figures


def split(rows: Any, cpu: float, empty_per_1000: float) -> dict[str, Figure]:
    """Figures of one run."""
    lost = np.isnan(rows["q"][:, 0])
    late = 1e3 * float((rows["late_s"] > LATE_S).mean())
    figures = {
        "late_per_1000": Figure(late, "1", baseline=empty_per_1000 or None),
        "no_reply_per_1000": Figure(1e3 * float(lost.mean()), "1"),
        "cpu": Figure(100 * cpu, "%"),
    }
    for part in PARTS:
        values = 1e6 * rows[f"{part}_s"][~lost]
        for name, value in (("p50", np.median(values)), ("p99", np.quantile(values, 0.99)), ("max", values.max())):
            figures[f"{part}_{name}"] = Figure(float(value), "µs")
    return figures


def one_run(cell: str, arm: str, overrides: tuple[str, ...], folder: Path) -> tuple[Any, float]:
    """Rows of `arm` while it tracks, and its share of a core."""
    settings = [word for text in overrides for word in ("--set", text)]
    out = folder / "out"
    subprocess.run(
        [sys.executable, "-m", "agent.cli", "run", str(configs.CELLS_DIR / f"{cell}.toml"), "--wire",
         "--duration", str(SECONDS), "--out", str(out), *settings],
        check=True, capture_output=True,
    )  # fmt: skip
    log = read_log(out / "run.mcap")
    end = next(e for e in reversed(log.events) if e.source == arm and "cpu_s" in e.data)
    rows = log.agents[arm]
    elapsed_s = float(rows["stamp_ns"][-1] - rows["stamp_ns"][0]) * 1e-9
    return rows[rows["t"] >= 0.0], float(end.data["cpu_s"]) / elapsed_s


def empty_loop(rate_hz: int) -> float:
    """Late cycles per 1000 of a loop that does nothing."""
    clock, period_ns = MonotonicClock(), round(1e9 / rate_hz)
    begin_ns, late, count = time.monotonic_ns(), 0, SECONDS * rate_hz // 2
    for tick in range(count):
        deadline_ns = begin_ns + tick * period_ns
        clock.sleep_until(deadline_ns)
        late += clock.now_ns() - deadline_ns > LATE_S * 1e9
    return 1e3 * late / count
