"""Which driver an arm gets: one for real servos is impatient, one for emulated servos bears a host that stalls."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import configs
from agent.around import RunSummary
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line
from agent.guard.line import GuardError
from agent.modes import Mode
from agent.process.agent import LOST_REMEDY, ArmLost
from agent.process.build import Connection, build_standby, passed_on, servo_driver
from agent.process.commands import AgentOptions
from agent.process.schedule import schedule_of
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import PortError, StaleJointsError
from drivers.dynamixel.line.ports import open_error
from drivers.dynamixel.pace import SHARE
from drivers.dynamixel.standby import StandbyDriver
from drivers.interface import Refusal
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from tests.support.servos.dxl_rig import START, VirtualClock, VirtualPort, wiring

CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml")
ARM = CELL.arm("left")
Q_START = np.array([START[name] for name in ARM.entry.controlled])
HALF_A_SECOND = 100  # cycles


def ignore(_: str) -> None: ...


@pytest.mark.parametrize(
    ("emulated", "patience", "share"), [(False, 0, SHARE), (True, HALF_A_SECOND, 4.0)], ids=["real", "emulated"]
)
def test_only_emulated_servos_may_stall_with_their_host_and_answer_slowly(
    emulated: bool, patience: int, share: float
) -> None:
    clock: Any = SimpleNamespace(now_ns=lambda: 0)
    servos = arm_map(CELL, ARM, "/dev/null", Q_START)
    driver = servo_driver(servos, Connection(emulated=emulated), clock, ignore, None)
    assert (driver.arm.line_patience_cycles, driver._read_share) == (patience, share)
    assert driver.arm.port == "/dev/null"
    guard: Any = SimpleNamespace(has_lent=False, borrow=lambda: 3)
    guarded: Any = servo_driver(servos, Connection(emulated=emulated), clock, ignore, guard)
    assert guarded._port._borrow() == 3


@pytest.mark.fault("B4")
@pytest.mark.parametrize(("has_lent", "raised"), [(False, GuardError), (True, PortError)])
def test_a_port_that_the_guard_cannot_open_again_is_one_to_try_again(has_lent: bool, raised: type[Refusal]) -> None:
    """The loop tries again for what a driver raises, and for nothing else."""
    refused = GuardError(
        "the guard refuses 'port'", found="nothing of that name", expected="a port", remedy="plug it in"
    )
    guard: Any = SimpleNamespace(has_lent=has_lent, borrow=Mock(side_effect=refused))
    clock: Any = SimpleNamespace(now_ns=lambda: 0)
    driver = servo_driver(arm_map(CELL, ARM, "/dev/null", Q_START), Connection(), clock, ignore, guard)
    with pytest.raises(Refusal) as caught:
        driver._port.open()
    assert type(caught.value) is raised
    assert str(caught.value) == str(refused)
    assert not driver._port.is_open


def test_the_driver_of_a_guard_is_as_patient_as_that_of_its_agent() -> None:
    servos = arm_map(CELL, ARM, "virtual", Q_START)
    emulated = EmulatedCell([EmulatedArm(wiring(servos))], None, start_ns=10_000_000_000)
    injector = Injector(emulated.arms[0], None, seed=1)
    clock = VirtualClock(emulated, injector)
    port: Any = VirtualPort(Line(emulated, 0, injector, clock), ARM.baud)
    driver = DynamixelDriver(servos, clock, scan_s=0.05, port=port)
    driver.connect()
    fds, told = passed_on(driver)
    assert fds == ()
    port.path = "virtual"
    for is_emulated, patience in ((False, 0), (True, HALF_A_SECOND)):
        standby = build_standby(CELL, ARM, Connection(emulated=is_emulated), port, Q_START, ignore, fds, told)
        assert isinstance(standby, StandbyDriver)
        assert standby.arm.line_patience_cycles == patience
        assert [one.values for one in standby.found] == [one.values for one in driver.found]


def test_the_schedule_of_an_agent_is_that_of_its_cell_and_of_how_it_is_started() -> None:
    """Half a second is borne of what is emulated or simulated, and 15 ms of a real arm."""
    ready = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["simulation.ready_s=1.5", "duration_s=3.0"])
    sim, real = DriverKind.SIM, DriverKind.DYNAMIXEL
    for driver, emulated, held in ((sim, False, 100), (real, True, 100), (real, False, 3)):
        for hold, lockstep in ((True, False), (False, True)):
            options = AgentOptions(
                cell=Path(), arm="left", driver=driver, emulated=emulated, ring=Path(), control=None, hold=hold
            )
            found = schedule_of(ready, hold=options.hold, shared=options.shared, lockstep=lockstep)
            assert (found.period_ns, found.ticks, found.ready_ns) == (5_000_000, 600, 1_500_000_000)
            assert (found.hold_at_end, found.lockstep, found.patience.hold) == (hold, lockstep, held)


def ended(mode: Mode) -> RunSummary:
    return RunSummary(ticks=3, late_cycles=0, stale_cycles=1, mode=mode, reason="servo 4 is silent", tracked_s=0.0)


def test_an_arm_is_lost_where_its_run_ended_in_a_fault_and_nowhere_else() -> None:
    for mode in set(Mode) - {Mode.FAULT}:
        assert ArmLost.check("left", ended(mode)) == ended(mode)
    for session, remedy in ((False, "see the log"), (True, LOST_REMEDY)):
        with pytest.raises(ArmLost, match="arm left: found servo 4 is silent") as lost:
            ArmLost.check("left", ended(Mode.FAULT), session=session)
        assert (lost.value.exit_code, lost.value.remedy) == (5, remedy)
    silent = StaleJointsError(joints=["elbow"], servo_ids=[4], partial=None, reason="no reply")
    for session, remedy in ((False, silent.remedy), (True, LOST_REMEDY)):
        with pytest.raises(ArmLost) as lost:
            ArmLost.check("left", replace(ended(Mode.FAULT), reason=str(silent), lost=silent), session=session)
        said = "arm left: found joint state: no reply from servo 4 (joint elbow), expected a fresh value of every joint"
        assert str(lost.value) == f"{said} in this cycle; {remedy}"
    port = open_error("/dev/left", FileNotFoundError(errno.ENOENT, "No such file or directory"))
    assert port.remedy.startswith("plug in the adapter; ports here: ")
    way = f"support it, and the object if it holds it, lead the others back; {port.remedy}; then fold it into its rest"
    for session, remedy in ((False, port.remedy), (True, f"{way} by hand and start its agent again")):
        with pytest.raises(ArmLost) as lost:
            ArmLost.check("left", replace(ended(Mode.FAULT), reason=str(port), lost=port), session=session)
        said = "arm left: found port /dev/left: nothing of that name, expected a serial port"
        assert str(lost.value) == f"{said}; {remedy}", "no supply is missing"
    with pytest.raises(
        ArmLost, match="arm left: found servo 4 is silent, expected a fresh state"
    ):  # for another reason
        ArmLost.check("left", replace(ended(Mode.FAULT), lost=silent))
    with pytest.raises(ArmLost, match="see the log"):
        ArmLost.check("left", ended(Mode.FAULT))
