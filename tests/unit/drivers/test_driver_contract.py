"""Every driver that needs no arm keeps the contract of `tests.support.driver_contract`.

To add one: write a context manager that yields a Rig, and name it in IMPLEMENTATIONS.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import MonotonicClock
from drivers.dynamixel.line import bus
from sim_backend.wire.faults import FaultKind
from tests.support.driver_contract import DriverContract, Rig
from tests.support.plant.served_plant import ServedPlant
from tests.support.servos import dxl_rig
from tests.support.servos.patience import be_patient


def _simulated(directory: Path, *, lockstep: bool) -> Iterator[Rig]:
    with ServedPlant(directory, names=("left",), lockstep=lockstep) as served:
        driver = served.driver()
        joints = served.spec.arms[0].controlled
        yield Rig(driver, lambda: driver.clock, joints, np.full(3, 0.1), served.driver, served.stop)


@contextlib.contextmanager
def simulated_in_lockstep(directory: Path) -> Iterator[Rig]:
    yield from _simulated(directory, lockstep=True)


@contextlib.contextmanager
def simulated_in_real_time(directory: Path) -> Iterator[Rig]:
    yield from _simulated(directory, lockstep=False)


@contextlib.contextmanager
def dynamixel_in_virtual_time(directory: Path) -> Iterator[Rig]:
    rig = dxl_rig.build(dxl_rig.PLANAR)
    joints = tuple(joint.name for joint in rig.arm.controlled)
    go_dark = functools.partial(rig.fault, FaultKind.SILENT)
    yield Rig(rig.driver, lambda: rig.clock, joints, np.full(3, 0.1), lambda: dxl_rig.driver_on(rig), go_dark)


@contextlib.contextmanager
def dynamixel_on_emulated_servos(directory: Path) -> Iterator[Rig]:
    with dxl_rig.ServedArm(directory) as served:
        driver = served.driver()
        joints = tuple(joint.name for joint in served.arm.controlled)

        def go_dark() -> None:
            served.fault('{"kind": "silent", "arm": "left"}')
            bus.REPLY_WAIT_NS = 2_000_000  # until the end of the test: nothing comes however long one waits

        yield Rig(driver, MonotonicClock, joints, np.full(3, 0.1), served.driver, go_dark)
        driver.close()


REAL_PORT = "emulated servos, real port"
IMPLEMENTATIONS: dict[str, Callable[[Path], AbstractContextManager[Rig]]] = {
    "simulated plant, lockstep": simulated_in_lockstep,
    "simulated plant, real time": simulated_in_real_time,
    "emulated servos, virtual time": dynamixel_in_virtual_time,
    REAL_PORT: dynamixel_on_emulated_servos,
}


class TestContract(DriverContract):
    @pytest.fixture(params=IMPLEMENTATIONS)
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
        if request.param == REAL_PORT:
            be_patient(monkeypatch)
        with IMPLEMENTATIONS[request.param](tmp_path) as made:
            yield made
