"""`make mutate`: every change to the modules of `targets.py` must fail a test; prints survivors and exits with 1.

MUTATE_ONLY=TEXT takes the modules whose name holds TEXT; MUTATE_DONE=FILE goes on where a run with it stopped.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.mutate.done import Done
from tests.mutate.equivalent import unused_entries, why_equivalent
from tests.mutate.forks import Job, Tell, run_all
from tests.mutate.fresh import run_fresh
from tests.mutate.mutants import Mutant, generated, written
from tests.mutate.session import Noticing, noticed_by
from tests.mutate.targets import TARGETS, Target

ROOT = Path(__file__).parents[2]
MODULE_S, FRESH_S = 7200.0, 300.0
HEAVY = ("numpy", "scipy.linalg", "pinocchio", "pydantic", "mcap.writer", "rich")  # imported once for all
OPTIONS = ("-p", "no:cacheprovider", "-p", "no:faulthandler", "-q", "--no-header", "--tb=native", "--assert=plain")


@dataclass
class Found:
    """What became of the changes to one module; by place in `mutants`."""

    done: Done
    mutants: list[Mutant] = field(default_factory=list)
    tests: dict[int, str] = field(default_factory=dict)  # that failed; "": none did
    fresh: list[int] = field(default_factory=list)
    problem: str = ""


def main() -> int:
    """Run all; 0 when nothing survives."""
    os.environ |= {"HYPOTHESIS_PROFILE": "mutate", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    only = os.environ.get("MUTATE_ONLY", "")
    targets = [target for target in TARGETS if only in target.module]
    if not targets:
        _say(f"no module holds {only!r}")
        return 2
    for name in HEAVY:
        import_module(name)
    done = Done(Path(file) if (file := os.environ.get("MUTATE_DONE")) else None)
    begin_s, count, equivalent, survivors, problems = time.monotonic(), 0, 0, [], []
    for target in targets:
        found = _examined(target, done)
        survivors += [found.mutants[i] for i, test in found.tests.items() if not test]
        problems += [
            f"{target.module}: {text}"
            for text in (found.problem, *unused_entries(target.module, found.mutants))
            if text
        ]
        count += len(found.tests)
        equivalent += sum(bool(why_equivalent(mutant)) for mutant in found.mutants)
    for mutant in survivors:
        _say(f"SURVIVED  {mutant.text}")
    for problem in problems:
        _say(f"PROBLEM   {problem}")
    _say(
        f"{count} changes: {count - len(survivors)} noticed, {len(survivors)} survived; {equivalent} more are "
        f"equivalent; {time.monotonic() - begin_s:.0f} s"
    )
    return 1 if survivors or problems else 0


def _examined(target: Target, done: Done) -> Found:
    """All changes to a module: in the running code where that can be, else by a fresh import."""
    begin_s = time.monotonic()
    found = Found(done)
    run_all([Job(lambda tell: tell(("mutants", _mutants(target))), 60.0, hear=lambda word: _hear(found, *word))], 1)
    wanted = [i for i, mutant in enumerate(found.mutants) if not why_equivalent(mutant)]
    found.tests = {i: test for i in wanted if (test := done.noticed_by(found.mutants[i]))}
    kept = len(found.tests)
    arguments = [*OPTIONS, *(str(ROOT / test) for test in target.tests)]

    def in_session(tell: Tell) -> None:
        plugin = Noticing(
            target.module, found.mutants, [i for i in wanted if i not in found.tests], _at_once(), tell, target.warm
        )
        pytest.main(arguments, plugins=[plugin])

    if kept < len(wanted):
        run_all([Job(in_session, MODULE_S, hear=lambda word: _hear(found, *word))], 1)
    run_all((_fresh_job(found, i, arguments) for i in ([] if found.problem else found.fresh)), _at_once())
    missing = set(wanted) - set(found.tests)
    if missing and not found.problem:
        found.problem = f"{len(missing)} changes without a verdict"
    survived = sum(not test for test in found.tests.values())
    equivalent = len(found.mutants) - len(wanted)
    _say(
        f"{target.module}: {len(found.tests)} changes, {survived} survived, {equivalent} equivalent, "
        f"{kept} from an earlier run, {time.monotonic() - begin_s:.0f} s"
    )  # fmt: skip
    return found


def _mutants(target: Target) -> list[Mutant]:
    return [*written(target.module), *(generated(target.module) if target.generate else [])]


def _fresh_job(found: Found, i: int, arguments: Sequence[str]) -> Job:
    return Job(
        lambda tell: run_fresh(found.mutants[i], arguments, tell),
        FRESH_S,
        lambda said: _take(found, i, noticed_by(said)),
    )


def _hear(found: Found, kind: str, *content: Any) -> None:
    match kind:
        case "mutants":
            (found.mutants,) = content
        case "verdict":
            _take(found, *content)
        case "fresh":
            found.fresh += content
        case "problem" | "crashed":
            (found.problem,) = content


def _take(found: Found, i: int, test: str) -> None:
    found.tests[i] = test
    found.done.keep(found.mutants[i], test)
    _say(f"{'noticed' if test else 'SURVIVED'}  {found.mutants[i].text}  |  {test}")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _at_once() -> int:
    return 2 * len(os.sched_getaffinity(0))  # some tests wait


if __name__ == "__main__":
    sys.exit(main())
