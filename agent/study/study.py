"""`coop study`: runs what is missing of a study, keeps every finished run, and writes what all of them say."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Protocol

import tomli_w

from agent.atomic import keep_existing, write_atomically
from agent.config.cell import Cell
from agent.config.reading import parse
from agent.config.reality import draw
from agent.config.schema.fault import Fault
from agent.study.lab import faults_of
from agent.study.measure import RunResult
from agent.study.page import render
from agent.study.plan import Plan, Task
from agent.study.store import Store, has_begun
from agent.study.summary import errors_of, influences, judged, summary, worst
from agent.verify.check import examine

SCHEMA: Final = 2  # of study.json; grows when a key changes its meaning
STUDY, TABLE, PARQUET, PAGE, WORST = "study.json", "runs.csv", "runs.parquet", "report.html", "worst.toml"
RESULTS: Final = (STUDY, TABLE, PARQUET, PAGE, WORST)

Work = Callable[[Sequence[Task]], Iterator[tuple[Task, RunResult]]]


class Progress(Protocol):
    """Who is told how far a study is."""

    def begin(self, done: int, total: int) -> None:
        """Runs are about to be done; `done` were there before."""
        ...

    def advance(self, result: RunResult) -> None:
        """One more run is finished."""
        ...


@dataclass(frozen=True)
class StudyOutcome:
    """What a study left behind."""

    folder: Path
    document: Mapping[str, Any]  # study.json
    interrupted: bool


def run_study(
    plan: Plan, out: Path, work: Work, stop: Callable[[], bool], progress: Progress, *, anew: bool = False
) -> StudyOutcome:
    """Do the runs of the plan that `out` does not hold yet, and write its results; a stop keeps what is finished.

    `anew` gives up what `out` holds, once it is known that the cells may run.

    Raises Refusal: a cell that must not run, a folder that cannot be written or that another study writes, a run that
    cannot be done.
    """
    for cell in plan.cells:
        examine(cell).require()
    tasks = plan.tasks()
    if not anew and not has_begun(out):  # then what lies there is no study's
        keep_existing(*(out / name for name in RESULTS), remedy="name another --out, or give --force")
    with Store(out, plan, anew=anew) as store:
        if anew:
            for name in RESULTS:
                (out / name).unlink(missing_ok=True)
        todo = [task for task in tasks if task.key not in store.results]
        progress.begin(len(tasks) - len(todo), len(tasks))
        for task, result in work(todo) if todo else ():
            store.add(task, result)
            progress.advance(result)
            if stop():
                break
        results = [[store.results[t.key] for t in tasks if t.cell == i and t.key in store.results]
                   for i in range(len(plan.cells))]  # fmt: skip
        document = _write(plan, out, results)
    return StudyOutcome(out, document, interrupted=sum(map(len, results)) < len(tasks))


def _write(plan: Plan, out: Path, results: Sequence[Sequence[RunResult]]) -> dict[str, Any]:
    """Every file of the results, and the content of study.json.  Raises WriteError."""
    together = [r for some in results for r in some]
    parts = [
        (cell, some, found | judged(cell, found), influences(cell, some))
        for cell, some in zip(plan.cells, results, strict=True)
        if some and (found := summary(some))
    ]
    document = {
        "schema": SCHEMA,
        "versions": plan.identity()["versions"],
        "seed": plan.seed,
        "wanted": plan.runs * len(plan.cells),
        **summary(together),
        "holds": bool(parts) and all(found["holds"] for _, _, found, _ in parts),
        "cells": {
            cell.file.name: {
                "fingerprint": cell.fingerprint,
                "duration_s": cell.file.duration_s,
                **found,
                "influences": [asdict(i) for i in ranked],
                "worst": worst(some).index,
            }
            for cell, some, found, ranked in parts
        },
    }
    write_atomically(out / STUDY, json.dumps(document, indent=2, allow_nan=False).encode() + b"\n")
    if together:
        rows = [_row(cell, result) for cell, some, _, _ in parts for result in some]
        write_atomically(out / TABLE, _csv(rows))
        if find_spec("pyarrow") is not None:
            write_atomically(out / PARQUET, _parquet(rows))
        names = ", ".join(cell.file.name for cell, *_ in parts)
        write_atomically(out / PAGE, render(f"Study of {names}", parts, plan.faults).encode())
        bad = worst(together)
        at = next(i for i, some in enumerate(results) if any(r is bad for r in some))
        write_atomically(out / WORST, worst_cell(plan.cells[at], bad, plan.faults))
    return document


def _row(cell: Cell, result: RunResult) -> dict[str, Any]:
    """One run with the sizes of its reality's errors."""
    errors = errors_of(draw(cell.file.tolerance, result.seed, cell), cell)
    return asdict(result) | {f"error_{key}": value for key, value in errors.items()}


def _csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(rows: Sequence[Mapping[str, Any]]) -> bytes:
    arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    numbers = {f.name for f in fields(RunResult) if f.type == "float | None"}
    columns = {
        key: arrow.array([row[key] for row in rows], type=arrow.float64() if key in numbers else None)
        for key in rows[0]
    }
    sink = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(columns), sink)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def worst_cell(cell: Cell, result: RunResult, faults: Sequence[Fault] = ()) -> bytes:
    """A cell file that repeats one run of a study: the cell with that run's reality, value by value.

    faults: the study's, which befall its arms beside the cell's own.
    """
    document = parse(cell.toml, Path(f"{cell.file.name}.toml"))
    real, simulation = draw(cell.file.tolerance, result.seed, cell), document.setdefault("simulation", {})
    simulation["reality"] = real.model_dump(mode="json", exclude_none=True)
    if every := faults_of(cell, faults):
        simulation["fault"] = [fault.model_dump(mode="json") for fault in every]
    head = f"# Run {result.index} of a study: the reality of seed {result.seed}. {result.why}\n"
    return head.encode() + tomli_w.dumps(document).encode()
