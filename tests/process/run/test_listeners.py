"""`coop faults inject` of telemetry and recorder: real processes are struck, torques stay, logs tell, nothing is left.

Each deed with every column of the rows: `test_network_independence.py`.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from agent.config.cell import load_cell
from agent.faults.heard import Kept, heard
from agent.faults.judge import RowResult
from agent.faults.listeners import Struck, rehearse_listeners
from agent.faults.plan import NAMES, OF_LISTENERS, Injection
from agent.faults.strikes import Strike
from agent.host.child import ChildFailed
from agent.log.read import read_log
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.coop import PAPER, coop, start
from tests.support.nobody import Nobody

ROWS = 160  # of an arm in 0.8 s
WRITTEN = {"plant": 41, "left": ROWS, "right": ROWS}
SHORT = ("--at", 0.2, "--duration", 0.8)
OURS = [name for name in NAMES if Injection(fault=name).target in OF_LISTENERS]


def injected(folder: Path, *words: str | float) -> dict:
    """The document of a run that is as it must be."""
    done = coop("faults", "inject", "paper", *words, "--json", cwd=folder)
    assert done.returncode == 0, (done.stdout, done.stderr)
    document = json.loads(done.stdout)
    assert document["verdict"] == "met"
    assert all(torque["same"] for torque in document["torque"].values())
    assert all(rows["missing"] + rows["logged"] == rows["written"] for rows in document["rows"].values())
    assert {name: rows["written"] for name, rows in document["rows"].items()} == WRITTEN
    return document


class Seen(Struck):
    """Looks at each strike how far the run is."""

    def _carry_out(self, strike: Strike) -> None:
        with RingReader(self._ring("left"), AGENT_STATE) as ring:
            t = float(AGENT_STATE.decode(ring.read_last(1).payload)["t"][-1])
        assert strike.at_s - 0.01 < t < strike.at_s + 0.03, "a row or two beside the plant, which looks every 20 ms"
        super()._carry_out(strike)


@pytest.mark.long  # test_network_independence.py has every kind, tests/process/telemetry the rows
@pytest.mark.fault("P10", "N1", "N2")
def test_who_goes_on_or_is_started_anew_has_every_row_and_the_torques_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.faults.listeners.Struck", Seen)
    cell = load_cell(PAPER, ["duration_s=0.7", "simulation.ready_s=0.1"])
    faults = [
        Injection(fault="telemetry-stuck", arm="right", at_s=0.1, for_s=0.1),
        Injection(fault="telemetry-off", arm="left", at_s=0.1, for_s=0.1),
        Injection(fault="recorder-off", at_s=0.3, for_s=0.1),
        Injection(fault="recorder-stuck", at_s=0.5, for_s=0.1),
        Injection(fault="telemetry-garbage", arm="right", at_s=0.62),
        Injection(fault="telemetry-wrong", arm="left", at_s=0.62),
    ]
    run = rehearse_listeners(cell, faults, 1, tmp_path / "run.mcap", Nobody())
    assert [log.name for log in run.logs] == ["run.mcap", "run_2.mcap"]
    found = heard(run)
    assert found.verdict is RowResult.MET
    assert found.kept == {member: Kept(rows, rows, 0) for member, rows in WRITTEN.items()}
    assert found.left_out == {"no batch header": 600, "unknown key": 400, "wrong cell or layout": 2}
    last = read_log(run.logs[1])
    assert last.complete
    assert {len(rows) for rows in last.agents.values()} == {ROWS}


@pytest.mark.long
@pytest.mark.fault("P10", "N1")
def test_a_recorder_that_is_back_has_every_row_in_its_own_log(tmp_path: Path) -> None:
    document = injected(tmp_path, "recorder-off", *SHORT, "--for", 0.2, "--out", "log.mcap")
    assert document["logs"] == ["log.mcap", "log_2.mcap"]
    assert not document["complete"]
    assert not any(rows["missing"] for rows in document["rows"].values())
    second = read_log(tmp_path / "log_2.mcap")
    assert second.complete
    assert {len(rows) for rows in second.agents.values()} == {ROWS}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "log_2.mcap"]


@pytest.mark.long
@pytest.mark.fault("P10", "N1", "N2", "N6")
@pytest.mark.parametrize("fault", OURS)
def test_every_fault_of_a_listener_leaves_the_torques_alone(fault: str, tmp_path: Path) -> None:
    document = injected(tmp_path, fault, *SHORT)
    missing = {name for name, rows in document["rows"].items() if rows["missing"]}
    target, _, kind = fault.partition("-")
    gone = {"left"} if target == "telemetry" else {"left", "right", "plant"}
    assert missing == (gone if kind in ("off", "stuck") else set())
    assert document["complete"] == (not missing)
    left_out = {"garbage": {"no batch header": 600, "unknown key": 400}, "wrong": {"wrong cell or layout": 2}}
    if kind not in ("off", "stuck") or target == "telemetry":
        assert document["left_out"] == left_out.get(kind, {})
    assert document["strange_messages"] == sum(left_out.get(kind, {}).values())
    assert not list(tmp_path.iterdir())


def until(what: Callable[[], object], within_s: float = 60.0) -> None:
    deadline = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def telemetry_stands(pid: int) -> bool:
    """Whether a telemetry process of this command is stopped."""
    for child in psutil.Process(pid).children():
        try:
            if child.status() == psutil.STATUS_STOPPED and child.name().startswith("telemetry-"):
                return True
        except psutil.Error:  # it has just ended
            continue
    return False


def standing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> subprocess.Popen[str]:
    """The command, once one of its processes stands still; what it leaves lies in `folder`."""
    monkeypatch.setenv("TMPDIR", str(folder))
    command = start("faults", "inject", "paper", "telemetry-stuck", "--at", 0.1, "--duration", 19, cwd=folder)
    until(lambda: telemetry_stands(command.pid))
    return command


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_nothing_outlives_the_command_not_even_what_stands_still(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = standing(tmp_path, monkeypatch)
    children = psutil.Process(command.pid).children()
    assert len(children) == 7  # plant, recorder, two agents and telemetry of three
    command.send_signal(number)
    _, errors = command.communicate(timeout=60.0)
    assert command.returncode == (-number if number is signal.SIGKILL else 130)
    assert "Traceback" not in errors
    assert psutil.wait_procs(children, timeout=20.0)[1] == []
    if number is signal.SIGINT:
        assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_a_process_that_ends_without_being_struck_is_a_failure_and_its_words_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = standing(tmp_path, monkeypatch)
    recorder = next(child for child in psutil.Process(command.pid).children() if child.name() == "recorder")
    os.kill(recorder.pid, signal.SIGKILL)
    _, errors = command.communicate(timeout=60.0)
    assert command.returncode == ChildFailed.exit_code
    words = Path(errors.rpartition("its log is ")[2].strip())
    assert words.name == "recorder.log"
    assert words.is_file()
    assert tmp_path in words.parents
