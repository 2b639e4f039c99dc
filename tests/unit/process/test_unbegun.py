"""A stop that comes before an arm has torque keeps its torque off: the real driver on emulated servos, virtual time."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.around import RunSummary
from agent.config.cell import Cell, load_cell
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.control.floating import Floating
from agent.faults.virtual import Line
from agent.host.signals import StopFlag
from agent.modes import Mode
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.process import agent, float_loop, floats
from agent.process.commands import AgentOptions
from agent.process.unbegun import Unbegun
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.line.codec import HEADER
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.table import TORQUE_ENABLE
from drivers.interface import ArmInfo
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from tests.support.servos.dxl_rig import START, VirtualClock, VirtualPort, wiring
from tests.support.stops import stop_flag

NAME = "two_wx200.toml"
MOVES = ['floating.arms=["right"]', "floating.holding=true", "floating.others_move=true"]


class Bench:
    """The left arm, whose process is asked to end when it says or does something."""

    def __init__(self, cell: Cell, folder: Path, stop: StopFlag, stops_at: str) -> None:
        self.cell, self.stop, self._stops_at = cell, stop, stops_at
        self.said: list[str] = []
        arm = cell.arm("left")
        servos = arm_map(cell, arm, "virtual", np.array([START[name] for name in arm.entry.controlled]))
        emulated = EmulatedCell([EmulatedArm(wiring(servos))], None, start_ns=10_000_000_000)
        injector = Injector(emulated.arms[0], None, seed=1)
        self.clock = VirtualClock(emulated, injector)
        self.port = VirtualPort(Line(emulated, 0, injector, self.clock), arm.baud)
        self.driver = DynamixelDriver(servos, self.clock, scan_s=0.05, port=self.port)
        self.options = AgentOptions(
            cell=Path(), arm="left", driver=DriverKind.DYNAMIXEL, emulated=True, ring=folder / "left.ring",
            control=None, hold=False,
        )  # fmt: skip

    def happens(self, what: str) -> None:
        self.said.append(what.partition("=")[0])
        self.stop.stopped = self.stop.stopped or what.startswith(self._stops_at)

    def when_called(self, what: str, works: Any) -> Any:
        def called(*given: Any, **more: Any) -> Any:
            self.happens(what)
            return works(*given, **more)

        return called

    @property
    def had_torque(self) -> bool:
        """Whether any servo was told to switch its torque on."""
        packets = [data[len(HEADER) :] for data in self.port.writes]
        written = [p[4:-2] for p in packets if p[3] == Instruction.SYNC_WRITE]
        return any(p[0] | p[1] << 8 == TORQUE_ENABLE.address and any(p[5::2]) for p in written)


@pytest.fixture
def stop() -> Iterator[StopFlag]:
    with stop_flag() as flag:
        yield flag


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that floats stands and sinks for a moment; for how long is of test_floats.py."""
    monkeypatch.setattr(float_loop, "STAND_S", 0.2)
    monkeypatch.setattr(float_loop, "SINK_MAX_S", 0.3)
    monkeypatch.setattr("agent.config.floating.Floating", partial(Floating, sink_s=0.2))


@pytest.mark.parametrize(("stops_at", "torque"), [("ring", False), ("law", False), ("torque", True)])
def test_an_agent_that_is_asked_to_end_before_its_torque_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: StopFlag, stops_at: str, torque: bool
) -> None:
    bench = Bench(load_cell(configs.CELLS_DIR / NAME), tmp_path, stop, stops_at)
    monkeypatch.setattr(agent, "quiet_memory", lambda: None)
    monkeypatch.setattr(agent, "build_driver", lambda *_: (bench.driver, bench.clock))
    monkeypatch.setattr(agent, "build_agent", bench.when_called("law", agent.build_agent))
    if torque:
        assert agent.run_agent(bench.cell, bench.options, stop, bench.happens).mode is Mode.OFF
    else:
        with pytest.raises(Unbegun, match="arm left: found a stop before its torque came on") as told:
            agent.run_agent(bench.cell, bench.options, stop, bench.happens)
        assert told.value.exit_code == 130
    assert bench.said == ["ring", "law", "torque"][: 3 if torque else 2]
    assert bench.had_torque is torque
    assert not bench.port.is_open


