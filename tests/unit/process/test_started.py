"""What agent and guard are run with is their command, with what it leaves open said by cell and host."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.around import RunSummary
from agent.config.schema.driver import DriverKind
from agent.guard.guarded import UNGUARDED
from agent.host.paths import control_path, guard_path, plant_socket_path, ring_path
from agent.modes import Mode
from agent.process import agent, guard, started
from agent.process.commands import AgentCommand, AgentOptions, GuardCommand, GuardOptions
from agent.process.started import Listener

NAME = "two_wx200"
CELL = configs.CELLS_DIR / f"{NAME}.toml"
AGENT = AgentCommand(
    cell=CELL, arm="left", ring=Path("ring"), control=Path("control"), driver=DriverKind.DYNAMIXEL,
    plant_socket=Path("plant"), port="port", emulated=True, real_time=True, whole=True, hold=True, guard=Path("guard"),
    gripper_empty=True, gripper_word=Path("word"), priority=80, allow_no_realtime=True, wait=2.5, utc_offset_ns=17,
    with_parent=None,
)  # fmt: skip
GUARD = GuardCommand(
    cell=CELL, arm="left", socket=Path("guard"), control=Path("control"), post_mortem=Path("post"),
    driver=DriverKind.DYNAMIXEL, port="port", hold=False, emulated=True, priority=81, with_parent=None,
)  # fmt: skip
BARE_AGENT = AgentCommand(cell=CELL, arm="left", ring=None, control=None, driver=None, with_parent=None)
BARE_GUARD = GuardCommand(cell=CELL, arm="left", socket=None, control=None, post_mortem=Path("post"), with_parent=None)

Given = Callable[[Any], Any]


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Given:
    """What a command's process is run with."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    got: list[Any] = []

    def run(_: object, options: Any, __: object, ready: Callable[[str], None]) -> RunSummary:
        ready("ring=ring")
        ready("torque=on")
        got.append(options)
        return RunSummary(1, 0, 0, Mode.OFF, "", 0.0)

    monkeypatch.setattr(agent, "run_agent", run)
    monkeypatch.setattr(guard, "run_guard", run)

    def of(command: Any, say: Callable[[str], None] = lambda _: None) -> Any:
        assert started.run(command, Listener(say)) == 0
        return got.pop()

    return of


@pytest.mark.parametrize(("command", "kind"), [(AGENT, AgentOptions), (GUARD, GuardOptions)])
def test_what_a_command_says_is_what_its_process_is_run_with(given: Given, command: Any, kind: type) -> None:
    found = given(command)
    assert type(found) is kind
    assert {key.name for key in fields(kind)} == {key.name for key in fields(command)}
    for key in fields(command):
        assert getattr(found, key.name) == getattr(command, key.name), key.name


def test_what_it_leaves_open_is_said_by_the_cell_and_found_where_all_look(given: Given) -> None:
    found, of_guard = given(BARE_AGENT), given(BARE_GUARD)
    assert (found.driver, found.hold, found.lockstep, found.shared) == (DriverKind.SIM, False, True, True)
    assert (found.ring, found.plant_socket) == (ring_path(NAME, "left"), plant_socket_path(NAME))
    assert found.control == of_guard.control == control_path(NAME, "left")
    assert (of_guard.socket, of_guard.driver) == (guard_path(NAME, "left"), DriverKind.SIM)
    real = replace(BARE_AGENT, driver=DriverKind.DYNAMIXEL), replace(BARE_GUARD, driver=DriverKind.DYNAMIXEL)
    for command in real:
        assert (given(command).hold, given(command).shared) == (True, False)
        assert given(replace(command, hold=False)).hold is False
        emulated = given(replace(command, emulated=True))
        assert (emulated.hold, emulated.shared) == (False, True)


def test_who_starts_an_arm_that_nobody_else_would_hold_is_told_so(given: Any) -> None:
    servos = replace(AGENT, guard=None)
    for command, told in (
        (servos, True), (AGENT, False), (replace(servos, whole=False, hold=False), False),
        (replace(servos, driver=DriverKind.SIM, port=None), False),
    ):  # fmt: skip
        said = list[str]()
        given(command, said.append)
        assert said.count(f"arm left: {UNGUARDED}") == told


def test_time_waits_for_a_simulated_arm_alone_and_not_where_it_keeps_the_wall_clocks_pace(given: Given) -> None:
    sim, servos = DriverKind.SIM, DriverKind.DYNAMIXEL
    for driver, real_time, waits in ((sim, False, True), (sim, True, False), (servos, False, False)):
        assert given(replace(BARE_AGENT, driver=driver, real_time=real_time)).lockstep is waits


def test_an_arm_that_begins_at_its_rest_is_held_at_its_end(given: Given) -> None:
    assert given(replace(BARE_AGENT, whole=True)).hold is True
