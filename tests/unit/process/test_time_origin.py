"""One run has one origin of time: whoever starts its processes asks the host once and tells all of them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.cli.main import dispatch
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.process import children, emulate, floating_commands, floats, plant
from agent.process.children import Children
from agent.process.commands import AgentOptions
from agent.process.floating_cell import FloatOptions
from agent.process.floating_commands import FloatCommands
from agent.process.run_kind import RunKind
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import PLANT_STATE
from drivers.interface import Clock, Refusal
from sim_backend.wire.serve import ServeOptions
from tests.support.coop import PAPER

OFFSETS_NS = 1_700_000_000_000_000_003, 1_700_000_000_006_000_003  # the wall clock is set between the looks


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (children, floating_commands):
        looks = iter(OFFSETS_NS)
        monkeypatch.setattr(module, "utc_offset_ns", lambda looks=looks: next(looks))


@pytest.mark.usefixtures("host")
@pytest.mark.parametrize("kind", RunKind)
def test_all_processes_of_a_run_are_told_the_same_and_none_in_lockstep(tmp_path: Path, kind: RunKind) -> None:
    made = Children(load_cell(Path(PAPER)), kind, 0, None, tmp_path / "run.mcap", tmp_path)
    told = [
        made._plant_command(),
        made._emulate_command(None),
        *(made._agent_command(arm) for arm in ("left", "right")),
    ]
    assert {command.utc_offset_ns for command in told} == {None if kind is RunKind.LOCKSTEP else OFFSETS_NS[0]}


@pytest.mark.usefixtures("host")
def test_so_are_those_of_arms_that_float(tmp_path: Path) -> None:
    options = FloatOptions(Path(PAPER), ("left",), emulate=True)
    made = FloatCommands(load_cell(Path(PAPER)), options, tmp_path, tmp_path)
    told = [made.emulate(), made.agent("left")]
    assert {command.utc_offset_ns for command in told} == {OFFSETS_NS[0]}


def test_an_arm_that_floats_keeps_to_what_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clocks: list[Clock] = []

    def no_arm() -> None:
        raise Refusal("arm left", found="none", expected="one", remedy="connect it")

    def servo_driver(_: object, __: object, clock: Clock, *___: object) -> SimpleNamespace:
        clocks.append(clock)
        return SimpleNamespace(connect=no_arm, disable=lambda: None, close=lambda: None)

    monkeypatch.setattr(floats, "servo_driver", servo_driver)
    options = AgentOptions(
        cell=Path(), arm="left", driver=DriverKind.DYNAMIXEL, port="nowhere", utc_offset_ns=OFFSETS_NS[0],
        ring=tmp_path / "left.ring", control=None, hold=True,
    )  # fmt: skip
    cell = load_cell(Path(PAPER), ['floating.arms=["left"]'])
    with pytest.raises(Refusal, match="connect it"):
        floats.run_float(cell, options, lambda: True, lambda _: None)  # type: ignore[arg-type]
    assert [clock.utc_offset_ns for clock in clocks] == [OFFSETS_NS[0]]


@pytest.mark.parametrize(("module", "verb"), [(plant, "plant"), (emulate, "emulate")])
def test_what_the_command_says_reaches_plant_and_servos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, verb: str
) -> None:
    monkeypatch.chdir(tmp_path)
    got: dict[str, Any] = {}
    monkeypatch.setattr(module, f"run_{verb}", lambda *_, **options: got.update(options) or "done")
    words = {"plant": ["--socket", "socket", "--ring", "ring"], "emulate": ["--ports", "ports", "--ring", "ring"]}
    assert dispatch([verb, "paper", *words[verb], "--utc-offset-ns", str(OFFSETS_NS[0])]) == 0
    assert got["utc_offset_ns"] == OFFSETS_NS[0]


def test_the_truth_behind_emulated_servos_has_it_in_its_rows(tmp_path: Path) -> None:
    cell, ring = load_cell(Path(PAPER)), tmp_path / "ring"
    ports = {arm.name: tmp_path / arm.name for arm in cell.arms}
    found: list[int] = []

    def seen() -> bool:
        with RingReader(ring, PLANT_STATE) as reader:
            rows = np.frombuffer(reader.read_last(10).payload, PLANT_STATE.dtype)
        found.extend((rows["utc_ns"] - rows["stamp_ns"]).tolist())
        return bool(found)

    served = ServeOptions(ports)
    emulate.run_emulate(
        cell,
        served,
        ring,
        timing=False,
        stop=seen,
        ready=lambda _: None,
        utc_offset_ns=OFFSETS_NS[0],  # type: ignore[arg-type]
    )
    assert set(found) == {OFFSETS_NS[0]}
