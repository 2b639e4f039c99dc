"""The servo's firmware: what a register write does, what a register reads, boot, watchdog and hardware errors.

Time comes in with every call; whether a write is allowed is decided in rules.py.
Source: ROBOTIS e-manual, control table pages of the X series and MX(2.0); open questions are switches in options.py.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import (
    WATCHDOG_TRIPPED,
    DriveMode,
    HardwareError,
    OperatingMode,
    StartupConfiguration,
)
from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S, WATCHDOG_UNIT_S
from drivers.dynamixel.servo.models import ServoModel
from drivers.dynamixel.servo.table import Area, Register
from sim_backend.wire.backup import GAINS, Backup
from sim_backend.wire.body import Body
from sim_backend.wire.drive import POSITION_MODES
from sim_backend.wire.memory import Memory
from sim_backend.wire.options import GoalAtTorqueOn, ServoOptions, WatchdogFeed
from sim_backend.wire.overload import OverloadWatch
from sim_backend.wire.rules import GOALS

WATCHDOG_UNIT_NS = round(WATCHDOG_UNIT_S * 1e9)
TICK_WRAP = 32768

# the present registers lie side by side from Realtime Tick (120) to Present Temperature (146)
_PRESENT = struct.Struct("<HBBhhiiiiHB")
_PRESENT_START = table.REALTIME_TICK.address
_IN_POSITION_TICKS = 10  # assumption: the manual does not say how near "reached" is

_MIRRORED = {
    table.GOAL_PWM.name: "pwm",
    table.PWM_LIMIT.name: "pwm_limit",
    table.GOAL_CURRENT.name: "current",
    table.CURRENT_LIMIT.name: "current_limit",
    table.GOAL_VELOCITY.name: "velocity",
    table.GOAL_POSITION.name: "position",
    table.PROFILE_VELOCITY.name: "profile_velocity",
    table.PROFILE_ACCELERATION.name: "profile_acceleration",
    table.VELOCITY_I_GAIN.name: "velocity_i",
    table.VELOCITY_P_GAIN.name: "velocity_p",
    table.POSITION_D_GAIN.name: "position_d",
    table.POSITION_I_GAIN.name: "position_i",
    table.POSITION_P_GAIN.name: "position_p",
}


class Firmware:
    """Registers and what they do.  Created with power on and booted."""

    def __init__(self, model: ServoModel, version: int, options: ServoOptions) -> None:
        self.model = model
        self.version = version
        self.options = options
        self.memory = Memory(model, version)
        self.body = Body(model, options.coulomb_Nm, options.ambient_C)
        self.backup = Backup()
        self.powered = True
        self._overload = OverloadWatch(options.overload, model.stall_current_A)
        self._torque_at_ready = False
        self._ready_ns = 0
        self._boot_ns = 0
        self._last_packet_ns = 0
        self._handlers: dict[str, Callable[[int], None]] = {
            table.TORQUE_ENABLE.name: self._set_torque,
            table.OPERATING_MODE.name: self._set_mode,
        }
        self.memory.load_defaults(eeprom=True)

    # --- power and boot -------------------------------------------------------------------------------------------

    def alive(self, now_ns: int) -> bool:
        """True when the servo has power and has finished booting."""
        return self.powered and now_ns >= self._ready_ns

    def power(self, on: bool, now_ns: int) -> None:
        """Switch the supply; coming back is a boot."""
        if on and not self.powered:
            self.boot(now_ns)
        self.powered = on

    def boot(self, now_ns: int) -> None:
        """Restart as Startup Configuration says, position within one turn, silent for the boot time."""
        self.start(now_ns, now_ns + self.options.boot_ns)

    def start(self, boot_ns: int, ready_ns: int) -> None:
        """Bring RAM and controllers to their state after a boot; the servo answers from `ready_ns` on."""
        memory = self.memory
        memory.load_defaults(eeprom=False)
        memory.put(table.MODEL_NUMBER, self.model.model_number)
        memory.put(table.FIRMWARE_VERSION, self.version)
        startup = StartupConfiguration(memory.bytes[table.STARTUP_CONFIGURATION.address])
        if startup & StartupConfiguration.RAM_RESTORE:
            self.backup.restore(memory, Area.RAM)
        if memory.has(table.BACKUP_READY):
            memory.put(table.BACKUP_READY, self.backup.ready)
        self._boot_ns, self._ready_ns, self._last_packet_ns = boot_ns, ready_ns, boot_ns
        self._torque_at_ready = bool(startup & StartupConfiguration.TORQUE_ON)
        self._overload.reset()
        self.body.drive.torque_on = False
        self.reload()
        self._goals_to_limits()

    def reload(self) -> None:
        """Take over every register, as after a boot or a restored backup."""
        body, memory, goals = self.body, self.memory, self.body.drive.goals
        goals.mode = OperatingMode(memory.get(table.OPERATING_MODE))
        body.set_drive_mode(self._drive_mode())
        body.homing_ticks = memory.get(table.HOMING_OFFSET)
        for name, attribute in _MIRRORED.items():
            register = memory.layout.by_name.get(name)
            if register is not None:
                setattr(goals, attribute, memory.get(register))
        body.reset_turns()
        self.stand()

    # --- register writes ------------------------------------------------------------------------------------------

    def accept(self, register: Register, value: int) -> None:
        """Write a register and do what it does; the write has been checked."""
        name = register.name
        self.memory.put(register, value)
        attribute = _MIRRORED.get(name)
        if attribute is not None:
            setattr(self.body.drive.goals, attribute, value)
            if name in GOALS:
                self._new_goal(name)
            return
        handler = self._handlers.get(name)
        if handler is not None:
            handler(value)
        elif register.address == table.DRIVE_MODE.address or register.address == table.HOMING_OFFSET.address:
            self._set_frame()

    def set_and_mirror(self, generic: Register, value: int) -> None:
        """Set a register of the firmware's own accord, where the model has it."""
        if self.memory.has(generic):
            self.memory.put(generic, value)
            attribute = _MIRRORED.get(generic.name)
            if attribute is not None:
                setattr(self.body.drive.goals, attribute, value)

    def _new_goal(self, name: str) -> None:
        drive = self.body.drive
        drive.stop = None  # the watchdog's stop lasts until the next goal
        if not drive.torque_on and drive.goals.drive_mode & DriveMode.TORQUE_ON_BY_GOAL_UPDATE:
            goal = drive.goals.position
            self.accept(table.TORQUE_ENABLE, 1)
            self.set_and_mirror(table.GOAL_POSITION, goal)
        if name == table.GOAL_POSITION.name:
            drive.new_goal_position()

    def _set_torque(self, value: int) -> None:
        drive, body = self.body.drive, self.body
        if value and self.hardware_error & self.memory.get(table.SHUTDOWN):
            # after a shutdown only a boot gives torque back; the status packet carries the alert bit
            self.memory.put(table.TORQUE_ENABLE, 0)
            return
        turning_on = bool(value) and not drive.torque_on
        drive.torque_on = bool(value)
        if not turning_on:
            return
        if drive.goals.mode is OperatingMode.POSITION:
            body.reset_turns()
        goal = drive.goals.position
        stopped = drive.stop
        self.stand()
        drive.stop = stopped if self.tripped else None
        if self.options.goal_at_torque_on is GoalAtTorqueOn.KEPT and drive.goals.mode in POSITION_MODES:
            self.set_and_mirror(table.GOAL_POSITION, goal)
            drive.new_goal_position()

    def _set_mode(self, value: int) -> None:
        """Operating Mode: goals go to their limits, gains and profile to their defaults."""
        self.body.drive.goals.mode = OperatingMode(value)
        self._goals_to_limits()
        for register in GAINS:
            self.set_and_mirror(register, self.memory.version(register).default or 0)
        self.set_and_mirror(table.PROFILE_ACCELERATION, 0)
        self.set_and_mirror(table.PROFILE_VELOCITY, 0)
        if value == OperatingMode.POSITION:
            self.body.reset_turns()
        self.stand()

    def _set_frame(self) -> None:
        """Drive Mode or Homing Offset changed what a position means."""
        self.body.set_drive_mode(self._drive_mode())
        self.body.homing_ticks = self.memory.get(table.HOMING_OFFSET)
        self.body.reset_turns()
        self.stand()

    def _drive_mode(self) -> DriveMode:
        """Drive Mode register; firmware without it knows the normal direction only."""
        return DriveMode(self.memory.get(table.DRIVE_MODE) if self.memory.has(table.DRIVE_MODE) else 0)

    def _goals_to_limits(self) -> None:
        self.set_and_mirror(table.GOAL_PWM, self.memory.get(table.PWM_LIMIT))
        if self.memory.has(table.CURRENT_LIMIT):
            self.set_and_mirror(table.GOAL_CURRENT, self.memory.get(table.CURRENT_LIMIT))
        self.set_and_mirror(table.GOAL_VELOCITY, 0)

    def stand(self) -> None:
        """The goal position is where the servo stands; nothing is remembered."""
        tick = self.body.position_tick()
        self.set_and_mirror(table.GOAL_POSITION, tick)
        self.body.drive.restart(tick)

    # --- hardware errors and watchdog -----------------------------------------------------------------------------

    @property
    def hardware_error(self) -> int:
        """Hardware Error Status."""
        return self.memory.bytes[table.HARDWARE_ERROR_STATUS.address]

    def raise_error(self, error: HardwareError) -> None:
        """Latch a hardware error; torque goes off when Shutdown lists it.  Only a boot clears it."""
        status = self.hardware_error | error
        self.memory.put(table.HARDWARE_ERROR_STATUS, status)
        if status & self.memory.get(table.SHUTDOWN):
            self.memory.put(table.TORQUE_ENABLE, 0)
            self.body.drive.torque_on = False

    def supervise(self, dt_s: float) -> None:
        """Latch what a running servo notices by itself, `dt_s` after it looked last: overload, heat, supply voltage."""
        memory, body = self.memory, self.body
        if self._torque_at_ready:
            self._torque_at_ready = False
            self.accept(table.TORQUE_ENABLE, 1)
        if self._overload.step(dt_s, body.motor.current_A, body.drive.goals.mode):
            self.raise_error(HardwareError.OVERLOAD)
        if body.motor.temperature_C > memory.bytes[table.TEMPERATURE_LIMIT.address]:
            self.raise_error(HardwareError.OVERHEATING)
        decivolt = round(body.horn.supply_V * 10.0)
        if not memory.get(table.MIN_VOLTAGE_LIMIT) <= decivolt <= memory.get(table.MAX_VOLTAGE_LIMIT):
            self.raise_error(HardwareError.INPUT_VOLTAGE)

    @property
    def tripped(self) -> bool:
        """True while Bus Watchdog reads -1."""
        return self.memory.has(table.BUS_WATCHDOG) and self.memory.bytes[table.BUS_WATCHDOG.address] == 0xFF

    def heard_packet(self, now_ns: int, *, own: bool) -> None:
        """An instruction packet was on the bus."""
        if own or self.options.watchdog_feed is WatchdogFeed.ANY_PACKET:
            self._last_packet_ns = now_ns

    def check_watchdog(self, now_ns: int) -> bool:
        """Trip the bus watchdog if it is due; True when it tripped just now."""
        period = self.memory.bytes[table.BUS_WATCHDOG.address] if self.body.drive.torque_on else 0
        if not 0 < period < 0x80 or now_ns - self._last_packet_ns <= period * WATCHDOG_UNIT_NS:
            return False
        self.memory.put(table.BUS_WATCHDOG, WATCHDOG_TRIPPED)
        self.body.drive.restart(self.body.position_tick())
        self.body.drive.stop = self.options.watchdog_stop
        return True

    # --- present registers ----------------------------------------------------------------------------------------

    def moving(self) -> bool:
        """True above Moving Threshold."""
        threshold = self.memory.get(table.MOVING_THRESHOLD) * VELOCITY_UNIT_RAD_PER_S
        return abs(self.body.velocity_rad_per_s()) > threshold

    def refresh(self, now_ns: int) -> None:
        """Write the present values into their registers."""
        body, drive, motor = self.body, self.body.drive, self.body.motor
        tick = body.position_tick()
        speed = body.velocity_rad_per_s() / VELOCITY_UNIT_RAD_PER_S
        unit_A = self.model.current_unit_mA
        effort = motor.current_A * 1e3 / unit_A if unit_A else motor.duty * 1000.0
        target, rate = drive.trajectory()
        status = int(drive.profile.kind) | (2 if drive.profile_ongoing else 0)
        if drive.goals.mode in POSITION_MODES and abs(drive.goals.position - tick) <= _IN_POSITION_TICKS:
            status |= 1
        _PRESENT.pack_into(
            self.memory.bytes,
            _PRESENT_START,
            (now_ns - self._boot_ns) // 1_000_000 % TICK_WRAP,
            abs(speed) > self.memory.get(table.MOVING_THRESHOLD),
            status,
            round(motor.duty * 885.0),
            max(-32768, min(32767, round(effort))),
            round(speed),
            tick,
            round(rate * TICK_RAD / VELOCITY_UNIT_RAD_PER_S)
            if drive.goals.mode in POSITION_MODES
            else round(drive.velocity_ref),
            round(target),
            max(0, round(body.horn.supply_V * 10.0)),
            max(0, min(255, round(motor.temperature_C))),
        )
