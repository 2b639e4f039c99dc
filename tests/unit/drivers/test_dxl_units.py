"""Counts become SI units in one module, and in the right proportion."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.servo import units
from drivers.dynamixel.servo.models import SERVOS

ROOT = Path(__file__).parents[3]
ROOMS = ("drivers", "agent/motors", "agent/doctor")
HOMES = ("counts.py", "models.py", "units.py")  # the figures, which servo has which, and where they are applied
FACTORS = {
    "TICK_RAD", "AX_TICK_RAD", "VELOCITY_UNIT_RAD_PER_S", "ACCELERATION_UNIT_RAD_PER_S2", "PWM_UNIT_DUTY",
    "LOAD_UNIT_DUTY", "VOLTAGE_UNIT_V", "WATCHDOG_UNIT_S", "RETURN_DELAY_UNIT_S", "X_CURRENT_UNIT_MA",
    "MX_CURRENT_UNIT_MA", "current_unit_mA", "tick_rad",
}  # fmt: skip


def factors_in(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute):
            names.add(node.attr)
    return names & FACTORS


def test_no_other_module_of_driver_tools_and_doctor_applies_a_unit_factor() -> None:
    files = [file for room in ROOMS for file in (ROOT / room).rglob("*.py") if file.name not in HOMES]
    assert len(files) > 30
    assert {str(file): names for file in files if (names := factors_in(file))} == {}
    assert factors_in(ROOT / "drivers/dynamixel/servo/units.py") >= {"VOLTAGE_UNIT_V", "TICK_RAD"}


def test_counts_are_what_the_manual_says() -> None:
    assert units.ticks_rad(4096) == pytest.approx(2.0 * math.pi)
    assert units.velocity_rad_per_s(100) == pytest.approx(22.9 * 2.0 * math.pi / 60.0)
    assert units.volts(121) == pytest.approx(12.1)
    assert units.pwm_count_V(12.0) * 885 == pytest.approx(12.0)
    assert units.watchdog_s(10) == pytest.approx(0.2)
    assert units.return_delay_s(250) == pytest.approx(500e-6)
    assert units.current_unit_A(SERVOS["XM430-W350"]) == pytest.approx(2.69e-3)


@given(st.integers(0, 127))
def test_a_watchdog_time_is_its_count_again(count: int) -> None:
    assert units.watchdog_count(units.watchdog_s(count)) == count


@given(st.floats(0.0, 10.0))
def test_a_speed_s_count_is_the_largest_below_it(speed: float) -> None:
    count = units.velocity_count(speed)
    assert units.velocity_rad_per_s(count) <= speed + 1e-12
    assert units.velocity_rad_per_s(count + 1) > speed - 1e-12


def test_a_servo_says_its_current_or_its_load_and_not_the_other() -> None:
    with_current = next(model for model in SERVOS.values() if model.current_unit_mA is not None)
    without = next(model for model in SERVOS.values() if model.current_unit_mA is None)
    current, nothing = units.current_or_load(with_current, -100.0)
    assert current == pytest.approx(-0.1 * with_current.current_unit_mA)
    assert math.isnan(nothing)
    nothing, load = units.current_or_load(without, -250.0)
    assert math.isnan(nothing)
    assert load == pytest.approx(-0.25)
