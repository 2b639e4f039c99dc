"""From the moment an arm has torque its servos' watchdogs run: what takes long on a busy host is done before it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.agent import build_agent
from agent.config.cell import load_cell
from agent.config.schema.cell import DriverKind
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line
from agent.host.signals import StopFlag
from agent.process import agent as process
from agent.process.build import Connection
from agent.process.schedule import AgentOptions
from drivers.dynamixel.driver import DynamixelDriver
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from tests.support.servos.dxl_rig import START, VirtualClock, VirtualPort, wiring

SLOW_NS = 500_000_000  # longer than any watchdog of a cell


def test_a_host_that_builds_the_law_slowly_trips_no_watchdog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real loop and driver on emulated servos, in virtual time."""
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml")
    arm = cell.arm("left")
    servos = arm_map(cell, arm, "virtual", np.array([START[name] for name in arm.entry.controlled]))
    emulated = EmulatedCell([EmulatedArm(wiring(servos))], None, start_ns=10_000_000_000)
    injector = Injector(emulated.arms[0], None, seed=1)
    clock = VirtualClock(emulated, injector)
    driver = DynamixelDriver(servos, clock, scan_s=0.05, port=VirtualPort(Line(emulated, 0, injector, clock), arm.baud))
    build = build_agent

    def slowly(*given: Any) -> Any:
        clock.sleep_until(clock.now_ns() + SLOW_NS)
        return build(*given)

    stop, said = StopFlag(), list[str]()

    def ready(text: str) -> None:
        said.append(text)
        stop.stopped = text == "torque=on"

    monkeypatch.setattr(process, "build_agent", slowly)
    monkeypatch.setattr(process, "build_driver", lambda *_: (driver, clock))
    options = AgentOptions(
        "left",
        DriverKind.DYNAMIXEL,
        Connection(emulated=True),
        tmp_path / "left.ring",
        None,
        lockstep=False,
        hold=False,
    )
    summary = process.run_agent(cell, options, stop, ready)
    assert said[-1] == "torque=on"
    assert summary.ticks >= 1
    assert emulated.arms[0].bus.counters.watchdog_trips == 0
