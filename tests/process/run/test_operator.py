"""P11, P13, C4 with real agents: a word reaches the living and names the others, a failing agent harms nobody."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.host.clock import ClockState, read_kernel
from tests.support.command import coop
from tests.support.stalls import Kernel, despite_stalls

PAPER = configs.CELLS_DIR / "paper.toml"
COOP = (sys.executable, "-m", "agent.cli")


@dataclass
class Cell:
    """The paper's cell in simulation at the wall clock's pace, as if on two hosts; its agents hold until released."""

    file: str
    agents: dict[str, subprocess.Popen[str]]

    def coop(self, *words: str) -> tuple[int, str]:
        done = coop(*words)
        return done.code, done.out + done.err

    def process(self, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen([*COOP, *words], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def await_line(process: subprocess.Popen[str], beginning: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(beginning):
            return
    raise AssertionError(f"ended before {beginning!r}")


def agent_of(file: str, arm: str) -> tuple[str, ...]:
    return "agent", file, "--arm", arm, "--real-time", "--hold"


def in_real_time(test: Callable[[Cell, Path], None]) -> Callable[[Path], None]:
    """A test of a cell and its folder, and again on another where its agents had no core when it was their turn."""

    @pytest.mark.realtime
    @pytest.mark.timeout(400)
    @despite_stalls
    def on_cell(tmp_path: Path) -> None:
        kernel = Kernel()
        with (
            pytest.MonkeyPatch.context() as patch,
            cell_in(tmp_path, patch) as cell,
            kernel.heard(cell.agents["left"].pid),
            kernel.heard(cell.agents["right"].pid),
        ):
            test(cell, tmp_path)

    return on_cell


@contextmanager
def cell_in(folder: Path, patch: pytest.MonkeyPatch) -> Iterator[Cell]:
    patch.setenv("XDG_RUNTIME_DIR", str(folder))
    patch.delenv("RUNTIME_DIRECTORY", raising=False)
    file = folder / "cell.toml"
    text = PAPER.read_text()
    for arm, host in (("left", "one"), ("right", "two")):
        text = text.replace(f'name = "{arm}"', f'name = "{arm}"\nhost = "{host}"')
    file.write_text(text)
    found = Cell(str(file), {})
    plant = found.process("plant", found.file, "--real-time")
    try:
        await_line(plant, "READY")
        for arm in ("left", "right"):
            found.agents[arm] = found.process(*agent_of(found.file, arm))
        for agent in found.agents.values():
            await_line(agent, "READY torque=on")
        yield found
    finally:
        for process in (*found.agents.values(), plant):
            process.kill()
            with process:  # waits for it and closes its pipe
                pass


def clock_file(path: Path, max_error_s: float) -> str:
    path.write_bytes(ClockState(synchronised=True, max_error_s=max_error_s).encode(time.time_ns()))
    return str(path)


def status_of(cell: Cell, host: str) -> tuple[int, dict[str, Any]]:
    code, told = cell.coop("status", cell.file, "--host", host, "--json")
    (arm,) = json.loads(told)["arms"]
    return code, arm


def wait_until_held(cell: Cell, clock: Path) -> None:
    """C4: 4.99 ms are allowed, and 100 ppm more have passed 5 ms after 0.1 s."""
    for _ in range(100):
        arm = status_of(cell, "one")[1]
        if arm["mode"] != "READY":
            break
        time.sleep(0.1)
    assert (arm["mode"], arm["reason"].startswith("the clock may be off by 5.")) == ("HOLD", True)
    assert arm["clock_bound_s"] > 5e-3
    good = clock_file(clock, 1e-4)
    code, told = cell.coop("start", cell.file, "--in", "5", "--host", "one", "--clock", good)
    assert (code, "left: refuses in HOLD" in told) == (7, True), told


@in_real_time
def test_words_reach_the_living_and_say_who_is_dead(cell: Cell, tmp_path: Path) -> None:
    second = cell.process(*agent_of(cell.file, "left"), "--ring", str(tmp_path / "other.ring"))  # loads meanwhile
    clock = clock_file(tmp_path / "clock.json", 5.1e-3)
    code, told = cell.coop("start", cell.file, "--in", "1000", "--host", "two", "--clock", clock)
    assert (code, "clock of this host: found synchronised, error at most 5.1 ms" in told) == (7, True), told
    clock = clock_file(tmp_path / "clock.json", 4.99e-3)
    code, told = cell.coop("start", cell.file, "--in", "1000", "--host", "one", "--clock", clock)
    assert (code, "WARNING: above 1 ms" in told, "1 arms start at" in told) == (0, True, True), told
    if not read_kernel().synchronised:  # else somebody corrects the clock of this host
        wait_until_held(cell, tmp_path / "clock.json")
    arm = status_of(cell, "two")[1]
    assert (arm["mode"], arm["start_utc_ns"]) == ("READY", None)
    code, told = cell.coop("release", cell.file, "--arm", "right")
    assert (code, "right: refuses in READY" in told) == (7, True), told
    told = second.communicate(timeout=60)[0]
    assert (second.returncode, "found an agent that listens there" in told) == (2, True), told

    dead = tmp_path / "coop/paper/right.control"  # as an agent leaves it that is killed; the plant would end the run
    dead.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left_behind:
        left_behind.bind(str(dead))
    code, told = cell.coop("stop", cell.file, "--arm", "left", "--arm", "right")
    assert code == 7
    assert "found right: does not answer (Connection refused)" in told
    assert "; done: left " in told, told

    code, arm = status_of(cell, "one")
    assert (code, arm["mode"]) == (0, "HOLD")
    code, arm = status_of(cell, "two")
    assert (code, arm["answers"], arm["alive"], arm["silence"]) == (1, False, True, "Connection refused")
    code, told = cell.coop("release", cell.file, "--host", "one")
    assert (code, "left switches its torque off" in told) == (0, True), told
    assert cell.agents["left"].wait(timeout=30) == 0
    code, arm = status_of(cell, "one")
    assert (code, arm["answers"], arm["alive"], arm["ended"]) == (1, False, False, True), "it ended in order"
    cell.agents["right"].kill()
    cell.agents["right"].wait()
    arm = status_of(cell, "two")[1]
    assert (arm["alive"], arm["ended"]) == (False, False), "it was killed"


@in_real_time
def test_an_agent_whose_terminal_is_gone_holds_and_obeys(cell: Cell, folder: Path) -> None:
    agent = cell.agents["left"]
    assert agent.stdout is not None
    agent.stdout.close()  # nobody reads what it says any more
    agent.send_signal(signal.SIGHUP)
    for _ in range(100):
        code, arm = status_of(cell, "one")
        if arm["mode"] != "READY":
            break
        time.sleep(0.1)
    assert (code, arm["mode"], agent.poll()) == (0, "HOLD", None)
    code, told = cell.coop("release", cell.file, "--host", "one")
    assert (code, "left switches its torque off" in told) == (0, True), told
    agent.wait(timeout=30)
