"""Runs that several test files read and none changes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

from agent.log.read import RunLog, read_log
from tests.conftest import MADE_AGAIN
from tests.support import loaded
from tests.support.coop import coop
from tests.support.once import once
from tests.support.stalls import ATTEMPTS, Kernel, crowded, stalled_in

PAPER_RUN_S = 3
TRANSIENT_S = 1.0
WHOLE_S = 4.0
PAPER_RUN = ("paper", "--duration", PAPER_RUN_S, "--set", f"report.transient_s={TRANSIENT_S}")
SHORT = ("--duration", 1.5, "--set", "report.transient_s=0.5", "--no-report")  # of a run whose length says nothing
WAITING = (
    "paper", "--duration", 2, "--set", "simulation.ready_s=0.5", "--set", "controller.alignment.enabled=true",
    "--set", "report.transient_s=1", "--no-report",
)  # fmt: skip
# as quick as the emulated servos' motions are in tests/unit/test_whole.py; two seconds of the whole motion count
QUICK = (
    "session.speed_max_rad_per_s=2.0", "session.back_off_m=0.03", "session.lift_m=0.015", "session.lift_s=0.8",
    "session.lower_s=0.5", "session.take_up_s=0.3", "session.ease_s=0.3", "report.transient_s=2",
)  # fmt: skip
WHOLE_RUN = (
    "two_wx200", "--wire", "--whole", "--duration", WHOLE_S, "--no-report",
    *(word for setting in QUICK for word in ("--set", setting)),
)  # fmt: skip

HERE = Path(__file__).parent
RunOf = Callable[..., Path]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """A test beside others is made again when it fails on a machine without cores; what fails each time, fails.

    What was made again is told at the end (tests/conftest.py).  One that is `paced` is skipped in the end, but only on
    a machine where far more processes want each core than this test run has.  Those in real time judge for themselves;
    those without processes, of which pytest asks here too, know no machine.
    """
    if item.get_closest_marker("realtime") is not None or HERE not in item.path.parents:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in reversed(range(ATTEMPTS)):
        kernel = Kernel()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = [report for report in reports if report.failed and report.when != "teardown"]
        if not left and failed and item.get_closest_marker("paced") is not None and (why := crowded()):
            failed[0].outcome = "skipped"
            failed[0].longrepr = (str(item.path), 0, f"this machine stalled in each of {ATTEMPTS} runs: {why}")
        if not (left and failed and (why := kernel.accuses())):
            break
        item.user_properties.append((MADE_AGAIN, f"{failed[0].longreprtext.splitlines()[-1]}; {why}"))
        _forget_fixtures(item)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _forget_fixtures(item: pytest.Item) -> None:
    """Those of the test itself, and of others that failed, are made once more."""
    item._initrequest()  # type: ignore[attr-defined]
    for of_name in item._fixtureinfo.name2fixturedefs.values():  # type: ignore[attr-defined]
        for fixture in of_name:
            if fixture.cached_result is not None and fixture.cached_result[2] is not None:
                fixture.finish(item._request)  # type: ignore[attr-defined]


@pytest.fixture(scope="session")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> RunOf:
    """The folder of `coop run` with these words; whoever asks for the same words gets the same run."""

    def folder_of(*words: str | float) -> Path:
        def make(folder: Path) -> None:
            attempts = ATTEMPTS if {"--wire", "--real-time"} & set(words) else 1
            stalls: list[str] = []
            for attempt in range(attempts):  # a machine that stalls may end a run in real time; a defect ends all
                kernel = Kernel()
                done = loaded.coop("run", *words, "--out", "out", *(("--force",) if attempt else ()), cwd=folder)
                if done.returncode == 0:
                    return
                stalls.append((stalled_in(folder / "out" / "run.mcap") or kernel.accuses()) if attempts > 1 else "")
            if all(stalls):
                pytest.skip(f"this machine stalled in each of {attempts} runs, which ended for it: {', '.join(stalls)}")
            pytest.fail(done.stderr)

        name = hashlib.sha256(repr(tuple(map(str, words))).encode()).hexdigest()[:16]
        return once(tmp_path_factory, f"run-{name}", make) / "out"

    return folder_of


@pytest.fixture(scope="session")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of the paper's cell in `out`, over an earlier one; `said.json`: its code, output, errors."""

    def make(folder: Path) -> None:
        (folder / "out").mkdir()
        (folder / "out" / "run.mcap").write_text("an earlier run")
        (folder / "out" / "notes.txt").write_text("mine")
        done = coop("run", *PAPER_RUN, "--out", "out", "--force", "--json", "--strict", cwd=folder)
        assert done.returncode == 0, done.stderr
        (folder / "said.json").write_text(json.dumps([done.returncode, done.stdout, done.stderr]))

    return once(tmp_path_factory, "first-run", make)


@pytest.fixture(scope="session")
def paper_runs(first_run: Path, run_of: RunOf) -> tuple[Path, Path]:
    """Folders of two runs of the paper's cell, `PAPER_RUN_S` long, the first with its report."""
    return first_run / "out", run_of(*PAPER_RUN, "--no-report")


@pytest.fixture(scope="session")
def whole_run(run_of: RunOf) -> tuple[Path, RunLog]:
    """Folder and log of two arms from rest to rest: the real driver on emulated servos, in real time."""
    out = run_of(*WHOLE_RUN)
    return out, read_log(out / "run.mcap")
