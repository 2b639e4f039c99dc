"""The commands of a run's processes, held against the parser that reads them."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

import pytest

from agent.cli.main import whole
from agent.config.schema.cell import DriverKind
from agent.process.commands import (
    AgentCommand,
    ChildCommand,
    EmulateCommand,
    GuardCommand,
    PlantCommand,
    RecordCommand,
    TelemetryCommand,
)

CELL = Path("/dev/shm/coop-x/cell.toml")
FULL = (
    RecordCommand(
        cell=CELL,
        out=Path("out/run.mcap"),
        listen="tcp/127.0.0.1:0",
        driver=DriverKind.SIM,
        truth=True,
        seed=7,
        run_info=Path("run.json"),
    ),
    PlantCommand(cell=CELL, socket=Path("plant.sock"), ring=Path("plant.ring"), real_time=True),
    EmulateCommand(
        cell=CELL, ports=Path("ports"), ring=Path("plant.ring"), faults=Path("faults.jsonl"), seed=3, whole=True
    ),
    AgentCommand(
        cell=CELL,
        arm="left",
        ring=Path("left.ring"),
        control=Path("left.control"),
        driver=DriverKind.DYNAMIXEL,
        plant_socket=Path("plant.sock"),
        port=Path("port"),
        emulated=True,
        real_time=True,
        whole=True,
        hold=True,
        guard=Path("left.guard"),
        gripper_empty=True,
        priority=80,
        allow_no_realtime=True,
    ),
    GuardCommand(
        cell=CELL,
        arm="left",
        socket=Path("left.guard"),
        driver=DriverKind.DYNAMIXEL,
        port=Path("/dev/coop/left"),
        control=Path("left.control"),
        post_mortem=Path("out"),
        hold=True,
        emulated=True,
        priority=81,
    ),
    TelemetryCommand(cell=CELL, member="plant", ring=Path("plant.ring"), connect="tcp/127.0.0.1:1", lockstep=True),
)


def parsed(command: ChildCommand) -> dict[str, object]:
    """What the real parser makes of the command, by parameter; empty lists of repeatable options apart."""
    verb, *arguments = command.argv()
    parser = whole().commands[verb]  # type: ignore[attr-defined]
    return dict(parser.make_context(verb, arguments).params)


def plain(value: object) -> object:
    """Values as the parser hands them on: enumerations by their value, paths as text."""
    value = getattr(value, "value", value)
    return str(value) if isinstance(value, Path) else value


@pytest.mark.parametrize("command", FULL, ids=lambda c: c.verb)
def test_every_field_of_a_command_arrives_under_its_name(command: ChildCommand) -> None:
    understood = parsed(command)
    assert command.with_parent
    for name, value in asdict(command).items():
        assert value not in (None, False), f"{name}: this test gives every field a value"
        assert plain(understood[name]) == plain(value), name


@pytest.mark.parametrize("kind", [type(command) for command in FULL], ids=lambda k: k.verb)
def test_what_a_command_leaves_out_keeps_the_parsers_default(kind: type[ChildCommand]) -> None:
    full = next(command for command in FULL if type(command) is kind)
    needed = {
        f.name: getattr(full, f.name) for f in fields(kind) if f.type not in ("bool", "Path | None", "int | None")
    }
    left_out = {f.name: False if f.type == "bool" else None for f in fields(kind) if f.name not in needed}
    command = kind(**needed, **left_out)
    understood = parsed(command)
    assert {name: understood[name] or value for name, value in left_out.items()} == left_out
    assert {name: plain(understood[name]) for name in needed} == {name: plain(value) for name, value in needed.items()}


def test_the_order_of_words_is_verb_cell_options() -> None:
    command = PlantCommand(cell=CELL, socket=Path("a b"), ring=Path("r"), real_time=False, with_parent=False)
    assert command.argv() == ["plant", str(CELL), "--socket", "a b", "--ring", "r"]
