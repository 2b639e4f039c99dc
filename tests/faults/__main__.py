"""`make faults`: every row of the list of faults, on virtual time where it can be, and how often nothing trips.

FAULTS_S: simulated seconds of the false-trip rate (default 7200; 0: none); FAULTS_TRIPS: see tests.faults.false_trips.
FAULTS_PAIRS: pairs of faults at once (20).
FAULTS_SEED: of pairs and realities (1).  FAULTS_ONLY: take the rows whose id begins with one of these texts (A,B,…).
FAULTS_TESTS=no: leave out the tests that are marked with rows.  FAULTS_OUT: a file for all of it as JSON.

Ends with 1 when a row is missed.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from textwrap import indent
from typing import Any, Final

from agent.atomic import write_atomically
from agent.faults.catalogue import Row, rows
from agent.faults.judge import Judged, RowResult, show
from agent.study.work import cores
from drivers.interface import Refusal
from tests.faults.false_trips import false_trips
from tests.faults.outside import Outcome, of_row, outcomes
from tests.faults.together import Pair, pair

TOGETHER: Final = "X1"


def main() -> int:
    """Run all; 0 when nothing is missed."""
    only = tuple(filter(None, os.environ.get("FAULTS_ONLY", "").upper().split(",")))
    seed = int(os.environ.get("FAULTS_SEED", "1"))
    chosen = [row for row in rows() if not only or row.id.startswith(only)]
    say(f"{'id':5}{'verdict':12}{'noticed':>9}{'reacted':>9}{'internal':>10}{'sag':>9}  bound, and what is missed")
    documents = run_rows([row for row in chosen if row.id != TOGETHER])
    if any(row.id == TOGETHER for row in chosen):
        pairs = int(os.environ.get("FAULTS_PAIRS", "20"))
        documents.append(together(next(row for row in chosen if row.id == TOGETHER), range(seed, seed + pairs)))
        tell(documents[-1])
    if not only:
        kept = os.environ.get("FAULTS_TRIPS")
        found = false_trips(float(os.environ.get("FAULTS_S", "7200")), seed, Path(kept) if kept else None)
        documents.append(found.document())
        say(found.told())
        for trip in found.trips:
            say(f"      {trip}")
    counted = {v.value: sum(d["verdict"] == v.value for d in documents) for v in RowResult}
    say(", ".join(f"{count} {name}" for name, count in counted.items()))
    if out := os.environ.get("FAULTS_OUT"):
        write_atomically(Path(out), json.dumps(documents, indent=1, allow_nan=False).encode() + b"\n")
    return 1 if counted[RowResult.MISSED.value] else 0


def run_rows(chosen: Sequence[Row]) -> list[dict[str, Any]]:
    """Each row by its runs and by its tests; told as they are done."""
    tested: Mapping[str, Outcome] = {}
    if os.environ.get("FAULTS_TESTS", "") != "no":
        tested = outcomes(node for row in chosen for node in row.tests)
    documents = []
    with ProcessPoolExecutor(cores(), mp_context=multiprocessing.get_context("spawn")) as pool:
        coming = {row.id: [pool.submit(show, shown) for shown in row.runs] for row in chosen}
        for row in chosen:
            documents.append(judged(row, [one.result() for one in coming[row.id]], tested))
            tell(documents[-1])
    return documents


def judged(row: Row, shown: Sequence[Judged], tested: Mapping[str, Outcome]) -> dict[str, Any]:
    """One row as JSON has it: worst of its runs, and its tests."""
    failed, ran = of_row(row.tests, tested)
    missed = [f"{each.shown.cell}: {text}" for each in shown for text in each.missed] + failed
    verdict = RowResult.MISSED if missed else RowResult.MET if shown or ran else RowResult.NOT_TESTED
    return {
        "id": row.id,
        "verdict": verdict.value,
        "detected_s": worst([each.measured.noticed_s for each in shown if must_notice(each)]),
        "reacted_s": worst([reaction(each) for each in shown if each.shown.within.reacted_s is not None]),
        "bound": row.bounds,
        "internal_force_N": worst([each.measured.internal_N for each in shown]),
        "sag_m": worst([each.measured.sag_m for each in shown]),
        "missed": missed,
        "why_not": row.untested or "its tests were left out or skipped" if verdict is RowResult.NOT_TESTED else None,
        "tests": {node: tested[node].kind if node in tested else "left out" for node in row.tests},
        "runs": [each.document() for each in shown],
    }


def must_notice(one: Judged) -> bool:
    """Whether it counts when somebody noticed: where a bound asks for it, or where somebody did and may."""
    within = one.shown.within
    return within.noticed_s is not None or (one.measured.noticed_s is not None and not within.goes_on)


def reaction(one: Judged) -> float | None:
    """Until the last arm that must has left the motion."""
    found, who = one.measured, one.shown.within.who
    times = [found.stopped_s[arm] for arm in who] if who else [found.reacted_s]
    return None if None in times else max(t for t in times if t is not None)


def together(row: Row, seeds: Sequence[int]) -> dict[str, Any]:
    """Pairs of faults as one row."""
    with ProcessPoolExecutor(cores(), mp_context=multiprocessing.get_context("spawn")) as pool:
        pairs: list[Pair] = list(pool.map(pair, seeds))
    missed = [f"seed {one.seed}, {one.cell}: {text}" for one in pairs for text in one.missed]
    verdict = RowResult.NOT_TESTED if not pairs else RowResult.MISSED if missed else RowResult.MET
    return {
        "id": row.id,
        "verdict": verdict.value,
        "detected_s": worst([one.found.noticed_s for one in pairs]),
        "reacted_s": None,
        "bound": row.bounds,
        "internal_force_N": worst([one.found.internal_N for one in pairs]),
        "sag_m": worst([one.found.sag_m for one in pairs]),
        "missed": missed,
        "pairs": [one.document() for one in pairs],
    }


def worst(values: Sequence[float | None]) -> float | None:
    """The largest; None where there is none, or where one of them never came."""
    return None if not values or None in values else round(max(v for v in values if v is not None), 5)


def tell(document: Mapping[str, Any]) -> None:
    """One row for a person."""
    noticed, reacted, force, sag = (document[k] for k in ("detected_s", "reacted_s", "internal_force_N", "sag_m"))
    say(
        f"{document['id']:5}{document['verdict']:12}{_shown(noticed, 1e3, 'ms'):>9}{_shown(reacted, 1e3, 'ms'):>9}"
        f"{_shown(force, 1.0, 'N'):>10}{_shown(sag, 1e3, 'mm'):>9}  {document['bound']}"
    )
    for text in document["missed"] or ([document["why_not"]] if document.get("why_not") else []):
        say(indent(text, " " * 6))


def _shown(value: float | None, times: float, unit: str) -> str:
    return "-" if value is None else f"{times * value:.3g} {unit}"


def say(text: str) -> None:
    """A line, at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Refusal as refusal:
        sys.exit(str(refusal))
