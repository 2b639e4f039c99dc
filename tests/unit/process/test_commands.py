"""The commands of a run's processes, held against the parser that reads them."""

from __future__ import annotations

import os
from dataclasses import MISSING, asdict, fields
from pathlib import Path

import pytest

from agent.cli.main import whole
from agent.config.schema.driver import DriverKind
from agent.host.starting import USAGE
from agent.process.commands import (
    AgentCommand,
    ChildCommand,
    EmulateCommand,
    GuardCommand,
    PlantCommand,
    RecordCommand,
    TelemetryCommand,
    read,
)
from agent.process.entry import main
from agent.process.loss import AfterLoss

CELL = Path("/dev/shm/coop-x/cell.toml")
FULL = (
    RecordCommand(
        cell=CELL,
        out=Path("out/run.mcap"),
        out_dir=Path("out"),
        listen="tcp/127.0.0.1:0",
        network_config=Path("recorder.json5"),
        driver=DriverKind.SIM,
        truth=True,
        seed=7,
        split_mb=10,
        split_s=60.5,
        keep_mb=100,
        run_info=Path("run.json"),
        at_once=True,
    ),
    PlantCommand(
        cell=CELL,
        socket=Path("plant.sock"),
        ring=Path("plant.ring"),
        real_time=True,
        lost_arm=AfterLoss.LIMP,
        pauses="1.0,2.5",
        stops=True,
        common_start=Path("common_start"),
        utc_offset_ns=1_700_000_000_000_000_003,
    ),
    EmulateCommand(
        cell=CELL,
        ports=Path("ports"),
        ring=Path("plant.ring"),
        faults=Path("faults.jsonl"),
        control=Path("faults.sock"),
        seed=3,
        common_start=Path("common_start"),
        no_timing=True,
        whole=True,
        stops=True,
        utc_offset_ns=-5,
    ),
    AgentCommand(
        cell=CELL,
        arm="left",
        ring=Path("left.ring"),
        control=Path("left.control"),
        driver=DriverKind.DYNAMIXEL,
        plant_socket=Path("plant.sock"),
        port="port",
        emulated=True,
        real_time=True,
        whole=True,
        hold=True,
        guard=Path("left.guard"),
        gripper_empty=True,
        gripper_word=Path("empty"),
        priority=80,
        allow_no_realtime=True,
        wait=2.5,
        stop_in=7,
        utc_offset_ns=1_700_000_000_000_000_003,
    ),
    GuardCommand(
        cell=CELL,
        arm="left",
        socket=Path("left.guard"),
        driver=DriverKind.DYNAMIXEL,
        port="/dev/coop/left",
        control=Path("left.control"),
        post_mortem=Path("out"),
        hold=True,
        emulated=True,
        priority=81,
    ),
    TelemetryCommand(
        cell=CELL,
        member="plant",
        ring=Path("plant.ring"),
        connect="tcp/127.0.0.1:1",
        network_config=Path("member.json5"),
        lockstep=True,
        follow=True,
        cell_name="paper",
        fingerprint="ab12",
        at_once=True,
    ),
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
    assert command.with_parent == os.getpid()
    for name, value in asdict(command).items():
        assert value not in (None, False), f"{name}: this test gives every field a value"
        assert plain(understood[name]) == plain(value), name


@pytest.mark.parametrize("kind", [type(command) for command in FULL], ids=lambda k: k.verb)
def test_what_a_command_leaves_out_keeps_the_parsers_default(kind: type[ChildCommand]) -> None:
    command = bare(kind)
    understood = parsed(command)
    for name, value in asdict(command).items():
        assert plain(understood[name]) == plain(value) or (understood[name], value) == (None, False), name


def bare(kind: type[ChildCommand]) -> ChildCommand:
    """A command that leaves out whatever it can."""
    full = next(command for command in FULL if type(command) is kind)
    needed = {f.name: getattr(full, f.name) for f in fields(kind) if f.default is MISSING}
    for f in fields(kind):
        if f.name in needed and ("None" in str(f.type) or f.type == "bool"):
            needed[f.name] = None if "None" in str(f.type) else False
    return kind(**needed)


@pytest.mark.parametrize("command", [*FULL, *(bare(type(command)) for command in FULL)], ids=lambda c: c.verb)
def test_a_command_is_read_from_its_own_words(command: ChildCommand) -> None:
    assert read(command.argv()) == command


@pytest.mark.parametrize("words", ["dance c", "plant", "plant c --dance", "plant c --ring", "telemetry c"])
def test_words_of_no_command_are_not_read(words: str) -> None:
    with pytest.raises((LookupError, ValueError, TypeError)):
        read(words.split())


def test_the_order_of_words_is_verb_cell_options() -> None:
    command = PlantCommand(cell=CELL, socket=Path("a b"), ring=Path("r"), real_time=False, with_parent=None)
    assert command.argv() == ["plant", str(CELL), "--socket", "a b", "--ring", "r"]


@pytest.mark.parametrize("words", [(), ("agent",), ("dance", "paper"), ("agent", "paper"), ("agent", "paper", "--arm")])
def test_words_of_no_command_are_refused_in_one_line(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == USAGE
    found = " ".join(words) or "no words"
    assert capsys.readouterr().err == (
        f"coop: process: found {found}, expected those of a typed command; use `coop VERB`\n"
    )
