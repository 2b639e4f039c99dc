"""`coop faults inject` of telemetry and recorder: what it refuses, what it says, and its exit code.

With real processes: tests/process/run/test_listeners.py.
"""

from __future__ import annotations

import json
import resource
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.faults.heard import undisturbed
from agent.faults.listeners import Rehearsed
from agent.faults.plan import Injection
from agent.host.child import ChildFailed
from agent.process.run_folder import LOCK
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.command import coop
from tests.support.few import few
from tests.support.pages import told

SHORT = ("--at", "0.05", "--duration", "0.1")


def rows(tau: NDArray[np.float64]) -> NDArray[np.void]:
    found = np.zeros(len(tau), AGENT_STATE.dtype)
    found["tau_limited"][:, : tau.shape[1]] = tau
    found["sequence"], found["t"] = np.arange(len(tau)), 0.005 * np.arange(len(tau))
    return found


class Processes:
    """In the place of processes: rows of the undisturbed run, one of which may be altered, and one log."""

    def __init__(self) -> None:
        self.altered: int | None = None
        self.faults: tuple[Injection, ...] = ()
        self.seed = 0
        self.folder = Path()
        self.fails = False
        self.size_max: int | None = None  # of files written from the log's end on

    def __call__(self, cell: Cell, faults: Sequence[Injection], seed: int, log: Path, progress: Any) -> Rehearsed:
        progress.phase("running")
        self.faults, self.seed, self.folder = tuple(faults), seed, log.parent
        log.write_bytes(b"of the recorder")
        if self.fails:
            raise ChildFailed("recorder", found="nothing", expected="more", remedy=f"its log is {log}")
        if self.size_max is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.size_max, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        own = {arm: rows(tau) for arm, tau in undisturbed(cell).items()}
        if self.altered is not None:
            own["right"]["tau_limited"][self.altered, 0] += 0.5
        named = tuple(fault.model_copy(update={"arm": fault.arm or "left"}) for fault in faults)
        return Rehearsed(cell, named, own, (log,), 7)


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Processes:
    found = Processes()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path_factory.mktemp("temporary")))
    monkeypatch.setattr("agent.faults.listeners.rehearse_listeners", found)
    return found


