"""Counts become SI units in one module, and in the right proportion."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.arm_map import JointMap
from drivers.dynamixel.servo import counts, units
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


@pytest.mark.parametrize(
    ("found", "manual"),
    [
        (counts.TICKS_PER_TURN, 4096),
        (counts.TICK_CENTRE, 2048),
        (math.degrees(counts.TICK_RAD), 0.087890625),  # 360° in 4096
        (math.degrees(counts.AX_TICK_RAD), 0.29296875),  # 300° in 1024
        (counts.VELOCITY_UNIT_RAD_PER_S / (2.0 * math.pi) * 60.0, 0.229),  # rev/min
        (counts.ACCELERATION_UNIT_RAD_PER_S2 / (2.0 * math.pi) * 60.0**2, 214.577),  # rev/min²
        (counts.PWM_UNIT_DUTY * 885, 1.0),
        (counts.LOAD_UNIT_DUTY * 1000, 1.0),
        (counts.VOLTAGE_UNIT_V, 0.1),
        (counts.WATCHDOG_UNIT_S, 0.02),
        (counts.RETURN_DELAY_UNIT_S, 2e-6),
        (counts.X_CURRENT_UNIT_MA, 2.69),
        (counts.MX_CURRENT_UNIT_MA, 3.36),
    ],
)
def test_a_count_is_the_unit_of_the_manual(found: float, manual: float) -> None:
    assert found == pytest.approx(manual, rel=1e-12)


@pytest.mark.parametrize(("low", "high", "first"), [(819, 3333, 29), (910, 3447, 131), (0, 4095, 0)])
def test_an_angle_is_that_within_the_turn_around_the_joint_s_range(low: int, high: int, first: int) -> None:
    """As much room below the range as above it, to a tick; whole turns in the count change nothing."""
    joint = JointMap("elbow", "XM430-W350", (4,), (False,), 2000, (low, high))
    scale = units.AngleScale(joint)
    for tick in (first, low, high, first + 4095):
        for turns in (-3, 0, 1):
            assert scale.angle_rad(tick + 4096 * turns) == pytest.approx((tick - 2000) * 2.0 * math.pi / 4096)
    assert scale.limits_rad == pytest.approx(tuple((end - 2000) * 2.0 * math.pi / 4096 for end in (low, high)))


def test_an_angle_s_ticks_are_the_nearest() -> None:
    assert [units.angle_ticks(share * counts.TICK_RAD) for share in (0.4, 0.6, -1.6, 1024.0)] == [0, 1, -2, 1024]


def test_a_servo_that_senses_no_current_has_no_unit_of_it() -> None:
    with pytest.raises(ValueError, match="XL430-W250 senses no current"):
        units.current_unit_A(SERVOS["XL430-W250"])


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
