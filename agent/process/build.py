"""One arm from the cell file: the driver that moves it, beside what determines its torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from agent.config.agent import HOLD_RATE_MAX_RAD_PER_S, build_agent
from agent.config.cell import Arm, Cell
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.guard.guarded import Guarded
from agent.guard.line import GuardError
from agent.guard.pulse import SHARED_S
from agent.process.commands import AgentOptions, Connection, ServoLine
from agent.process.rehearse import bridge, in_the_loop
from agent.telemetry.ring.writer import RingWriter
from drivers.clock import MonotonicClock
from drivers.dynamixel.arm_map import WATCHDOG_S, ArmMap
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import PortError
from drivers.dynamixel.events import DriverEvent, EventSink
from drivers.dynamixel.line.port import SerialPort
from drivers.dynamixel.pace import SHARE as READ_SHARE
from drivers.dynamixel.standby import Handover, StandbyDriver
from drivers.interface import Clock, ConnectError, Driver, Vector
from sim_backend.hil.driver import BridgeDriver
from sim_backend.hil.guest import ServedTwin
from sim_backend.served.driver import SimDriver
from sim_backend.served.standby import SimStandby

__all__ = [
    "HOLD_RATE_MAX_RAD_PER_S",
    "Connection",
    "Standby",
    "build_agent",
    "build_driver",
    "build_standby",
    "in_words",
    "passed_on",
    "patient",
    "port_of",
    "servo_driver",
]

Standby = StandbyDriver | SimStandby
EMULATED_READ_SHARE = 4.0


def build_driver(
    cell: Cell,
    arm: Arm,
    kind: DriverKind,
    connection: Connection,
    q_start: Vector,
    warn: Callable[[str], None],
    guard: Guarded | None = None,
) -> tuple[Driver, Clock]:
    """Driver of the arm and its clock; warn is told what the driver notices.  Raises ConnectError.

    guard: lends the serial port, and is told before the driver takes longer than a cycle.
    """
    if kind is DriverKind.SIM:
        if connection.plant_socket is None:
            raise ConnectError(
                f"driver of arm {arm.name}", found="no plant socket", expected="the socket of the cell's plant",
                remedy="give --plant-socket",
            )  # fmt: skip
        joints = tuple(arm.entry.controlled)
        lockstep = connection.lockstep if isinstance(connection, AgentOptions) else None
        sim = SimDriver(connection.plant_socket, arm.name, joints, cell.config_id, lockstep=lockstep)
        return sim, sim.clock
    rehearses = in_the_loop(cell, arm.name)
    if rehearses and connection.plant_socket is None:
        raise ConnectError(
            f"twin of arm {arm.name}", found="no plant socket", expected="the socket of the cell's plant",
            remedy="give --plant-socket",
        )  # fmt: skip
    clock = MonotonicClock(connection.utc_offset_ns)
    driver = servo_driver(arm_map(cell, arm, port_of(arm, connection), q_start), connection, clock, warn, guard)
    if not rehearses or connection.plant_socket is None:
        return driver, clock
    joints = tuple(arm.entry.controlled)
    twin = ServedTwin(connection.plant_socket, arm.name, joints, cell.config_id, WATCHDOG_S)
    return bridge(cell, arm, driver, twin, clock, emulated=connection.emulated), clock


def servo_driver(
    servos: ArmMap, line: ServoLine, clock: Clock, warn: Callable[[str], None], guard: Guarded | None
) -> DynamixelDriver:
    """Driver of these servos, real or emulated; arguments as of `build_driver`."""
    servos = patient(servos, line)
    port = SerialPort(servos.port, servos.baud, clock, partial(_borrowed, guard) if guard else None)
    # emulated servos share the processor with everything else: a slow read there says nothing of a bus
    share = EMULATED_READ_SHARE if line.emulated else READ_SHARE
    return DynamixelDriver(servos, clock, on_event=in_words(warn), read_share=share, port=port)


def _borrowed(guard: Guarded) -> int:
    """Descriptor of the guard's port.  Raises GuardError; PortError for one that was lost: it may yet come back."""
    lost = guard.has_lent
    try:
        return guard.borrow()
    except GuardError as error:
        if not lost:
            raise
        raise PortError(error.what, found=error.found, expected=error.expected, remedy=error.remedy) from error


def patient(servos: ArmMap, line: ServoLine) -> ArmMap:
    """The same; emulated servos share the processor with everything else, and stop with it for a while."""
    cycles = round(SHARED_S * servos.rate_hz) if line.emulated else 0
    return replace(servos, line_patience_cycles=cycles)


def wait_no_longer(driver: Driver, ring: RingWriter, asked: Callable[[], bool]) -> None:
    """A simulated arm waits for the others and for whoever takes its rows: not where it is asked for something else.

    Nor for its rows to be taken once its plant is gone.
    """
    if isinstance(driver, SimDriver):
        sim = driver
        sim.heed(asked)
        ring.asked = lambda: asked() or sim.gone


def passed_on(driver: Driver) -> tuple[tuple[int, ...], dict[str, Any]]:
    """What a guard must have of an agent's driver with torque on: descriptors and words.

    Of an arm in the loop it is the real one: a guard holds that without its twin.
    """
    if isinstance(driver, BridgeDriver):
        driver = driver.real
    if isinstance(driver, SimDriver):
        fd, told = driver.passed_on()
        return (fd,), {"plant": told}
    assert isinstance(driver, DynamixelDriver), "there are two"
    return (), {"servos": Handover.of(driver).servos}


def build_standby(
    cell: Cell,
    arm: Arm,
    line: ServoLine,
    port: SerialPort | None,
    q_start: Vector,
    warn: Callable[[str], None],
    fds: Sequence[int],
    told: Mapping[str, Any],
) -> Standby:
    """Driver of a guard for what an agent has `passed_on`; port: as the guard has opened it, None in simulation.

    Raises AdoptError.
    """
    if port is None:
        sim = SimStandby(Path(), arm.name, tuple(arm.entry.controlled), cell.config_id)
        sim.prepare(told["plant"], fds[0])
        return sim
    servos = patient(arm_map(cell, arm, port.path, q_start), line)
    driver = StandbyDriver(servos, MonotonicClock(), on_event=in_words(warn), port=port)
    driver.prepare(Handover(tuple(told["servos"])))
    return driver


def port_of(arm: Arm, line: ServoLine) -> str:
    """Path of the arm's serial port.  Raises ConnectError where neither cell nor command line names one."""
    port = line.port or (arm.entry.dynamixel.port if arm.entry.dynamixel is not None else None)
    if port is None:
        raise ConnectError(
            f"port of arm {arm.name}", found="none in the cell file", expected="dynamixel = { port = ... }",
            remedy="add it to the arm, or give --port",
        )  # fmt: skip
    return port


def in_words(warn: Callable[[str], None]) -> EventSink:
    """Where a driver's events go: a sentence to `warn`."""

    def tell(event: DriverEvent) -> None:
        where = "" if event.servo_id is None else f" (servo {event.servo_id}, {event.joint})"
        warn(f"{event.kind.value}{where}: {event.text}")

    return tell
