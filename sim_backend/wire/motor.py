"""Winding, gearbox and heat of one servo: what current flows and what torque reaches the horn.

Time comes in as a step; registers are outside.
Figures: stall and no-load points of the e-manual, through drivers.dynamixel.servo.models.  The heat path is an
assumption: at the 0.9 A that an XM430 can hold for long it settles near its limit of 80 degrees C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.dynamixel.servo.models import ServoModel

AMBIENT_C = 25.0


@dataclass(frozen=True, slots=True)
class MotorData:
    """Constants of one servo at its output shaft."""

    resistance_ohm: float
    torque_constant_Nm_per_A: float
    back_emf_V_s_per_rad: float
    coulomb_Nm: float  # gearbox friction, smoothed around standstill
    coulomb_knee_rad_per_s: float
    heat_capacity_J_per_K: float
    heat_resistance_K_per_W: float

    @classmethod
    def of(cls, model: ServoModel, coulomb_Nm: float = 0.0) -> MotorData:
        """Constants of a model; friction is zero unless given, because the plant may already have it."""
        return cls(
            resistance_ohm=model.resistance_ohm,
            torque_constant_Nm_per_A=model.torque_constant_Nm_per_A,
            back_emf_V_s_per_rad=model.back_emf_V_s_per_rad,
            coulomb_Nm=coulomb_Nm,
            coulomb_knee_rad_per_s=0.05,
            heat_capacity_J_per_K=600.0 * model.mass_kg,
            heat_resistance_K_per_W=13.0,
        )


class Motor:
    """State of one motor: current, duty and temperature of the last step."""

    def __init__(self, data: MotorData) -> None:
        self.data = data
        self.current_A = 0.0
        self.duty = 0.0
        self.temperature_C = AMBIENT_C
        self.ambient_C = AMBIENT_C

    def open(self) -> None:
        """Disconnect the winding: no current, no brake."""
        self.current_A = 0.0
        self.duty = 0.0

    def drive_duty(self, duty: float, supply_V: float, velocity_rad_per_s: float) -> None:
        """Apply a share of the supply voltage; zero shorts the winding, which brakes."""
        data = self.data
        self.duty = duty
        self.current_A = (duty * supply_V - data.back_emf_V_s_per_rad * velocity_rad_per_s) / data.resistance_ohm

    def drive_current(self, wanted_A: float, duty_max: float, supply_V: float, velocity_rad_per_s: float) -> None:
        """Regulate the current as far as the voltage left after back-EMF allows."""
        data = self.data
        if supply_V <= 0.0:
            self.open()
            return
        emf_V = data.back_emf_V_s_per_rad * velocity_rad_per_s
        wanted_V = data.resistance_ohm * wanted_A + emf_V
        limit_V = duty_max * supply_V
        applied_V = max(-limit_V, min(limit_V, wanted_V))
        self.duty = applied_V / supply_V
        self.current_A = (applied_V - emf_V) / data.resistance_ohm

    def torque_Nm(self, velocity_rad_per_s: float) -> float:
        """Torque on the horn, in the direction of positive current."""
        data = self.data
        torque = data.torque_constant_Nm_per_A * self.current_A
        if data.coulomb_Nm:
            torque -= data.coulomb_Nm * math.tanh(velocity_rad_per_s / data.coulomb_knee_rad_per_s)
        return torque

    def heat(self, dt_s: float) -> None:
        """Advance the temperature: I^2 R in, conduction to ambient out."""
        data = self.data
        loss_W = (self.temperature_C - self.ambient_C) / data.heat_resistance_K_per_W
        copper_W = self.current_A * self.current_A * data.resistance_ohm
        self.temperature_C += dt_s * (copper_W - loss_W) / data.heat_capacity_J_per_K
