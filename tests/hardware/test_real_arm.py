"""The driver's contract on a real arm: `pytest tests/hardware --hardware CELL --arm NAME`.

The arm is supported, holds no object, is near the cell's start pose, and nobody is within its reach.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.process.build import Connection, build_driver
from agent.verify.check import examine
from drivers.clock import MonotonicClock
from drivers.interface import Driver
from tests.support.driver_contract import DriverContract, Rig


@pytest.mark.hardware
class TestRealArm(DriverContract):
    @pytest.fixture
    def rig(self, request: pytest.FixtureRequest) -> Iterator[Rig]:
        path, name = request.config.getoption("--hardware"), request.config.getoption("--arm")
        cell = load_cell(Path(path))
        arm = cell.arm(name)
        q_start = examine(cell).q_start[cell.arms.index(arm)]

        def driver() -> Driver:
            return build_driver(cell, arm, DriverKind.DYNAMIXEL, Connection(), q_start, lambda _: None)[0]

        made = driver()
        try:
            yield Rig(made, MonotonicClock, tuple(arm.entry.controlled), np.full(arm.n, 0.02), driver, None)
        finally:
            made.disable()
            made.close()
