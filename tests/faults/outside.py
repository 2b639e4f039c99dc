"""Runs the tests that are marked with rows, and says by row what became of them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from agent.study.work import cores

ROOT = Path(__file__).parents[2]
PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"


@dataclass(frozen=True)
class Outcome:
    """What became of a test, and in whose words it failed, with each parameter that did."""

    kind: str
    words: str = ""


def outcomes(nodes: Iterable[str]) -> dict[str, Outcome]:
    """What became of each test, all of its parameters together; those with a clock of their own run by themselves."""
    wanted = sorted(set(nodes))
    if not wanted:
        return {}
    found: dict[str, list[Outcome]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for mark, more in (("not realtime", ["-n", str(cores())]), ("realtime", [])):
            report = Path(folder) / f"{len(found)}.xml"
            command = [sys.executable, "-m", "pytest", "-q", "-m", mark, *more, f"--junitxml={report}", *wanted]
            subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
            if report.exists():
                read_report(report, found)
    return {node: merged(found.get(node, ())) for node in wanted}


def read_report(report: Path, found: dict[str, list[Outcome]]) -> None:
    """Add what a report of pytest says of each test."""
    for case in ElementTree.parse(report).iter("testcase"):
        full = case.get("name", "")
        name, _, parameter = full.partition("[")
        node = f"{case.get('classname', '').replace('.', '/')}.py::{name}"
        failures = [child for child in case if child.tag in ("failure", "error")]
        if failures:
            said = "\n".join(child.text or child.get("message") or "" for child in failures)
            found[node].append(Outcome(FAILED, f"[{parameter}\n{said}" if parameter else said))
        else:
            found[node].append(Outcome(PASSED if case.find("skipped") is None else SKIPPED))


def merged(every: Sequence[Outcome]) -> Outcome:
    """What became of a test with all its parameters."""
    kinds = {one.kind for one in every}
    if FAILED in kinds:
        return Outcome(FAILED, "\n".join(one.words for one in every if one.kind == FAILED))
    return Outcome(PASSED if PASSED in kinds else SKIPPED)


def of_row(nodes: Iterable[str], found: Mapping[str, Outcome]) -> tuple[list[str], bool]:
    """Failed tests of a row with their words, and whether any of them ran."""
    all_of_it = {node: found.get(node, Outcome(SKIPPED)) for node in nodes}
    failed = [f"{node} fails\n{one.words}".rstrip() for node, one in all_of_it.items() if one.kind == FAILED]
    return failed, any(one.kind != SKIPPED for one in all_of_it.values())
