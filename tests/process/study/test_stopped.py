"""A study that is stopped or killed: what was finished is there, no process is left, the same command goes on."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import psutil
import pytest

from tests.support.command import coop
from tests.support.few import few
from tests.support.loaded import Loaded
from tests.support.study import cell_file


def under_way(folder: Path, runs: int) -> tuple[Loaded, Path]:
    """A study of many short runs, some of which are finished."""
    out = folder / "out"
    study = Loaded("study", cell_file(folder), "--runs", runs, "--workers", 2, "--out", out, cwd=folder)
    deadline = time.monotonic() + 60.0
    lines = 0
    while lines < 3:
        assert time.monotonic() < deadline
        assert study.poll() is None, study.communicate()
        time.sleep(0.05)
        lines = (out / "runs.jsonl").read_bytes().count(b"\n") if (out / "runs.jsonl").exists() else 0
    return study, out


@pytest.mark.parametrize("number", few((signal.SIGINT, signal.SIGTERM, signal.SIGKILL), signal.SIGKILL.__eq__))
def test_a_study_that_is_stopped_leaves_no_process_and_goes_on(tmp_path: Path, number: signal.Signals) -> None:
    study, out = under_way(tmp_path, 1000)
    workers = psutil.Process(study.pid).children()
    assert len(workers) == 2
    study.send_signal(number)
    _, errors = study.communicate(timeout=60.0)
    assert psutil.wait_procs(workers, timeout=10.0)[1] == []
    kept = (out / "runs.jsonl").read_bytes().count(b"\n") - 1
    assert kept >= 2
    if number is signal.SIGKILL:
        assert study.returncode == -number
    else:
        assert study.returncode == 130
        assert "Traceback" not in errors
        assert json.loads((out / "study.json").read_text())["runs"] == kept
    again = coop("study", tmp_path / "short.toml", "--runs", kept, "--workers", 1, "--out", out, "--json")
    assert again.code == 0, again.err
    document = json.loads(again.out)
    assert document["runs"] == document["wanted"] == kept


@pytest.mark.long  # tests/unit/study/test_study.py kills workers by their own processes
def test_a_worker_that_is_killed_is_replaced(tmp_path: Path) -> None:
    study, out = under_way(tmp_path, 12)
    psutil.Process(study.pid).children()[0].kill()
    said, errors = study.communicate(timeout=100.0)
    assert study.returncode == 0, errors
    assert "12 runs" in said
    assert json.loads((out / "study.json").read_text())["runs"] == 12
