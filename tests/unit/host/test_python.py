"""A process of ours runs our code, whatever lies in the folder that it is started in."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import agent
from agent.config.schema.driver import DriverKind
from agent.guard import black_box
from agent.host import python
from agent.host.child import Child, ChildFailed
from agent.process.recorder import described
from agent.study import work
from tests.support.coop import PAPER


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with another `agent` and another module of Python, in which this process now is."""
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent/__init__.py").write_text("raise SystemExit('another checkout')")
    (tmp_path / "queue.py").write_text("raise SystemExit('no queue')")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_started_finds_what_this_process_found(elsewhere: Path) -> None:
    command = [*python.command("agent.process"), "nothing"]
    done = subprocess.run(command, env=python.surroundings(), capture_output=True, text=True)
    assert (done.returncode, done.stderr.splitlines()[-1][:30]) == (2, "coop: process: found nothing, ")
    assert python.command("a", "b") == [sys.executable, "-P", "-m", "a", "b"]
    assert str(Path(agent.__file__).parents[1]) in python.surroundings()["PYTHONPATH"].split(":")


def test_a_process_of_a_run_is_ours(elsewhere: Path) -> None:
    child = Child("plant", ["nothing"], elsewhere)
    with pytest.raises(ChildFailed, match=r"\(exit code 2\): process: found nothing"):
        child.wait_ready(60.0)
    child.kill()


def test_who_describes_a_run_is_ours(elsewhere: Path) -> None:
    assert b'"fingerprint"' in described(PAPER, DriverKind.SIM, 0)


def test_who_writes_a_post_mortem_and_who_carries_out_a_study_are_ours(elsewhere: Path) -> None:
    box = black_box.BlackBox([*"12345"], Path("4"), 1, wanted=True)
    told: list[str] = []
    box.finish(lambda: None, told.append)
    assert told == ["its writer ended with 2, see the guard's journal"]
    worker = work._start()
    assert worker.stdin is not None
    worker.stdin.close()
    assert worker.wait(60.0) == 0
    worker.stdout.close()  # type: ignore[union-attr]
