"""How often a cell holds by itself when nothing has failed: shipped cells in realities within their tolerance.

`make false-trips` by itself.  FAULTS_S: simulated seconds (7200).  FAULTS_SEED: of the first reality (1).
FAULTS_TRIPS: a file that keeps each run as it is done; it is gone on with while neither cells nor sources have changed.

Trips of the arms' monitors count as those of noticing do.  Ends with 1 when anything tripped.
"""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import json
import math
import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import agent
import configs
import drivers
import sim_backend
from agent.config.cell import Cell, load_cell
from agent.config.reality import draw
from agent.study.lab import Laboratory
from agent.study.measure import measure
from agent.study.work import cores
from drivers.interface import Refusal

RUN_S: Final = 25.0  # of the trajectory, a motion of the paper and two thirds; the wait before it is watched too
EFFECTS: Final = ("friction", "position_quantisation", "velocity_quantisation", "torque_quantisation", "saturation")


@dataclass(frozen=True)
class Job:
    """One run: a cell, and the seed of its reality; None: as its file says."""

    cell: str
    seed: int | None


@dataclass(frozen=True)
class Done:
    """What a run brought."""

    job: Job
    why: str  # it tripped or was lost; empty without
    cpu_s: float


@dataclass(frozen=True)
class FalseTrips:
    """What so much simulated time brought."""

    simulated_s: float
    runs: int
    trips: tuple[str, ...]  # cell, seed and reason of each
    cpu_s: float = 0.0
    by_cell: dict[str, int] = field(default_factory=dict)  # runs

    @property
    def per_hour(self) -> float:
        """Trips per simulated hour."""
        return 3600.0 * len(self.trips) / self.simulated_s if self.simulated_s else 0.0

    def told(self) -> str:
        """In one line."""
        hours, of_2_h = self.simulated_s / 3600.0, self.cpu_s / max(self.simulated_s, 1e-9) * 7200.0
        return (
            f"false trips: {len(self.trips)} in {hours:.2f} h, {self.runs} runs in {len(self.by_cell)} cells: "
            f"{self.per_hour:.2g} an hour; {self.cpu_s:.0f} s of CPU ({of_2_h:.0f} s for 2 h)"
        )

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "id": "false trips",
            "verdict": "not tested" if not self.runs else "missed" if self.trips else "met",
            "detected_s": None,
            "reacted_s": None,
            "bound": "no hold without a fault",
            "simulated_s": round(self.simulated_s, 1),
            "runs": self.runs,
            "by_cell": self.by_cell,
            "cpu_s": round(self.cpu_s, 1),
            "per_hour": round(self.per_hour, 3),
            "missed": list(self.trips),
        }


def false_trips(simulated_s: float, seed: int, kept: Path | None = None) -> FalseTrips:
    """So much time of drawn realities on all cores; kept: where each run is kept as it is done, and taken from.

    Raises Refusal.
    """
    todo, known = jobs(simulated_s, seed), _known(kept)
    done = [known[job] for job in todo if job in known]
    for one in _carried_out([job for job in todo if job not in known]):
        done.append(one)
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"of": state(), **dataclasses.asdict(one)}) + "\n")
    return _together(done)


def jobs(simulated_s: float, seed: int) -> list[Job]:
    """Runs of the cells that notice in so much time of drawn realities, in turn, and once of each that does not."""
    names = [path.stem for path in _carrying()]
    noticing = [name for name in names if _cell(name).file.safety.noticing.enabled]
    count = math.ceil(simulated_s / RUN_S)
    drawn = [Job(noticing[i % len(noticing)], seed + i // len(noticing)) for i in range(count)]
    return drawn + [Job(name, None) for name in names if name not in noticing and count]


def _carried_out(todo: Sequence[Job]) -> Iterator[Done]:
    """As they are done; those of one cell go together, which its worker then has ready."""
    if not todo:
        return
    with ProcessPoolExecutor(cores(), mp_context=multiprocessing.get_context("spawn")) as pool:
        coming = [pool.submit(run, job) for job in todo]
        for one in as_completed(coming):
            yield one.result()


def run(job: Job) -> Done:
    """One run, watched by everything that watches an arm.  Raises Refusal."""
    gc.disable()  # nothing in a tick makes cycles
    before = _cpu_s()
    lab = _laboratory(job.cell)
    reality = None if job.seed is None else draw(lab.cell.file.tolerance, job.seed, lab.cell)
    found = measure(lab, reality, seed=job.seed or 0)
    gc.collect()
    return Done(job, found.why, _cpu_s() - before)


@cache
def _laboratory(name: str) -> Laboratory:
    return Laboratory(_cell(name))


def _cell(name: str) -> Cell:
    """The shipped cell; every effect of its servos on, where it notices anything."""
    short = [f"duration_s={RUN_S}"]
    cell = load_cell(Path(name), short)
    if not cell.file.safety.noticing.enabled:
        return cell
    return load_cell(Path(name), [*short, *(f"simulation.effects.{effect}=true" for effect in EFFECTS)])


def _carrying() -> list[Path]:
    """Shipped cells in which arms carry an object; those that identify an arm do not."""
    return [path for path in sorted(configs.CELLS_DIR.glob("*.toml")) if not path.stem.startswith("identify")]


@cache
def state() -> str:
    """Of the sources and shipped files: a run of others is not gone on with."""
    digest = hashlib.sha256(str(RUN_S).encode())
    for package in (agent, drivers, sim_backend, configs):
        root = Path(package.__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".toml", ".json", ".urdf")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _known(kept: Path | None) -> dict[Job, Done]:
    """Runs that the file has of this state; a line cut short is none."""
    known: dict[Job, Done] = {}
    for line in kept.read_text("utf-8").splitlines() if kept is not None and kept.exists() else []:
        try:
            one = json.loads(line)
        except ValueError:
            continue
        if one["of"] == state():
            job = Job(**one["job"])
            known[job] = Done(job, one["why"], one["cpu_s"])
    return known


def _together(done: Sequence[Done]) -> FalseTrips:
    by_cell: dict[str, int] = {}
    for one in done:
        by_cell[one.job.cell] = by_cell.get(one.job.cell, 0) + 1
    trips = sorted(f"{one.job.cell}, reality {one.job.seed}: {one.why}" for one in done if one.why)
    return FalseTrips(len(done) * RUN_S, len(done), tuple(trips), sum(one.cpu_s for one in done), by_cell)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Run, tell; 0 when nothing tripped."""
    begun_s, kept = time.monotonic(), os.environ.get("FAULTS_TRIPS")
    seconds, seed = float(os.environ.get("FAULTS_S", "7200")), int(os.environ.get("FAULTS_SEED", "1"))
    found = false_trips(seconds, seed, Path(kept) if kept else None)
    sys.stdout.write(f"{found.told()}, {time.monotonic() - begun_s:.0f} s\n")
    for name, count in sorted(found.by_cell.items()):
        sys.stdout.write(f"      {name}: {count} runs\n")
    for trip in found.trips:
        sys.stdout.write(f"      {trip}\n")
    return 1 if found.trips else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Refusal as refusal:
        sys.exit(str(refusal))
