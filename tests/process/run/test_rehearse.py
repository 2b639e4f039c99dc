"""A rehearsal with real processes, sockets, emulated servos on a pseudo terminal and real time: one arm in the loop.

`make hil` and tests/unit/hil have the rest, in virtual time.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.modes import Mode
from agent.operator.ask import ask_arms
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.operator.words import start_together
from agent.process.simulated import actuator_spec
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from drivers.clock import utc_offset_ns
from tests.support.coop import ready, start
from tests.support.stalls import Kernel, Stalled, despite_stalls

pytestmark = [pytest.mark.realtime, pytest.mark.fault("H5")]
ARMS = ("left", "right")
START_NS = 1_000_000_000
TRACK_S = 0.5  # before the plant is killed
HOLD_CYCLES = 30  # after it
PATIENCE_S = 60.0
HOLDS_AFTER = 5  # cycles from the plant's end on
IN_A_CYCLE_NS = 5_000_000
LATE_S = 2e-3  # of a cycle, beyond which this machine stalls


class Lab:
    """A plant, emulated servos of the left arm on its own, and both agents; all of them end with it."""

    def __init__(self, folder: Path, cell: Cell) -> None:
        self.folder, self.cell = folder, cell
        (folder / "cell.toml").write_bytes(cell.toml)
        self._started: list[subprocess.Popen[str]] = []
        self.kernel = Kernel()

    def begin(self) -> None:
        """All processes, torque on.  Raises Stalled."""
        # as if the wall clock had been set before the first process of the run asked for it
        self.utc_offset_ns = utc_offset_ns() - 7_000_003
        self.plant = self._begin(
            "plant", "--socket", "plant.sock", "--ring", "plant.ring", "--real-time", *self._origin
        )
        self.emulator = self._begin("emulate", "--ports", ".")
        for process in (self.plant, self.emulator):
            ready(process)
        self.agents = [self._agent("left", "--port", "left"), self._agent("right", "--real-time")]
        try:
            for agent in self.agents * 2:
                ready(agent)  # loaded, then with torque
        except AssertionError as error:
            if "the bus is not reliable" in str(error):
                raise Stalled("emulated servos were too late at the start") from error
            raise

    def _begin(self, verb: str, *arguments: str) -> subprocess.Popen[str]:
        process = start(verb, "cell.toml", *arguments, cwd=self.folder)
        self._started.append(process)
        return process

    def _agent(self, arm: str, *more: str) -> subprocess.Popen[str]:
        own = ("--ring", f"{arm}.ring", "--control", f"{arm}.control", "--plant-socket", "plant.sock")
        return self._begin("agent", "--arm", arm, "--emulated", "--hold", *own, *self._origin, *more)

    @property
    def _origin(self) -> tuple[str, ...]:
        return "--utc-offset-ns", str(self.utc_offset_ns)

    @property
    def controls(self) -> dict[str, list[Path]]:
        return {arm: [self.folder / f"{arm}.control"] for arm in ARMS}

    def rows(self, arm: str) -> Any:
        with RingReader(self.folder / f"{arm}.ring", AGENT_STATE) as reader:
            return np.frombuffer(reader.read_at(0, reader.written).payload, AGENT_STATE.dtype)

    def wait(self, what: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            if time.monotonic() > deadline:
                raise Stalled("what was waited for did not come")
            time.sleep(0.02)

    def close(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.kill()
            process.communicate()


@contextlib.contextmanager
def lab(folder: Path) -> Iterator[Lab]:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", ['hil.arms=["left"]'])
    made = Lab(folder, cell)
    try:
        made.begin()
        yield made
    finally:
        made.close()


def rehearsed(lab: Lab) -> tuple[Any, Any, int]:
    """Rows of both arms, and when the plant was killed; everybody is released after it.  Raises Stalled."""
    try:
        start_together(lab.controls, Request(Verb.START, lab.cell.fingerprint, time.time_ns() + START_NS))
    except ControlError as error:
        raise Stalled(str(error)) from error
    lab.wait(lambda: bool((lab.rows("left")["t"] > TRACK_S).any()))
    if (lab.rows("left")["mode"] == Mode.HOLD).any():
        raise Stalled("an arm held before anything was done to it")
    lab.plant.kill()
    lab.plant.wait()
    killed_ns = time.monotonic_ns()
    lab.wait(lambda: np.count_nonzero(lab.rows("left")["mode"] == Mode.HOLD) >= HOLD_CYCLES)
    heard = ask_arms(lab.controls, Request(Verb.RELEASE))
    assert isinstance(heard["left"], Reply)
    assert heard["left"].ok
    lab.agents[0].wait(PATIENCE_S)
    return lab.rows("left"), lab.rows("right"), killed_ns


def check_rows(cell: Cell, left: Any, right: Any) -> None:
    """What holds in every row: the sum was sent, to a count, and the addition is within its clamp."""
    arm, hil = cell.arms[0], cell.file.hil
    assert hil is not None
    spec, n = actuator_spec(cell, arm), arm.n
    added, limited, sent = (left[name][:, :n] for name in ("tau_bridge", "tau_limited", "tau_sent"))
    taken = np.isfinite(sent).all(axis=1)
    assert taken.mean() > 0.9
    wanted = np.clip(limited + added, -spec.tau_max_Nm, spec.tau_max_Nm)
    assert np.all(np.abs(sent - wanted)[taken] <= spec.torque_lsb_Nm)
    assert np.all(np.abs(added) <= hil.tau_share * spec.tau_max_Nm + 1e-12)
    assert np.abs(added).max() > 0.02, "the object's part was there"
    assert np.nanmax(np.abs(left["q_twin"] - left["q_measured"])[left["mode"] == Mode.TRACK, :n]) < 0.05
    for name in ("tau_bridge", "q_twin", "twin_age_s"):
        assert not right[name].any(), "an arm that is not in the loop has none"


@pytest.mark.timeout(300)
@despite_stalls
def test_an_arm_in_the_loop_says_what_was_added_and_holds_when_the_plant_is_killed(tmp_path: Path) -> None:
    with lab(tmp_path) as made:
        left, right, killed_ns = rehearsed(made)
        with made.kernel.heard(made.emulator.pid):
            check_rows(made.cell, left, right)
    for rows in (left, right):
        assert set((rows["utc_ns"] - rows["stamp_ns"]).tolist()) == {made.utc_offset_ns}, "one run, one origin"
    held = np.flatnonzero(left["mode"] == Mode.HOLD)
    between = left[(left["stamp_ns"] > killed_ns - IN_A_CYCLE_NS) & (left["mode"] == Mode.TRACK)]
    if between["late_s"].max(initial=0.0) > LATE_S or np.isnan(between["q_measured"][:, 0]).any():
        raise Stalled("cycles were late, or without a state, while the plant was killed")
    assert np.count_nonzero(between["stamp_ns"] > killed_ns) <= HOLDS_AFTER
    assert (left["mode"][held[0] :] == Mode.HOLD).all(), "nothing leads back to the motion"
    assert not left["tau_bridge"][-1].any(), "without a plant the addition is gone"
