"""The folder that the processes of a run share: gone with the run, and with a dead one when the next begins."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from agent.process import run_folder as module
from agent.process.run_folder import LOCK, run_folder
from agent.telemetry.ring.file import lock


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(module, "MEMORY", tmp_path)
    return tmp_path


def killed(memory: Path, *files: str) -> Path:
    """The folder of a run that was killed in the middle."""
    program = f"""
import os
from pathlib import Path
from agent.process import run_folder
run_folder.MEMORY = Path({str(memory)!r})
with run_folder.run_folder() as folder:
    for name in {files!r}:
        (folder / name).touch()
    print(folder, flush=True)
    os.kill(os.getpid(), 9)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == -9, done.stderr
    return Path(done.stdout.strip())


def test_it_is_there_for_the_run_alone_and_goes_with_all_that_is_in_it(memory: Path) -> None:
    with run_folder() as folder:
        assert folder.parent == memory
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "logs").mkdir()
        (folder / "left.ring").touch()
    assert list(memory.iterdir()) == []
    with pytest.raises(ZeroDivisionError), run_folder():
        _ = 1 / 0
    assert list(memory.iterdir()) == []


def test_what_a_killed_run_left_goes_when_the_next_begins(memory: Path) -> None:
    left = killed(memory, "left.ring", "cell.toml")
    assert {path.name for path in left.iterdir()} == {LOCK, "left.ring", "cell.toml"}
    with run_folder() as folder:
        assert list(memory.iterdir()) == [folder]


def test_a_run_that_goes_on_keeps_its_folder(memory: Path) -> None:
    with run_folder() as first:
        with run_folder() as second:
            assert sorted(memory.iterdir()) == sorted([first, second])
        assert list(memory.iterdir()) == [first]


def test_an_arm_that_still_holds_keeps_what_releases_it(memory: Path) -> None:
    left = killed(memory, "left.ring", "right.ring")
    agent = os.open(left / "right.ring", os.O_RDWR)
    assert lock(agent)
    with run_folder():
        assert (left / "left.ring").exists()
    os.close(agent)
    with run_folder():
        assert not left.exists()


def test_what_is_not_sure_to_be_a_dead_run_of_this_user_stays(memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = killed(memory)
    (memory / "coop-run-begins").mkdir()  # its lock has not got its name yet
    elsewhere = memory / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / LOCK).touch()
    (memory / "coop-run-link").symlink_to(elsewhere)
    (memory / "coop-run-file").touch()
    before = sorted(path for path in memory.rglob("*") if left not in (path, path.parent))
    with monkeypatch.context() as other:
        user = os.geteuid()
        other.setattr(os, "geteuid", lambda: user + 1)
        with run_folder():
            assert left.exists()
    with run_folder():
        assert not left.exists()
    assert sorted(memory.rglob("*")) == before
