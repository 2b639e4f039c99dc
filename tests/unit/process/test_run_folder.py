"""The folder that the processes of a run share: gone with the run, and with a dead one when the next begins."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.process import run_folder as module
from agent.process.run_folder import LOCK, rings_bytes, run_folder
from agent.telemetry.ring.file import lock
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT


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


def test_where_memory_has_no_room_the_folder_is_among_temporary_files_and_somebody_is_told(
    memory: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary, told = tmp_path_factory.mktemp("temporary"), list[str]()
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(temporary))
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: SimpleNamespace(free=64 << 20))
    with run_folder(64 << 20, told.append) as enough, run_folder(None, told.append) as paced:
        assert (enough.parent, paced.parent, told) == (memory, memory, [])
    with run_folder((64 << 20) + 1, told.append) as elsewhere:
        assert elsewhere.parent == temporary
    assert told == [f"{memory} has 64 MB free, this run wants 65: it uses {temporary} instead"]
    assert list(temporary.iterdir()) == []


def test_what_a_killed_run_left_among_temporary_files_goes_too(
    memory: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = killed(tmp_path_factory.mktemp("temporary"), "left.ring")
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(left.parent))
    with run_folder():
        assert not left.exists()


def test_the_rings_of_a_run_take_as_much_as_is_asked_for(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "plant.ring", PLANT_STATE, PLANT):
        for arm in ("left", "right"):
            TextWriter(tmp_path / f"{arm}.ring", arm).close()
            with RingWriter(tmp_path / f"{arm}.ring", AGENT_STATE, arm):
                pass
    rings = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert rings_bytes(2) == rings > 64 << 20, "more than a container has"


def test_what_a_killed_run_left_goes_goes_when_the_next_begins(memory: Path) -> None:
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