@pytest.mark.parametrize(
    ("floating", "word", "torque"),  # floating: it moves while the other one floats
    [
        (False, Verb.STOP, False), (False, Verb.RELEASE, False), (False, Verb.CANCEL, True),
        (True, Verb.STOP, False), (True, Verb.RELEASE, False), (True, Verb.STATUS, True),
    ],
)  # fmt: skip
def test_a_stop_or_a_release_over_its_socket_counts_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: StopFlag, floating: bool, word: Verb, torque: bool
) -> None:
    cell = load_cell(configs.CELLS_DIR / NAME, MOVES if floating else [])
    bench = Bench(cell, tmp_path, stop, "torque")
    options = replace(bench.options, control=tmp_path / "left.control")
    module: Any = floats if floating else agent
    monkeypatch.setattr(module, "quiet_memory", lambda: None)
    monkeypatch.setattr(agent, "build_driver", lambda *_: (bench.driver, bench.clock))
    monkeypatch.setattr(floats, "MonotonicClock", lambda _: bench.clock)
    monkeypatch.setattr(floats, "servo_driver", lambda *_: bench.driver)
    monkeypatch.setattr(float_loop, "STAND_S", 0.2)
    run: Any = floats.run_float if floating else agent.run_agent
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as person:
        connect = bench.driver.connect

        def connects() -> ArmInfo:
            person.connect(str(options.control))
            person.send(Request(word).encode())
            return connect()

        monkeypatch.setattr(bench.driver, "connect", connects)
        if torque:
            assert run(cell, options, stop, bench.happens).mode is Mode.OFF
        else:
            with pytest.raises(Unbegun, match="arm left: found a stop before its torque came on"):
                run(cell, options, stop, bench.happens)
        assert Reply.decode(person.recv(4096)).ok
    assert bench.had_torque is torque
    assert not bench.port.is_open


def test_a_simulated_arm_that_is_asked_to_end_begins_all_the_same_for_the_others_wait_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: StopFlag
) -> None:
    bench = Bench(load_cell(configs.CELLS_DIR / NAME), tmp_path, stop, "ring")
    monkeypatch.setattr(agent, "quiet_memory", lambda: None)
    monkeypatch.setattr(agent, "build_driver", lambda *_: (bench.driver, bench.clock))
    options = replace(bench.options, driver=DriverKind.SIM)
    assert agent.run_agent(bench.cell, options, stop, bench.happens).mode is Mode.OFF
    assert bench.said == ["ring", "torque"]


@pytest.mark.parametrize(("stops_at", "torque"), [("ring", False), ("law", False), ("torque", True)])
def test_nor_has_an_arm_that_floats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: StopFlag, stops_at: str, torque: bool
) -> None:
    bench = Bench(load_cell(configs.CELLS_DIR / NAME, ['floating.arms=["left"]']), tmp_path, stop, stops_at)
    monkeypatch.setattr(floats, "quiet_memory", lambda: None)
    monkeypatch.setattr(floats, "MonotonicClock", lambda _: bench.clock)
    monkeypatch.setattr(floats, "servo_driver", lambda *_: bench.driver)
    monkeypatch.setattr(float_loop, "build_agent", bench.when_called("law", float_loop.build_agent))
    if torque:
        assert floats.run_float(bench.cell, bench.options, stop, bench.happens).mode is Mode.OFF
    else:
        with pytest.raises(Unbegun, match="arm left: found a stop before its torque came on"):
            floats.run_float(bench.cell, bench.options, stop, bench.happens)
    assert bench.said == ["ring", "law", "torque"][: 3 if torque else 2]
    assert bench.had_torque is torque
    assert not bench.port.is_open


def test_the_process_of_an_arm_that_stopped_floating_by_itself_does_not_end_as_one_that_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: StopFlag
) -> None:
    bench = Bench(load_cell(configs.CELLS_DIR / NAME, ['floating.arms=["left"]']), tmp_path, stop, "torque")
    monkeypatch.setattr(floats, "quiet_memory", lambda: None)
    monkeypatch.setattr(floats, "MonotonicClock", lambda _: bench.clock)
    monkeypatch.setattr(floats, "servo_driver", lambda *_: bench.driver)
    runs = float_loop.FloatLoop.run

    def run(loop: float_loop.FloatLoop) -> RunSummary:
        summary = runs(loop)
        loop.stopped_by = "it is too quick"
        return summary

    monkeypatch.setattr(float_loop.FloatLoop, "run", run)
    with pytest.raises(floats.FloatStopped, match="arm left: found it is too quick, expected a stop by") as told:
        floats.run_float(bench.cell, bench.options, stop, bench.happens)
    assert told.value.exit_code == 5
    assert not bench.port.is_open
