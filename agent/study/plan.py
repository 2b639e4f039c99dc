"""What a study runs: of a cell alone, or as a study file says; as tasks that any process can do by themselves."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

import configs
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.files import cell_path
from agent.config.reading import parse, read_file, shipped_cells, shown, validate
from agent.config.schema.cell import CellFile
from agent.config.schema.fault import Fault
from agent.config.schema.types import Format, Seed, Strict, nearest
from agent.study.provenance import provenance

RUNS = 200
MAX_RUNS = 100_000

Runs = Annotated[int, Field(ge=1, le=MAX_RUNS)]


class Extent(Strict):
    """How much a study runs: in its file, or given with the command, which goes before."""

    runs: Runs = RUNS  # of each cell
    seed: Seed = 0
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None  # of a run; None: the cell's


class StudyFile(Extent):
    """A study of one or several cells."""

    format: Format
    cells: Annotated[list[str], Field(min_length=1, max_length=100)]  # files beside this one, or names of shipped cells
    set: list[str] = Field(default_factory=list)  # "key.path=value", as of --set, for every cell
    faults: list[Fault] = Field(default_factory=list)  # of every run


@dataclass(frozen=True)
class Task:
    """One run: everything a worker needs, by value."""

    cell_toml: bytes
    source: str
    cell: int  # place in the study
    index: int  # of the run, in its cell
    seed: int  # of its reality
    faults: tuple[Fault, ...]
    fingerprint: str  # of the cell with its arms' files, which a host has of its own
    provenance: Mapping[str, str]  # of who asks for it: nobody else's runs are put together with theirs

    @property
    def key(self) -> tuple[int, int]:
        """What tells the runs of a study apart."""
        return self.cell, self.index


@dataclass(frozen=True)
class Plan:
    """A whole study."""

    cells: tuple[Cell, ...]
    runs: int  # of each cell
    seed: int
    faults: tuple[Fault, ...]

    def tasks(self) -> list[Task]:
        """All runs, cell after cell."""
        ours = provenance()
        return [
            Task(
                cell.toml, f"{cell.file.name}.toml", place, index, seed_of(self.seed, index), self.faults,
                cell.fingerprint, ours,
            )
            for place, cell in enumerate(self.cells)
            for index in range(self.runs)
        ]  # fmt: skip

    def identity(self) -> dict[str, Any]:
        """What two studies share whose runs may be put together; the number of runs is not in it."""
        return {
            "cells": [cell.fingerprint for cell in self.cells],
            "seed": self.seed,
            "faults": [fault.model_dump(mode="json") for fault in self.faults],
            "versions": dict(provenance()),
        }


def seed_of(study_seed: int, index: int) -> int:
    """Seed of the reality of a run; the same for every cell, so that cells meet the same luck."""
    return int(np.random.SeedSequence((study_seed, index)).generate_state(1)[0])


def load_plan(
    path: Path,
    *,
    runs: int | None = None,
    seed: int | None = None,
    duration_s: float | None = None,
    overrides: Sequence[str] = (),
) -> Plan:
    """The study of this file, or of this cell alone within its own tolerance; what is given here goes before it.

    Raises ConfigError, and TrajectoryError for data that are not a motion.
    """
    found = _study_file(path)
    if found is None:
        file, cells = StudyFile(format=1, cells=[str(path)]), [path]
    else:
        file = found
        cells = [_beside(path, name) for name in file.cells]
    given = {"runs": runs, "seed": seed, "duration_s": duration_s}
    filed = file.model_dump(include=set(given))
    extent = validate(Extent, filed | {key: x for key, x in given.items() if x is not None}, "the command")
    lasting = [] if extent.duration_s is None else [f"duration_s={extent.duration_s!r}"]
    changes = [*file.set, *lasting, *overrides]
    plan = Plan(tuple(load_cell(cell, changes) for cell in cells), extent.runs, extent.seed, tuple(file.faults))
    _require_fit(plan)
    return plan


def last_seen_s(file: CellFile) -> float:
    """When a run sees its object for the last time, s of the trajectory; negative: before the start only."""
    ready = round(file.simulation.ready_s * file.rate_hz)
    last = ready + round(file.duration_s * file.rate_hz) - 1
    return (last - last % file.observe_every - ready) / file.rate_hz


def _study_file(path: Path) -> StudyFile | None:
    """The study in this file; None where it is a cell."""
    path = cell_path(path)
    document = parse(read_file(path), path)
    return validate(StudyFile, document, path.name) if "cells" in document else None


def _beside(study: Path, name: str) -> Path:
    """The cell file beside the study, or the shipped cell of this name: nothing that only the current folder has.

    Raises ConfigError.
    """
    here, shipped = study.parent / name, shipped_cells()
    with contextlib.suppress(OSError):  # a name that is too long for a file
        if here.is_file():
            return here
    if name in shipped:
        return configs.CELLS_DIR / f"{name}.toml"
    raise ConfigError(
        f"cells in {study.name}",
        found=f"{shown(name)}, no file in {study.parent}, and no cell of that name that ships",
        expected="a cell file beside the study, or one of " + ", ".join(shipped),
        remedy=nearest(name.removesuffix(".toml"), shipped) or "give its path from the study's folder",
    )


def _require_fit(plan: Plan) -> None:
    """Raise ConfigError where a run could not be judged, or a fault could not happen."""
    names = Counter(cell.file.name for cell in plan.cells)
    for cell in plan.cells:
        file = cell.file
        if names[file.name] > 1:
            raise ConfigError(
                f"cells of name {file.name}",
                found=f"{names[file.name]} in one study",
                expected="a name for each, which tells their results apart",
                remedy="give each its own `name`, or its own study",
            )
        last_s = (round(file.duration_s * file.rate_hz) - 1) * cell.period_ns * 1e-9
        own = [("simulation.fault", fault) for fault in file.simulation.fault]
        for table, fault in (*own, *(("faults", fault) for fault in plan.faults)):
            cell.index(fault.arm)
            if fault.at_s > last_s:
                raise ConfigError(
                    f"{table}: {fault.told}, in cell {file.name}",
                    found=f"{fault.at_s:g} s in runs of {file.duration_s:g} s, whose last cycle is at {last_s:g} s",
                    expected="a fault that happens during the run",
                    remedy="let it happen sooner, lengthen the runs, or leave it out",
                )
        if file.duration_s <= file.report.transient_s:
            raise ConfigError(
                f"duration_s of cell {file.name}",
                found=f"{file.duration_s:g} s with a transient of {file.report.transient_s:g} s",
                expected="a run that is longer than its transient, which counts in no error",
                remedy="lengthen the runs, or set report.transient_s lower",
            )
        seen_s = last_seen_s(file)
        if seen_s < file.report.transient_s:
            raise ConfigError(
                f"simulation.observe_rate_hz of cell {file.name}",
                found=f"{file.simulation.observe_rate_hz:g} Hz: the object is last seen at {seen_s:g} s",
                expected=f"to see it after the transient of {file.report.transient_s:g} s",
                remedy="lengthen the runs, or observe more often",
            )
        if file.simulation.reality is not None:
            raise ConfigError(
                f"simulation.reality of cell {file.name}",
                found="a reality in the cell",
                expected="none: the study draws one for each run",
                remedy="leave it out, or run the cell alone with `coop run`",
            )
