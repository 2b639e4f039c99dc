"""The servo's own controllers: from goal registers and the horn's state to a torque on the horn.

Everything here is in the servo's reported direction (Drive Mode reverse already applied by the caller).  Gains and
structure: ROBOTIS e-manual, Velocity PI Gain and Position PID Gain, whose integrals and differences are taken per
millisecond.  Feedforward gains are stored but have no effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from drivers.dynamixel.servo.codes import DriveMode, OperatingMode
from drivers.dynamixel.servo.counts import (
    ACCELERATION_UNIT_RAD_PER_S2,
    PWM_UNIT_DUTY,
    TICK_RAD,
    VELOCITY_UNIT_RAD_PER_S,
)
from sim_backend.wire.motor import Motor
from sim_backend.wire.profile import Profile

VELOCITY_UNIT_TICK_PER_S = VELOCITY_UNIT_RAD_PER_S / TICK_RAD
ACCELERATION_UNIT_TICK_PER_S2 = ACCELERATION_UNIT_RAD_PER_S2 / TICK_RAD
LOOP_S = 0.001  # period of the servo's loop that the gain conversions are taken to mean; assumption
# Damping of current-based position mode, share of the motor's own back-EMF braking; assumption: the manual gives no
# gains for this mode, and with P alone it would ring, which real servos do not
CURRENT_MODE_DAMPING = 0.5

_NORMAL = DriveMode(0)
POSITION_MODES = frozenset(
    {OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION, OperatingMode.CURRENT_BASED_POSITION}
)


class Stop(Enum):
    """What a servo without position or velocity control does when its watchdog fires; the manual leaves it open."""

    LIMP = "limp"  # winding open
    BRAKE = "brake"  # winding shorted
    HOLD = "hold"  # position control at the place where it fired


@dataclass(slots=True)
class Goals:
    """What the controllers need of the registers, in register counts."""

    mode: OperatingMode = OperatingMode.POSITION
    drive_mode: DriveMode = _NORMAL
    pwm: int = 0
    pwm_limit: int = 885
    current: int = 0
    current_limit: int = 0
    velocity: int = 0
    position: int = 0
    profile_velocity: int = 0
    profile_acceleration: int = 0
    velocity_i: int = 0
    velocity_p: int = 0
    position_d: int = 0
    position_i: int = 0
    position_p: int = 0


class Drive:
    """Controllers of one servo and what they remember."""

    def __init__(self, motor: Motor, current_unit_A: float | None) -> None:
        self.motor = motor
        self.goals = Goals()
        self.torque_on = False
        self.stop: Stop | None = None  # set while the watchdog's stop is in force
        self.hold_tick = 0.0
        self.profile = Profile.step(0.0)
        self.velocity_ref = 0.0  # 0.229 rev/min
        self._since_s = 0.0
        self._integral = 0.0
        self._current_unit_A = current_unit_A

    def restart(self, position_tick: float) -> None:
        """Forget integrals and trajectories; the servo stands at `position_tick`."""
        self.profile = Profile.step(position_tick)
        self.hold_tick = position_tick
        self.velocity_ref = 0.0
        self._since_s = 0.0
        self._integral = 0.0

    def new_goal_position(self) -> None:
        """Plan the way to the goal just written, from where the trajectory is now."""
        goals = self.goals
        start, _ = self.profile.sample(self._since_s)
        if goals.drive_mode & DriveMode.TIME_BASED_PROFILE:
            self.profile = Profile.by_time(
                start, goals.position, goals.profile_velocity * 1e-3, goals.profile_acceleration * 1e-3
            )
        else:
            self.profile = Profile.by_velocity(
                start,
                goals.position,
                goals.profile_velocity * VELOCITY_UNIT_TICK_PER_S,
                goals.profile_acceleration * ACCELERATION_UNIT_TICK_PER_S2,
            )
        self._since_s = 0.0

    def trajectory(self) -> tuple[float, float]:
        """Position (tick) and velocity (tick/s) the profile asks for now."""
        return self.profile.sample(self._since_s)

    @property
    def profile_ongoing(self) -> bool:
        """True while the trajectory has not reached its goal."""
        return self._since_s < self.profile.total_s

    def step(self, dt_s: float, position_tick: Callable[[], float], velocity_rad_per_s: float, supply_V: float) -> None:
        """Run the controllers for `dt_s` and leave current and duty in the motor; some ask for the position."""
        self._since_s += dt_s
        motor, goals = self.motor, self.goals
        if not self.torque_on or supply_V <= 0.0:
            motor.open()
        elif self.stop is not None:
            self._stopped(dt_s, position_tick(), velocity_rad_per_s, supply_V)
        elif goals.mode is OperatingMode.CURRENT:
            self._current(goals.current, supply_V, velocity_rad_per_s)
        elif goals.mode is OperatingMode.PWM:
            motor.drive_duty(self._duty(goals.pwm), supply_V, velocity_rad_per_s)
        elif goals.mode is OperatingMode.VELOCITY:
            self._velocity(dt_s, goals.velocity, supply_V, velocity_rad_per_s)
        else:
            target, _ = self.profile.sample(self._since_s)
            self._position(dt_s, target, position_tick(), velocity_rad_per_s, supply_V)
        motor.heat(dt_s)

    def _duty(self, pwm: float) -> float:
        limit = self.goals.pwm_limit
        return max(-limit, min(limit, pwm)) * PWM_UNIT_DUTY

    def _duty_cap(self) -> float:
        """Goal PWM bounds the voltage in every mode but its own."""
        return abs(self._duty(self.goals.pwm))

    def _current(self, counts: float, supply_V: float, velocity_rad_per_s: float) -> None:
        limit = self.goals.current_limit
        wanted_A = max(-limit, min(limit, counts)) * (self._current_unit_A or 0.0)
        self.motor.drive_current(wanted_A, self._duty_cap(), supply_V, velocity_rad_per_s)

    def _velocity(self, dt_s: float, goal: float, supply_V: float, velocity_rad_per_s: float) -> None:
        goals = self.goals
        if goals.profile_acceleration and self.stop is None:
            step = goals.profile_acceleration * ACCELERATION_UNIT_TICK_PER_S2 / VELOCITY_UNIT_TICK_PER_S * dt_s
            self.velocity_ref += max(-step, min(step, goal - self.velocity_ref))
        else:
            self.velocity_ref = goal
        error = self.velocity_ref - velocity_rad_per_s / VELOCITY_UNIT_RAD_PER_S
        cap = self._duty_cap() / PWM_UNIT_DUTY
        self._integrate(error * goals.velocity_i / 65536.0, dt_s, cap)
        pwm = goals.velocity_p / 128.0 * error + self._integral
        self.motor.drive_duty(self._duty(max(-cap, min(cap, pwm))), supply_V, velocity_rad_per_s)

    def _position(
        self, dt_s: float, target: float, position_tick: float, velocity_rad_per_s: float, supply_V: float
    ) -> None:
        goals = self.goals
        by_current = goals.mode is OperatingMode.CURRENT_BASED_POSITION
        cap = float(min(abs(goals.current), goals.current_limit)) if by_current else self._duty_cap() / PWM_UNIT_DUTY
        error = target - position_tick
        self._integrate(error * goals.position_i / 65536.0, dt_s, cap)
        output = goals.position_p / 128.0 * error + self._integral
        output -= goals.position_d / 16.0 * velocity_rad_per_s / TICK_RAD * LOOP_S
        if by_current and self._current_unit_A:
            data = self.motor.data
            braking_A = CURRENT_MODE_DAMPING * data.back_emf_V_s_per_rad / data.resistance_ohm * velocity_rad_per_s
            output -= braking_A / self._current_unit_A
            self._current(max(-cap, min(cap, output)), supply_V, velocity_rad_per_s)
        else:
            self.motor.drive_duty(self._duty(max(-cap, min(cap, output))), supply_V, velocity_rad_per_s)

    def _integrate(self, rate_per_loop: float, dt_s: float, cap: float) -> None:
        self._integral = max(-cap, min(cap, self._integral + rate_per_loop * dt_s / LOOP_S))

    def _stopped(self, dt_s: float, position_tick: float, velocity_rad_per_s: float, supply_V: float) -> None:
        """Do what the watchdog asks for: velocity mode stops, position modes hold, the others follow the switch."""
        mode = self.goals.mode
        if mode is OperatingMode.VELOCITY:
            self._velocity(dt_s, 0.0, supply_V, velocity_rad_per_s)
        elif mode in POSITION_MODES:
            self._position(dt_s, self.hold_tick, position_tick, velocity_rad_per_s, supply_V)
        elif self.stop is Stop.BRAKE:
            self.motor.drive_duty(0.0, supply_V, velocity_rad_per_s)
        elif self.stop is Stop.HOLD:
            self._hold(position_tick, velocity_rad_per_s, supply_V)
        else:
            self.motor.open()

    def _hold(self, position_tick: float, velocity_rad_per_s: float, supply_V: float) -> None:
        """Hold with the position gain although the goal registers say otherwise; the full supply is available."""
        pwm = self.goals.position_p / 128.0 * (self.hold_tick - position_tick)
        self.motor.drive_duty(self._duty(pwm), supply_V, velocity_rad_per_s)
