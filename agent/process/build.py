"""One arm from the cell file: what determines its torque, and the driver that moves it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agent.config import coordination, observer
from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.config.servo_map import arm_map
from agent.loop import Agent
from agent.safety import Limits
from drivers.clock import MonotonicClock
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.events import DriverEvent
from drivers.dynamixel.pace import SHARE as READ_SHARE
from drivers.interface import Clock, ConnectError, Driver, Vector
from sim_backend.served.driver import SimDriver

EMULATED_READ_SHARE = 4.0

HOLD_RATE_MAX_RAD_PER_S = 20.0


@dataclass(frozen=True)
class Connection:
    """How an agent reaches its arm."""

    plant_socket: Path | None = None  # simulated driver
    port: str | None = None  # Dynamixel driver; None: the port of the cell file
    emulated: bool = False  # the servos on that port are emulated: nothing can fall


def build_agent(cell: Cell, arm: Arm) -> Agent:
    """Everything that determines the arm's torque, from the cell file alone."""
    safety = cell.file.safety
    tau_max = arm.tau_stall_Nm * safety.tau_max_fraction_of_stall
    return Agent(
        name=arm.name,
        model=cell.model(arm),
        offline=cell.offline(arm),
        trajectory=cell.trajectory(),
        limits=Limits(tuple(tau_max.tolist()), tuple((tau_max * safety.tau_step_max_fraction).tolist())),
        observer=observer.build(cell.file),
        sigma_min=safety.sigma_min,
        error_max_m=safety.tracking_error_max_m,
        error_max_rad=safety.tracking_error_max_rad,
        period_s=1.0 / cell.file.rate_hz,
        hold_rate_rad_per_s=_hold_rate(cell),
        start=coordination.start_pose(cell),
        alignment=coordination.alignment(cell, arm),
        residual=coordination.residual(cell),
        damp_above_rad_per_s=math.inf if safety.hold_speed_max_rad_per_s is None else safety.hold_speed_max_rad_per_s,
    )


def _hold_rate(cell: Cell) -> float:
    """As stiff as keeps a third of a radian between two effective samples: settles with 30 % of inertia missing too."""
    effective_hz = cell.file.rate_hz / (1.0 + cell.file.delay_periods)
    return min(HOLD_RATE_MAX_RAD_PER_S, effective_hz / 3.0)


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
    # emulated servos share the processor with everything else: a slow read there says nothing of a bus
    share = EMULATED_READ_SHARE if connection.emulated else READ_SHARE
    return DynamixelDriver(arm_map(cell, arm, port, q_start), clock, on_event=tell, read_share=share), clock
