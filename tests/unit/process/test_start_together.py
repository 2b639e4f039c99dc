"""Agent, guard and plant that start at once: who is there first waits, and nobody takes that for a hang."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.guard.guard_end import GuardEnd
from agent.guard.line import GuardError
from agent.host.signals import StopFlag
from agent.process import agent as process
from agent.process import guard
from agent.process.commands import AgentOptions
from agent.process.unbegun import Unbegun

CELL = load_cell(configs.CELLS_DIR / "paper.toml")


def options(folder: Path, wait_s: float, driver: DriverKind = DriverKind.DYNAMIXEL) -> AgentOptions:
    return AgentOptions(
        cell=Path(), arm="left", driver=driver, plant_socket=folder / "plant.sock", ring=folder / "left.ring",
        control=None, real_time=True, hold=True, guard=folder / "left.guard", wait=wait_s,
    )  # fmt: skip


def test_a_guard_that_is_not_there_is_refused_once_the_wait_is_over_and_a_stop_ends_it_in_order(tmp_path: Path) -> None:
    stop = StopFlag()
    with pytest.raises(GuardError, match="No such file"):
        process._reached(CELL, options(tmp_path, 0.0), stop, None)
    with pytest.raises(GuardError, match="No such file"):
        process._reached(CELL, options(tmp_path, 0.05), stop, None)
    stop.stopped = True
    with pytest.raises(Unbegun, match="a stop before its torque came on"):
        process._reached(CELL, options(tmp_path, 1e3), stop, None)


@pytest.mark.parametrize(
    ("driver", "looped", "waited"),
    [(DriverKind.DYNAMIXEL, [], 2), (DriverKind.DYNAMIXEL, ['hil.arms=["left"]'], 4), (DriverKind.SIM, [], 4)],
)
def test_a_guard_and_a_plant_that_come_later_are_waited_for(
    tmp_path: Path, driver: DriverKind, looped: list[str], waited: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is there after a look that did not find it; an arm with servos of its own needs no plant out of the loop."""
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", looped)
    looks, here = list[float](), list[Any]()

    def comes(_: float) -> None:
        looks.append(_)
        if len(looks) == 2:
            here.append(GuardEnd(tmp_path / "left.guard", cell.fingerprint))
        if len(looks) == 4:
            here.append(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            here[-1].bind(str(tmp_path / "plant.sock"))

    monkeypatch.setattr(process, "time", SimpleNamespace(sleep=comes, monotonic=lambda: 0.0))
    reached = process._reached(cell, options(tmp_path, 1.0, driver), StopFlag(), None)
    assert reached is not None
    assert len(looks) == waited
    reached.leave()
    for one in here:
        one.close()


def test_an_agent_looks_for_its_guard_and_hands_over_only_when_it_is_told_to_end_and_holds(tmp_path: Path) -> None:
    stop, polled = StopFlag(), list[bool]()
    stop.why = "SIGHUP: its terminal or connection is gone"

    def poll(*, ending: bool, why: str) -> bool:
        polled.append(ending)
        assert why == stop.why, "which its guard names"
        return gone

    gone = True
    guarded: Any = SimpleNamespace(poll=poll)
    holds = options(tmp_path, 0.0)
    for one in (holds, replace(holds, hold=False)):
        for stop.stopped in (False, True):
            assert process._watching(guarded, stop, one)
            assert not process._watching(None, stop, one)
    assert polled == [False, True, False, False]
    gone = False
    assert not process._watching(guarded, stop, holds)


def test_a_plant_that_does_not_come_is_left_to_who_connects(tmp_path: Path) -> None:
    with GuardEnd(tmp_path / "left.guard", CELL.fingerprint):
        reached = process._reached(CELL, options(tmp_path, 0.05, DriverKind.SIM), StopFlag(), None)
    assert reached is not None
    reached.leave()


@pytest.mark.parametrize(
    ("driver", "rows", "waits"),
    [(DriverKind.SIM, 0, True), (DriverKind.SIM, 1, False), (DriverKind.DYNAMIXEL, 0, False)],
)
def test_a_simulated_arm_without_a_row_waits_for_the_others_and_does_not_hang(
    driver: DriverKind, rows: int, waits: bool
) -> None:
    own: Any = SimpleNamespace(_options=SimpleNamespace(driver=driver))
    watched: Any = SimpleNamespace(rows=rows)
    assert guard._Guard._waits_for_others(own, watched) is waits
