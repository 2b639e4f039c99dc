"""The processes of one run are told the same names, in the run's own folder and in no other."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.host.paths import control_in, emulated_port_in, guard_in, plant_socket_in, ring_in
from agent.process.children import Children
from agent.process.floating_cell import FloatOptions
from agent.process.floating_commands import FloatCommands
from agent.process.run_kind import RunKind
from tests.support.coop import PAPER


@pytest.mark.parametrize("kind", [RunKind.LOCKSTEP, RunKind.REAL_TIME])
def test_arms_meet_their_plant_and_telemetry_its_ring(tmp_path: Path, kind: RunKind) -> None:
    made = Children(load_cell(Path(PAPER)), kind, 0, None, tmp_path / "run.mcap", tmp_path)
    plant, agent, telemetry = made._plant_command(), made._agent_command("left"), made._telemetry_command("left", "")
    assert plant.socket == agent.plant_socket == plant_socket_in(tmp_path)  # type: ignore[union-attr]
    assert (plant.ring, agent.ring) == (ring_in(tmp_path, "plant"), ring_in(tmp_path, "left"))
    assert (telemetry.ring, agent.control) == (agent.ring, control_in(tmp_path, "left"))


def test_arms_on_emulated_servos_meet_them_where_those_make_their_ports(tmp_path: Path) -> None:
    made = Children(load_cell(Path(PAPER)), RunKind.WIRE, 0, None, tmp_path / "run.mcap", tmp_path)
    servos, agent = made._emulate_command(None), made._agent_command("left")
    assert agent.port == str(emulated_port_in(servos.ports, "left"))


def test_an_arm_that_floats_meets_its_guard_its_servos_and_its_telemetry(tmp_path: Path) -> None:
    options = FloatOptions(Path(PAPER), ("left",), emulate=True)
    made = FloatCommands(load_cell(Path(PAPER)), options, tmp_path / "out", tmp_path)
    agent, guard, servos = made.agent("left"), made.guard("left"), made.emulate()
    assert agent.guard == guard.socket == guard_in(tmp_path, "left")
    assert agent.control == guard.control == made.control("left") == control_in(tmp_path, "left")
    assert agent.port == guard.port == str(emulated_port_in(servos.ports, "left"))
    assert agent.ring == made.telemetry("left", "").ring == ring_in(tmp_path, "left")
    assert servos.ring == ring_in(tmp_path, "plant")
