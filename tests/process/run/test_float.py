"""`coop float` as processes: told to stop, or killed, the arm stands and sinks, and all end with a complete log."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import resource
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.doctor.host import fifo_granted
from agent.log.read import read_log
from agent.modes import Mode
from tests.support.coop import TIMEOUT_S, start

ATTEMPTS = 3


@pytest.mark.long  # a quarter of a minute until it lies; in virtual time `make test` has it
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGTSTP])
def test_a_stop_by_signal_ends_in_off_with_a_complete_log_and_nothing_left(
    tmp_path: Path, number: signal.Signals
) -> None:
    process, seen, log = floating(tmp_path)
    assert [joint["name"] for joint in seen["joints"]] == ["shoulder", "elbow", "wrist_angle"]
    assert all(0.3 < joint["room_rad"] < 2.0 for joint in seen["joints"])
    assert 0.1 < seen["p_m"][0] < 0.5
    process.send_signal(number)
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, err
    told = [json.loads(line) for line in out.splitlines()]
    assert told[-1] == {"log": f"{log}/run.mcap"}
    run = read_log(tmp_path / log / "run.mcap")
    assert run.complete
    modes = [Mode(mode).name for mode, _ in itertools.groupby(run.agents["left"]["mode"].tolist())]
    assert modes == ["FLOAT", "STAND", "SINK"]
    texts = [event.text for event in run.events]
    assert "run ended in OFF" in texts[-1]
    [port] = [text.split()[3] for text in texts if text.startswith("torque on, floating: ")]
    runtime = Path(port).parent
    assert not runtime.exists()
    assert not users(runtime)


def test_a_stop_while_processes_start_ends_the_command_at_once_and_no_arm_gets_torque(tmp_path: Path) -> None:
    process = start("float", "two_wx200", "--arm", "left", "--emulate", "--out", "log", cwd=tmp_path)
    assert process.stderr is not None
    assert process.stderr.readline() == "starting\n"
    started = children(process.pid)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, out) == (130, "")
    assert err.startswith("coop: floating of cell two_wx200: found a stop while its processes started")
    assert not [pid for pid in started if Path(f"/proc/{pid}").exists()]
    assert not (tmp_path / "log" / "logs" / "arm-left.log").exists(), "its process was never started"


@pytest.mark.long  # a quarter of a minute until it lies; in virtual time `make test` has it
@pytest.mark.fault("P1")
def test_an_arm_whose_process_is_killed_is_let_down_by_its_guard(tmp_path: Path) -> None:
    """With the priorities and the limit of the services: a real-time thread that does not sleep for 50 ms is ended."""
    process, _, log = floating(tmp_path, *(("--priority", "80") if fifo_granted() else ()))
    [pid] = [pid for pid in children(process.pid) if b"agent" in words_of(pid)]
    [guard] = [pid for pid in children(process.pid) if b"guard" in words_of(pid)]
    resource.prlimit(guard, resource.RLIMIT_RTTIME, (50_000, 100_000))
    os.kill(pid, signal.SIGKILL)
    _, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 5
    assert "arm-left: found ended while it floated; its guard has let the arm down (exit code -9)" in err
    run = read_log(tmp_path / log / "run.mcap")
    assert run.complete
    rows = run.agents["left"]
    modes = [Mode(mode).name for mode, _ in itertools.groupby(rows["mode"].tolist())]
    assert modes == ["FLOAT", "STAND", "SINK"]
    assert "the agent has died: the guard lets the arm down" in [event.text for event in run.events]
    assert (rows["sequence"] == np.arange(len(rows))).all(), "two never write"


@pytest.mark.long  # until it lies
def test_an_arm_whose_guard_is_killed_stands_and_sinks_and_the_command_says_so(tmp_path: Path) -> None:
    process, _, log = floating(tmp_path)
    [guard] = [pid for pid in children(process.pid) if b"guard" in words_of(pid)]
    os.kill(guard, signal.SIGKILL)
    _, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 5
    assert "found the guard is gone, expected a stop by whoever guides it" in err
    modes = [
        Mode(mode).name for mode, _ in itertools.groupby(read_log(tmp_path / log / "run.mcap").agents["left"]["mode"])
    ]
    assert modes == ["FLOAT", "STAND", "SINK"]


def children(pid: int) -> list[int]:
    """Processes that this one has started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def words_of(pid: int) -> list[bytes]:
    """Its command line."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")


def floating(folder: Path, *more: str) -> tuple[subprocess.Popen[str], Any, str]:
    """The command, the first arm that it shows, and its folder; emulated servos of a host that stalls answer late."""
    for attempt in range(ATTEMPTS):
        log = f"log{attempt}"
        process = start("float", "two_wx200", "--arm", "left", "--emulate", "--json", "--out", log, *more, cwd=folder)
        assert process.stdout is not None
        for line in process.stdout:
            [seen] = json.loads(line)
            if seen["joints"]:
                return process, seen, log
        told = process.communicate()
    raise AssertionError(told)


def users(folder: Path) -> list[str]:
    """Processes whose command line names the folder."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if str(folder).encode() in file.read_bytes():
                found.append(file.parent.name)
    return found
