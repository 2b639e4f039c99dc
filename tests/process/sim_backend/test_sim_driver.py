"""The simulated cell as processes: the same run twice, and every way in which one of them can end."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sim_backend.served.listener import ListenError
from tests.support.loaded import Loaded
from tests.support.plant.sim_process import LISTENING

ENOUGH = 1_000_000  # cycles of a run that the test ends
ROW = 8 * 10
PROCESS_S = 60.0


class Cell:
    """Processes of one test; none is left behind."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.socket = directory / "plant.sock"
        self._processes: list[Loaded] = []

    def start(self, *arguments: object) -> Loaded:
        process = Loaded(*map(str, arguments), module="tests.support.plant.sim_process")
        self._processes.append(process)
        return process

    def plant(self) -> Loaded:
        process = self.start("plant", self.socket)
        assert process.stdout.readline().strip() == LISTENING
        return process

    def agents(self, cycles: int, *more: float) -> tuple[Loaded, Loaded]:
        left, right = (
            self.start("agent", self.socket, arm, cycles, self.directory / arm, *more) for arm in ("left", "right")
        )
        return left, right

    def wait_until_running(self) -> None:
        """Return when both arms have read some states."""
        deadline = time.monotonic() + PROCESS_S
        for arm in ("left", "right"):
            file = self.directory / arm
            while not (file.exists() and file.stat().st_size > 20 * ROW):
                assert time.monotonic() < deadline, "the cell does not run"
                time.sleep(0.01)

    def states(self, arm: str) -> bytes:
        return (self.directory / arm).read_bytes()

    def close(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.communicate()


def end(process: Loaded) -> tuple[int, str]:
    """Exit code and last words."""
    _, words = process.communicate(timeout=PROCESS_S)
    return process.wait(), words


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    made = Cell(tmp_path)
    yield made
    made.close()


@pytest.mark.long  # whole runs are the same in tests/process/run/test_run.py
def test_two_runs_of_the_same_cell_are_the_same_bit_for_bit(cell: Cell) -> None:
    runs = []
    for _ in range(2):
        plant = cell.plant()
        ends = [end(agent) for agent in cell.agents(400)]
        assert ends == [(0, ""), (0, "")]
        assert end(plant) == (0, "")
        assert not cell.socket.exists()
        runs.append((cell.states("left"), cell.states("right")))
    assert runs[0] == runs[1]
    rows = np.frombuffer(runs[0][0]).reshape(-1, 10)
    assert rows[:, 0].tolist() == [k * 5e6 for k in range(400)]
    assert np.ptp(rows[:, 1]) > 0.01


def test_killed_agent_is_named_by_the_plant_and_to_the_other_arm(cell: Cell) -> None:
    plant = cell.plant()
    left, right = cell.agents(ENOUGH)
    cell.wait_until_running()
    right.kill()
    code, words = end(plant)
    assert (code, words[: len("arm right vanished at tick")]) == (5, "arm right vanished at tick")
    code, words = end(left)
    assert code == 3
    assert "arm right vanished at tick" in words
    assert not cell.socket.exists()


def test_killed_plant_ends_the_agents_and_its_place_can_be_taken(cell: Cell) -> None:
    plant = cell.plant()
    agents = cell.agents(ENOUGH)
    cell.wait_until_running()
    plant.kill()
    for agent in agents:
        code, words = end(agent)
        assert code == 3
        assert f"plant at {cell.socket}" in words
    assert cell.socket.exists()
    again = cell.plant()
    assert [end(agent)[0] for agent in cell.agents(10)] == [0, 0]
    assert end(again)[0] == 0


def test_terminated_plant_ends_well_and_says_so_to_the_agents(cell: Cell) -> None:
    plant = cell.plant()
    agents = cell.agents(ENOUGH)
    cell.wait_until_running()
    plant.send_signal(signal.SIGTERM)
    assert end(plant) == (0, "")
    for agent in agents:
        code, words = end(agent)
        assert code == 3
        assert "the run is over: found the plant ended at tick" in words
    assert not cell.socket.exists()


def test_frozen_agent_stops_time_and_nothing_else(cell: Cell) -> None:
    plant = cell.plant()
    left, right = cell.agents(ENOUGH, 3.0)
    cell.wait_until_running()
    right.send_signal(signal.SIGSTOP)
    code, words = end(left)
    assert code == 3
    assert "no state within 3 s" in words
    assert plant.poll() is None or plant.returncode == 5
    right.send_signal(signal.SIGCONT)
    assert end(plant)[0] == 5


@pytest.mark.long  # `coop plant` in tests/process/run/test_run.py
def test_second_plant_at_the_same_place_is_refused(cell: Cell) -> None:
    first = cell.plant()
    code, words = end(cell.start("plant", cell.socket))
    assert code == ListenError.exit_code == 2
    assert "another plant answers at" in words
    assert [end(agent)[0] for agent in cell.agents(10)] == [0, 0]
    assert end(first)[0] == 0


def test_agent_without_a_plant_says_what_to_do(cell: Cell) -> None:
    code, words = end(cell.start("agent", cell.socket, "left", 1, cell.directory / "left"))
    assert code == 3
    assert "start the plant of this cell first" in words