def test_it_says_each_fault_each_torque_and_what_the_log_lacks(processes: Processes, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    done = coop("faults", "inject", "paper", "telemetry-wrong", "--arm", "right", *SHORT, "--seed", 3, "--out", log)
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert lines[0].startswith("fault             telemetry-wrong, arm right, at 0.05 s: a stranger sends")
    assert lines[1] == "torque left       the same to the bit of 20 rows, against the undisturbed run"
    assert "rows left         0 of 20 in the log, 20 missing" in lines
    assert "log says          incomplete" in lines
    assert "strange messages  7 sent" in lines
    assert lines[-1] == f"log               {log}"
    assert log.read_bytes() == b"of the recorder"
    assert processes.seed == 3
    assert not processes.folder.exists()
    again = coop("faults", "inject", "paper", "telemetry-wrong", *SHORT, "--out", log)
    assert again.code == 2
    assert "name another with --out" in again.err


def test_a_torque_that_differs_is_said_with_its_place_and_ends_with_1(processes: Processes) -> None:
    processes.altered = 13
    done = coop("faults", "inject", "paper", "recorder-off", *SHORT)
    assert done.code == 1
    assert done.out.splitlines()[0].startswith("fault             recorder-off, at 0.05 s: its process is killed")
    assert "torque left       the same to the bit" in done.out
    assert "torque right      DIFFERS from row 13, t = 0.065 s on of 20 rows" in done.out
    done = coop("faults", "inject", "paper", "recorder-off", *SHORT, "--json")
    assert done.code == 1
    document = json.loads(done.out)
    assert document["verdict"] == "missed"
    assert document["torque"]["right"] == {
        "rows": 20, "same": False, "differs_at_row": 13, "differs_at_s": pytest.approx(0.065),
    }  # fmt: skip
    assert document["faults"][0]["fault"] == "recorder-off"
    assert set(document) <= told("commands.md")
    for part in ("torque", "rows"):
        assert set(document[part]["left"]) <= told("commands.md")


def test_a_process_that_fails_leaves_the_words_that_its_error_names(processes: Processes) -> None:
    processes.fails = True
    done = coop("faults", "inject", "paper", "recorder-off", *SHORT)
    assert done.code == ChildFailed.exit_code
    assert str(processes.folder) in done.err
    assert (processes.folder / "run.mcap").is_file()


@pytest.mark.parametrize("row", few(("p10", "N1", "n2"), "p10".__eq__))
def test_a_row_of_processes_is_carried_out_by_its_id(row: str, processes: Processes) -> None:
    done = coop("faults", "inject", "paper", row, "--duration", "3.2")
    assert done.code == 0, done.err
    (fault,) = processes.faults
    assert fault.fault == {"p10": "telemetry-off", "N1": "recorder-off", "n2": "recorder-stuck"}[row]


def test_what_makes_no_sense_is_refused_before_anything_starts(tmp_path: Path) -> None:
    for words, said in (
        (("telemetry-garbage", "--for", "1"), "one burst"),
        (("recorder-off", "--arm", "left"), "leave --arm out"),
        (("telemetry-off", "--servo", "4"), "leave --servo out"),
        (("telemetry-off", "--at", "3", "--duration", "3.01"), "an earlier --at"),
        (("telemetry-off", "--set", 'hil.arms=["left"]'), "remove the table"),
        (("telemetry-off", "--set", 'driver="dynamixel"'), "driver=sim"),
    ):
        done = coop("faults", "inject", "paper", *words, cwd=tmp_path)
        assert done.code == 2, words
        assert len(done.err.splitlines()) == 1
        assert said in done.err
        assert not list(tmp_path.iterdir())


def test_the_log_of_a_recorder_that_is_started_anew_is_refused_a_name_that_is_taken_before_the_run(
    processes: Processes, tmp_path: Path
) -> None:
    (tmp_path / "log_2.mcap").write_text("mine")
    words = ("faults", "inject", "paper", "recorder-off", "--at", "0.02", "--duration", "0.1", "--out")
    done = coop(*words, tmp_path / "log.mcap", "--for", "0.02")
    assert (done.code, processes.folder) == (2, Path())
    assert f"log {tmp_path / 'log_2.mcap'}: found one of that name" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["log_2.mcap"]
    done = coop(*words, tmp_path / "log.mcap")
    assert done.code == 0, "nobody is started anew: one log"


def test_what_a_killed_one_left_among_the_temporary_files_goes_with_the_next(processes: Processes) -> None:
    """What a process that failed has left stays."""
    processes.fails = True
    coop("faults", "inject", "paper", "recorder-off", *SHORT)
    told = processes.folder
    left = told.with_name("coop-faults-dead")
    left.mkdir()
    (left / LOCK).touch()
    processes.fails = False
    assert coop("faults", "inject", "paper", "recorder-off", *SHORT).code == 0
    assert (left.exists(), told.exists(), processes.folder.exists()) == (False, True, False)


def test_a_disk_without_room_is_left_no_part_of_a_log(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with tempfile.TemporaryDirectory(dir="/dev/shm") as elsewhere:  # another file system: a rename cannot do it
        monkeypatch.setattr("tempfile.tempdir", elsewhere)
        processes.size_max = len(b"of the rec")
        try:
            done = coop("faults", "inject", "paper", "recorder-off", *SHORT, "--out", out / "log.mcap")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert not list(Path(elsewhere).iterdir())
    assert done.code == 4
    assert f"{out / 'log.mcap'}: found File too large" in done.err
    assert not list(out.iterdir())
