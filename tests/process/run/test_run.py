"""`coop run`: real processes, real sockets, real files; what a newcomer's one command does, and what breaks it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from agent.host.flock import lock
from agent.host.share import share_out
from agent.log.read import RunLog, read_log
from agent.process.run_folder import LOCK, PREFIX, run_folder
from agent.telemetry.row.sample import AGENT_STATE
from tests.process.conftest import PAPER_RUN_S
from tests.support.command import coop as line
from tests.support.coop import COOP, PAPER, TIMEOUT_S, start
from tests.support.loaded import Loaded
from tests.support.members import member

ROWS = 200 * PAPER_RUN_S
ARMS = ("arm-left", "arm-right")
LISTENERS = ("recorder", "telemetry-left", "telemetry-right", "telemetry-plant")


def ours(folder: Path) -> list[psutil.Process]:
    """Processes of a run in this folder."""
    found = []
    for process in psutil.process_iter(["cwd"]):
        if process.info["cwd"] is not None and Path(process.info["cwd"]).is_relative_to(folder):
            found.append(process)
    return found


def is_used(folder: Path) -> bool:
    """Whether the run whose folder it is lives."""
    with contextlib.suppress(FileNotFoundError):
        held = os.open(folder / LOCK, os.O_RDWR)
        try:
            return not lock(held)
        finally:
            os.close(held)
    return False


def wait_for_rows(out: Path, run: subprocess.Popen[str] | Loaded, timeout_s: float = 60.0) -> None:
    """Return when the run's log holds rows for certain."""
    deadline = time.monotonic() + timeout_s
    log = out / "run.mcap"
    while not (log.exists() and log.stat().st_size > 300_000):
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture
def nothing_left(tmp_path: Path) -> Iterator[Path]:
    """A folder to run in, `left_clean` by the test."""
    with left_clean(tmp_path) as folder:
        yield folder


@contextlib.contextmanager
def left_clean(folder: Path) -> Iterator[Path]:
    """Afterwards no process of a run in this folder and no file in shared memory may be left."""
    before = set(Path("/dev/shm").glob("coop-*"))
    yield folder

    def unused() -> list[Path]:
        """Folders that no other run uses; one that begins or ends beside this test is among them for a moment."""
        return [left for left in set(Path("/dev/shm").glob("coop-*")) - before if not is_used(left)]

    deadline = time.monotonic() + 30
    while any(found := (ours(folder), unused())) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert found == ([], [])


def test_a_run_leaves_log_report_figures_and_results(paper_runs: tuple[Path, Path]) -> None:
    out = paper_runs[0]
    names = {p.name for p in out.iterdir()}
    assert {"run.mcap", "report.html", "results.json"} <= names
    assert sum(n.endswith(".png") for n in names) >= 4
    results = json.loads((out / "results.json").read_text())
    for key in (
        "max_position_error_m", "max_attitude_error_rad", "rms_position_error_m", "peak_torque_fraction",
        "rows_expected", "rows_recorded", "real_time_factor", "late_cycles", "complete",
    ):  # fmt: skip
        assert key in results
    assert results["rows_expected"] == results["rows_recorded"] == 2 * ROWS
    assert results["complete"] is True


def test_two_runs_of_a_cell_give_the_same_rows_byte_for_byte(paper_runs: tuple[Path, Path]) -> None:
    a, b = (read_log(p / "run.mcap") for p in paper_runs)
    compared = [f.name for f in AGENT_STATE.fields if not f.timing]
    for arm in ("left", "right"):
        assert len(a.agents[arm]) == ROWS
        for name in compared:
            assert a.agents[arm][name].tobytes() == b.agents[arm][name].tobytes(), (arm, name)
    assert a.plant is not None
    assert b.plant is not None
    assert a.plant["p_object"].tobytes() == b.plant["p_object"].tobytes()


def test_the_log_holds_what_is_needed_to_redo_the_run(paper_runs: tuple[Path, Path]) -> None:
    log: RunLog = read_log(paper_runs[0] / "run.mcap")
    assert b'name = "paper"' in log.attachments["cell.toml"]
    assert log.attachments["widowx_mk2.urdf"].startswith(b"<?xml")
    assert log.run_info()["cell"] == "paper"
    assert "numpy" in log.run_info()["versions"]


