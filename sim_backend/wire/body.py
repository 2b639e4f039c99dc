"""The mechanical and electrical half of a servo: horn, encoder, winding and inner controllers.

The firmware tells it modes and goals; registers and instructions are outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.dynamixel.servo.codes import DriveMode, OperatingMode
from drivers.dynamixel.servo.counts import TICK_CENTRE, TICK_RAD, TICKS_PER_TURN
from drivers.dynamixel.servo.models import ServoModel
from sim_backend.wire.drive import Drive
from sim_backend.wire.motor import Motor, MotorData

HOMING_IN_POSITION_MODE = 1024  # a larger Homing Offset is ignored in position mode


@dataclass(slots=True)
class Horn:
    """What the servo feels of the world, in the direction of its case: CCW positive, 0 rad at tick 2048."""

    position_rad: float = 0.0
    velocity_rad_per_s: float = 0.0
    supply_V: float = 12.0


class Body:
    """Horn, encoder, winding.  Positions and velocities it reports have Drive Mode reverse applied."""

    def __init__(self, model: ServoModel, coulomb_Nm: float, ambient_C: float) -> None:
        self.horn = Horn()
        self.motor = Motor(MotorData.of(model, coulomb_Nm))
        self.motor.ambient_C = self.motor.temperature_C = ambient_C
        self.drive = Drive(self.motor, model.current_unit_mA * 1e-3 if model.current_unit_mA else None)
        self.sign = 1  # -1 when Drive Mode reverses the direction
        self.homing_ticks = 0
        self.encoder_offset_ticks = 0  # fault: wrong by this much
        self._stuck_tick: int | None = None  # fault: frozen here
        self._turns = 0

    def set_drive_mode(self, mode: DriveMode) -> None:
        """Take over Drive Mode."""
        self.drive.goals.drive_mode = mode
        self.sign = -1 if mode & DriveMode.REVERSE else 1

    def position_tick(self) -> int:
        """Present Position: actual position plus Homing Offset, multi-turn since the last reset."""
        homing = self.homing_ticks
        if self.drive.goals.mode is OperatingMode.POSITION and abs(homing) > HOMING_IN_POSITION_MODE:
            homing = 0
        return self.sign * self._raw_tick() - TICKS_PER_TURN * self._turns + homing

    def velocity_rad_per_s(self) -> float:
        """Velocity as the servo sees it."""
        return 0.0 if self._stuck_tick is not None else self.sign * self.horn.velocity_rad_per_s

    def reset_turns(self) -> None:
        """Bring the position back to its absolute value within one turn."""
        self._turns = math.floor(self.sign * self._raw_tick() / TICKS_PER_TURN)

    def freeze_encoder(self, frozen: bool) -> None:
        """Fault: the encoder keeps its present reading, or works again."""
        self._stuck_tick = self._raw_tick() if frozen else None

    def step(self, dt_s: float, *, alive: bool) -> float:
        """Run for `dt_s`; return the torque on the horn, N*m, in the direction of the case."""
        horn, sign = self.horn, self.sign
        velocity = sign * horn.velocity_rad_per_s
        if alive:
            self.drive.step(dt_s, self.position_tick, velocity, horn.supply_V)
        else:
            self.motor.open()
            self.motor.heat(dt_s)
        return sign * self.motor.torque_Nm(velocity)

    def _raw_tick(self) -> int:
        if self._stuck_tick is not None:
            return self._stuck_tick
        return round(self.horn.position_rad / TICK_RAD) + TICK_CENTRE + self.encoder_offset_ticks
