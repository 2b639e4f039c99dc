"""P11, P13 with real agents: a word reaches the living, who did not answer is named, a failing agent harms nobody."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import configs

CELL = str(configs.CELLS_DIR / "paper.toml")
COOP = (sys.executable, "-m", "agent.cli")


@dataclass
class Cell:
    """The paper's cell in simulation at the wall clock's pace; its agents hold until they are released."""

    environment: dict[str, str]
    agents: dict[str, subprocess.Popen[str]]

    def coop(self, *words: str) -> tuple[int, str]:
        done = subprocess.run([*COOP, *words], env=self.environment, capture_output=True, text=True, timeout=60)
        return done.returncode, done.stdout + done.stderr

    def process(self, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*COOP, *words], env=self.environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )


def await_line(process: subprocess.Popen[str], beginning: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(beginning):
            return
    raise AssertionError(f"ended before {beginning!r}")


def agent_of(arm: str) -> tuple[str, ...]:
    return "agent", CELL, "--arm", arm, "--real-time", "--hold"


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    found = Cell(os.environ | {"XDG_RUNTIME_DIR": str(tmp_path)}, {})
    found.environment.pop("RUNTIME_DIRECTORY", None)
    plant = found.process("plant", CELL, "--real-time")
    try:
        await_line(plant, "READY")
        for arm in ("left", "right"):
            found.agents[arm] = found.process(*agent_of(arm))
        for agent in found.agents.values():
            await_line(agent, "READY torque=on")
        yield found
    finally:
        for process in (*found.agents.values(), plant):
            process.kill()
            process.communicate()


@pytest.mark.realtime
def test_a_stop_reaches_the_living_and_says_who_is_dead(cell: Cell, tmp_path: Path) -> None:
    code, told = cell.coop("start", CELL, "--in", "1000")
    assert (code, "2 arms start at" in told) == (0, True), told
    code, told = cell.coop("release", CELL)
    assert (code, told.count("refuses in READY")) == (7, 2), told

    second = cell.process(*agent_of("left"), "--ring", str(tmp_path / "other.ring"))
    told = second.communicate(timeout=60)[0]
    assert (second.returncode, "found an agent that listens there" in told) == (7, True), told

    dead = tmp_path / "coop/paper/right.control"  # as an agent leaves it that is killed; the plant would end the run
    dead.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left_behind:
        left_behind.bind(str(dead))
    code, told = cell.coop("start", CELL, "--in", "5")
    assert (code, "right: does not answer (Connection refused)" in told) == (7, True), told
    code, told = cell.coop("stop", CELL)
    assert code == 7
    assert "found right: does not answer (Connection refused)" in told
    assert "done: left holds; a start that was given counts no more" in told, told

    code, told = cell.coop("status", CELL, "--json")
    arms = {arm["arm"]: arm for arm in json.loads(told)["arms"]}
    assert (code, arms["left"]["mode"], arms["left"]["reason"]) == (1, "HOLD", "it was asked to")
    assert (arms["right"]["answers"], arms["right"]["silence"]) == (False, "Connection refused")

    code, told = cell.coop("release", CELL, "--arm", "left")
    assert (code, "left switches its torque off" in told) == (0, True), told
    assert cell.agents["left"].wait(timeout=30) == 0