def test_the_logged_torque_is_the_sum_of_its_logged_terms(paper_runs: tuple[Path, Path]) -> None:
    for rows in read_log(paper_runs[0] / "run.mcap").agents.values():
        terms = [n for n in rows.dtype.names or () if n.startswith("tau_")]
        summed = [n for n in terms if n not in ("tau_measured", "tau_cmd", "tau_limited", "tau_sent")]
        np.testing.assert_allclose(sum(rows[n] for n in summed), rows["tau_cmd"], atol=1e-12)


def code_start(pid: int) -> int:
    """Where the interpreter's own code begins in its memory, which is another address for each that is started anew."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[23])


@dataclass(frozen=True)
class Stopped:
    """A run that was looked at and then ended by Ctrl-C."""

    inet: list[Any]  # network sockets of the left arm's agent while it ran
    mapped: list[str]  # files in its memory
    cores: dict[str, list[int]]  # of each process, by its name
    starts: dict[str, int]  # where the code of Python lies in each, and in the command
    returncode: int
    out: str
    err: str
    log: RunLog


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stopped]:
    with left_clean(tmp_path_factory.mktemp("stopped")) as folder:
        run = start("run", PAPER, "--duration", "1000", "--no-report", "--out", folder / "out", cwd=folder)
        wait_for_rows(folder / "out", run)
        agent = member("arm-left", run)
        inet, mapped = agent.net_connections(kind="inet"), [m.path for m in agent.memory_maps()]
        members = {name: member(name, run) for name in (*ARMS, "plant", *LISTENERS)}
        cores = {name: process.cpu_affinity() for name, process in members.items()}
        starts = {name: code_start(process.pid) for name, process in members.items()} | {"": code_start(run.pid)}
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=60)
        yield Stopped(inet, mapped, cores, starts, run.returncode, out, err, read_log(folder / "out" / "run.mcap"))


def test_ctrl_c_ends_everything_and_leaves_a_readable_log(stopped: Stopped) -> None:
    assert stopped.returncode == 130, stopped.err
    assert "stopped by request" in stopped.out
    assert min(len(rows) for rows in stopped.log.agents.values()) > 0


def test_the_agent_process_opens_no_network_socket(stopped: Stopped) -> None:
    assert stopped.inet == []
    assert len(stopped.mapped) > 50, "the libraries of a process that was there"
    assert not any("zenoh" in path or "mcap" in path for path in stopped.mapped)


def test_every_process_of_a_lockstep_run_keeps_to_its_cores(stopped: Stopped) -> None:
    cores = share_out(len(ARMS), os.sched_getaffinity(0))
    kept = dict(zip(ARMS, cores.arms, strict=True)) | {"plant": cores.plant} | dict.fromkeys(LISTENERS, cores.listeners)
    assert {word: set(found) for word, found in stopped.cores.items()} == kept


def test_the_processes_of_a_run_are_copies_of_the_command_and_share_its_code(stopped: Stopped) -> None:
    assert len(stopped.starts) == 1 + 3 + len(LISTENERS)
    assert len(set(stopped.starts.values())) == 1


def test_a_killed_agent_is_named_and_the_log_is_readable(nothing_left: Path) -> None:
    run = Loaded("run", PAPER, "--duration", "1000", "--out", str(nothing_left / "out"), cwd=nothing_left)
    wait_for_rows(nothing_left / "out", run)
    agent = member("arm-right", run)
    agent.kill()
    _, err = run.communicate(timeout=60)
    assert run.returncode not in (0, None)
    assert "arm-right" in err.strip().splitlines()[-1]
    assert "Traceback" not in err
    log = read_log(nothing_left / "out" / "run.mcap")
    assert min(len(rows) for rows in log.agents.values()) > 0


def test_a_killed_run_takes_its_processes_with_it(nothing_left: Path) -> None:
    run = Loaded("run", PAPER, "--duration", "1000", "--out", str(nothing_left / "out"), cwd=nothing_left)
    wait_for_rows(nothing_left / "out", run)
    children = psutil.Process(run.pid).children()
    (left,) = {Path(mapped.path).parent for mapped in member("plant", run).memory_maps() if PREFIX in mapped.path}
    run.kill()
    run.communicate(timeout=10)
    _, alive = psutil.wait_procs(children, timeout=20)
    assert alive == []
    assert left.is_dir(), "nobody was left to remove it"
    with run_folder():
        assert not left.exists(), "the next run does"


@pytest.mark.long  # which folder is taken: tests/unit/process/test_run_folder.py
def test_a_run_goes_well_where_memory_is_that_of_a_container(nothing_left: Path) -> None:
    def with_little(*command: str) -> subprocess.CompletedProcess[str]:
        script = 'mount -t tmpfs -o size=64m none /dev/shm && "$@" && ls -A /dev/shm'
        return subprocess.run(
            ["unshare", "--mount", "sh", "-c", script, "sh", *command],
            cwd=nothing_left, capture_output=True, text=True, timeout=TIMEOUT_S,
        )  # fmt: skip

    if shutil.which("unshare") is None or with_little("true").returncode:
        pytest.skip("needs unshare and the right to mount a small /dev/shm")
    done = with_little(*COOP, "run", str(PAPER), "--duration", "0.3", "--no-report", "--out", "out")
    assert done.returncode == 0, done.stderr
    assert re.search(r"^/dev/shm has 64 MB free, this run wants \d+: it uses .+ instead$", done.stderr, re.MULTILINE)
    assert done.stdout.strip().splitlines()[-1].startswith("log "), "nothing is left in memory"
    assert read_log(nothing_left / "out" / "run.mcap").complete


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("object.mas_kg=1", "did you mean mass_kg"),
        ("rate_hz=120", "spectral radius"),
        ("arms.left.load_share=0.4", "sum"),
    ],
)
def test_a_wrong_cell_is_one_line_and_leaves_no_folder(nothing_left: Path, setting: str, expected: str) -> None:
    done = line("run", PAPER, "--set", setting, "--out", "out", cwd=nothing_left)
    assert done.code == 2
    assert expected in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (nothing_left / "out").exists()


def test_an_output_folder_that_cannot_be_made_is_one_line(nothing_left: Path) -> None:
    (nothing_left / "file").write_text("")
    done = line("run", PAPER, "--out", "file/out", cwd=nothing_left)
    assert done.code == 2
    assert "output folder" in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_a_second_run_into_the_same_folder_is_refused(paper_runs: tuple[Path, Path]) -> None:
    before = (paper_runs[0] / "run.mcap").read_bytes()
    done = line("run", PAPER, "--duration", PAPER_RUN_S, "--out", paper_runs[0], cwd=paper_runs[0])
    assert done.code == 2
    assert "earlier run" in done.err
    assert (paper_runs[0] / "run.mcap").read_bytes() == before


def test_an_occupied_plant_socket_is_refused(nothing_left: Path) -> None:
    place = ["--socket", str(nothing_left / "p.sock"), "--ring", str(nothing_left / "p.ring")]
    first = Loaded("plant", PAPER, *place, cwd=nothing_left)
    assert first.stdout.readline().startswith("READY")
    second = line("plant", PAPER, "--socket", place[1], "--ring", str(nothing_left / "q.ring"), cwd=nothing_left)
    assert second.code != 0
    assert "p.sock" in second.err
    assert len(second.err.strip().splitlines()) == 1
    assert first.poll() is None
    first.terminate()
    first.communicate(timeout=20)


def test_an_unknown_arm_is_refused(nothing_left: Path) -> None:
    done = line("agent", PAPER, "--arm", "middle", "--ring", str(nothing_left / "r"), cwd=nothing_left)
    assert done.code == 2
    assert "left or right" in done.err


def test_an_agent_without_a_plant_says_so(nothing_left: Path) -> None:
    done = line(
        "agent", PAPER, "--arm", "left", "--ring", str(nothing_left / "r"),
        "--plant-socket", str(nothing_left / "none.sock"), cwd=nothing_left,
    )  # fmt: skip
    assert done.code == 3
    assert "start the plant of this cell first" in done.err
    assert len(done.err.strip().splitlines()) == 1
