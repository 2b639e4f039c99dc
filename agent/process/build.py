"""One arm from the cell file: the driver that moves it, beside what determines its torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agent.config.agent import HOLD_RATE_MAX_RAD_PER_S, build_agent
from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.config.servo_map import arm_map
from agent.process.rehearse import bridge, in_the_loop
from drivers.clock import MonotonicClock
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.events import DriverEvent
from drivers.dynamixel.pace import SHARE as READ_SHARE
from drivers.interface import Clock, ConnectError, Driver, Vector
from sim_backend.hil.guest import ServedTwin
from sim_backend.served.driver import SimDriver

__all__ = ["HOLD_RATE_MAX_RAD_PER_S", "Connection", "build_agent", "build_driver"]

EMULATED_READ_SHARE = 4.0


@dataclass(frozen=True)
class Connection:
    """How an agent reaches its arm."""

    plant_socket: Path | None = None  # simulated driver, and the twin of an arm in the loop
    port: str | None = None  # Dynamixel driver; None: the port of the cell file
    emulated: bool = False  # the servos on that port are emulated: nothing can fall


def build_driver(
    cell: Cell, arm: Arm, kind: DriverKind, connection: Connection, q_start: Vector, warn: Callable[[str], None]
) -> tuple[Driver, Clock]:
    """Driver of the arm and its clock; warn is told what the driver notices.  Raises ConnectError."""
    if kind is DriverKind.SIM:
        if connection.plant_socket is None:
            raise ConnectError(
                f"driver of arm {arm.name}", found="no plant socket", expected="the socket of the cell's plant",
                remedy="give --plant-socket",
            )  # fmt: skip
        sim = SimDriver(connection.plant_socket, arm.name, tuple(arm.entry.controlled), cell.config_id)
        return sim, sim.clock
    port = connection.port or (arm.entry.dynamixel.port if arm.entry.dynamixel is not None else None)
    if port is None:
        raise ConnectError(
            f"port of arm {arm.name}", found="none in the cell file", expected="dynamixel = { port = ... }",
            remedy="add it to the arm, or give --port",
        )  # fmt: skip

    def tell(event: DriverEvent) -> None:
        where = "" if event.servo_id is None else f" (servo {event.servo_id}, {event.joint})"
        warn(f"{event.kind.value}{where}: {event.text}")

    clock = MonotonicClock()
    if in_the_loop(cell, arm.name) and connection.plant_socket is None:
        raise ConnectError(
            f"twin of arm {arm.name}", found="no plant socket", expected="the socket of the cell's plant",
            remedy="give --plant-socket",
        )  # fmt: skip
    # emulated servos share the processor with everything else: a slow read there says nothing of a bus
    share = EMULATED_READ_SHARE if connection.emulated else READ_SHARE
    real = DynamixelDriver(arm_map(cell, arm, port, q_start), clock, on_event=tell, read_share=share)
    if not in_the_loop(cell, arm.name) or connection.plant_socket is None:
        return real, clock
    joints = tuple(arm.entry.controlled)
    twin = ServedTwin(connection.plant_socket, arm.name, joints, cell.config_id, WATCHDOG_S)
    return bridge(cell, arm, real, twin, clock, emulated=connection.emulated), clock
