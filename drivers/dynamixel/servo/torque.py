"""Joint torque to goal counts and back, per joint.  Pure; the count it returns is within the servo's limits.

Current mode: each servo of the joint gets I = τ/(n Kt) + I₀ tanh(dq/v₀), with n servos sharing the torque and I₀ the
current that only turns the gearbox.  I₀ is friction: use either it or the controller's friction feed-forward.

PWM mode (no current sensor): the winding sees duty·V, and the motor turning at dq takes Ke·dq of it, so
τ = n (Kt/R)(duty·V − Ke·dq), with the measured supply voltage V and speed dq.  R, Kt and Ke come from the stall and
no-load points of the data sheet, so gearbox friction is inside Kt and not compensated.
"""

from __future__ import annotations

import math
from typing import Protocol

from drivers.dynamixel.arm_map import JointMap
from drivers.dynamixel.servo.models import RATED_VOLTAGE_V
from drivers.dynamixel.servo.table import GOAL_CURRENT, GOAL_PWM, Register
from drivers.dynamixel.servo.units import current_unit_A, pwm_count_V

LEAST_SUPPLY_V = 6.0  # no servo here works below: what one reports of less is no measurement to divide by
NO_LOAD_SMOOTH_RAD_PER_S = 0.1  # well above the 0.024 rad/s the servo resolves, or I₀ would chatter at rest


class TorqueDrive(Protocol):
    """How one joint is given torque."""

    register: Register

    def command(self, tau_Nm: float, dq: float, supply_V: float) -> tuple[int, float]:
        """Goal count for a joint torque, and the torque that this count really asks for.

        tau_Nm: must be finite; dq: rad/s, as measured; supply_V: as measured.
        """
        ...

    def goal_Nm(self, count: int, dq: float, supply_V: float) -> float:
        """Joint torque that a goal count really asks for."""
        ...

    def measured_Nm(self, present: list[int], dq: float) -> float:
        """Joint torque from register 126 of the joint's servos; NaN where it says nothing about torque."""
        ...


def needed_pwm_count(joint: JointMap) -> int:
    """Share of the rated supply, in counts of PWM, that the joint's largest torque takes at rest, in every mode."""
    volts = joint.tau_max_Nm / (len(joint.ids) * joint.model.stall_torque_Nm_per_V)
    return math.ceil(volts / pwm_count_V(RATED_VOLTAGE_V))


class CurrentDrive:
    """Torque by current: XM430, XM540, MX-64(2.0) in current mode."""

    register = GOAL_CURRENT

    def __init__(self, joint: JointMap, current_limit_count: int | None = None) -> None:
        model = joint.model
        unit_A = current_unit_A(model)
        constant = joint.torque_constant_Nm_per_A or model.torque_constant_Nm_per_A
        self._servos = len(joint.ids)
        self._unit_Nm = constant * unit_A  # of one servo
        self._no_load_count = joint.no_load_current_A / unit_A
        limit = model.register(GOAL_CURRENT).maximum or 0
        self._limit_count = min(limit, current_limit_count) if current_limit_count is not None else limit
        self._tau_max_Nm = joint.tau_max_Nm

    @property
    def needed_count(self) -> int:
        """Current that the joint's largest torque takes, in counts; the servo's Current Limit must not be below."""
        return math.ceil(self._tau_max_Nm / (self._servos * self._unit_Nm) + self._no_load_count)

    def command(self, tau_Nm: float, dq: float, supply_V: float) -> tuple[int, float]:  # noqa: ARG002 the seam's
        """See `TorqueDrive`."""
        tau = max(-self._tau_max_Nm, min(self._tau_max_Nm, tau_Nm))
        per_servo = self._servos * self._unit_Nm
        no_load = self._no_load_count * math.tanh(dq / NO_LOAD_SMOOTH_RAD_PER_S) if self._no_load_count else 0.0
        count = round(tau / per_servo + no_load)
        count = max(-self._limit_count, min(self._limit_count, count))
        return count, (count - no_load) * per_servo

    def goal_Nm(self, count: int, dq: float, supply_V: float) -> float:  # noqa: ARG002 the seam's
        """See `TorqueDrive`."""
        return self.measured_Nm([count] * self._servos, dq)

    def measured_Nm(self, present: list[int], dq: float) -> float:
        """See `TorqueDrive`."""
        no_load = self._no_load_count * math.tanh(dq / NO_LOAD_SMOOTH_RAD_PER_S) if self._no_load_count else 0.0
        return (sum(present) - len(present) * no_load) * self._unit_Nm


class PwmDrive:
    """Torque by voltage with the back-EMF compensated: XL430, MX-28(2.0) in PWM mode."""

    register = GOAL_PWM

    def __init__(self, joint: JointMap, pwm_limit_count: int | None = None) -> None:
        model = joint.model
        self._servos = len(joint.ids)
        self._per_volt_Nm = model.stall_torque_Nm_per_V  # Kt/R
        self._back_emf_V_s_per_rad = model.back_emf_V_s_per_rad  # Ke
        self._tau_max_Nm = joint.tau_max_Nm
        limit = model.register(GOAL_PWM).maximum or 0
        self._limit_count = min(limit, pwm_limit_count) if pwm_limit_count is not None else limit

    def command(self, tau_Nm: float, dq: float, supply_V: float) -> tuple[int, float]:
        """See `TorqueDrive`."""
        tau = max(-self._tau_max_Nm, min(self._tau_max_Nm, tau_Nm))
        per_volt = self._servos * self._per_volt_Nm
        wanted_V = tau / per_volt + self._back_emf_V_s_per_rad * dq
        count_V = pwm_count_V(max(supply_V, LEAST_SUPPLY_V))
        count = max(-self._limit_count, min(self._limit_count, round(wanted_V / count_V)))
        return count, (count * count_V - self._back_emf_V_s_per_rad * dq) * per_volt

    def goal_Nm(self, count: int, dq: float, supply_V: float) -> float:
        """See `TorqueDrive`."""
        back_emf_V = self._back_emf_V_s_per_rad * dq
        return (count * pwm_count_V(max(supply_V, LEAST_SUPPLY_V)) - back_emf_V) * self._servos * self._per_volt_Nm

    def measured_Nm(self, present: list[int], dq: float) -> float:  # noqa: ARG002 the seam's
        """NaN: Present Load is the servo's own guess, not a torque."""
        return math.nan


def torque_drive(joint: JointMap, limit_count: int | None = None) -> TorqueDrive:
    """Drive of a controlled joint; limit_count: its servo's Current Limit or PWM Limit register, if it is lower."""
    if joint.model.has_current_mode:
        return CurrentDrive(joint, limit_count)
    return PwmDrive(joint, limit_count)
