"""Runs the tests that are marked with rows, and says by row what became of them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree

from agent.study.work import cores

ROOT = Path(__file__).parents[2]
PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"


def outcomes(nodes: Iterable[str]) -> dict[str, str]:
    """What became of each test, all of its parameters together; those with a clock of their own run by themselves."""
    wanted = sorted(set(nodes))
    if not wanted:
        return {}
    found: dict[str, set[str]] = defaultdict(set)
    with tempfile.TemporaryDirectory() as folder:
        for mark, more in (("not realtime", ["-n", str(cores())]), ("realtime", [])):
            report = Path(folder) / f"{len(found)}.xml"
            command = [sys.executable, "-m", "pytest", "-q", "-m", mark, *more, f"--junitxml={report}", *wanted]
            subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
            if report.exists():
                read_report(report, found)
    return {node: _together(found.get(node, set())) for node in wanted}


def read_report(report: Path, found: dict[str, set[str]]) -> None:
    """Add what a report of pytest says of each test."""
    for case in ElementTree.parse(report).iter("testcase"):
        name = case.get("name", "").partition("[")[0]
        node = f"{case.get('classname', '').replace('.', '/')}.py::{name}"
        kinds = {child.tag for child in case}
        found[node].add(FAILED if kinds & {"failure", "error"} else SKIPPED if "skipped" in kinds else PASSED)


def _together(kinds: set[str]) -> str:
    if FAILED in kinds:
        return FAILED
    return PASSED if PASSED in kinds else SKIPPED


def of_row(nodes: Iterable[str], found: Mapping[str, str]) -> tuple[list[str], bool]:
    """Failed tests of a row, and whether any of them ran."""
    kinds = {node: found.get(node, SKIPPED) for node in nodes}
    return [node for node, kind in kinds.items() if kind == FAILED], any(kind != SKIPPED for kind in kinds.values())
