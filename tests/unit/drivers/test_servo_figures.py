"""Each servo's figures against a second copy of what the e-manual prints, and which of its registers differ."""

from __future__ import annotations

import pytest

from drivers.dynamixel.servo import models, table
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.models import SERVOS

# model number, protocol, N·m and A at stall, rev/min without load (all at 12 V), kg, mA per count,
# first firmware with fast sync read and with a bus watchdog
RATINGS = {
    "XM430-W350": (1020, 2.0, 4.1, 2.3, 46.0, 0.082, 2.69, 45, 38),
    "XM540-W270": (1120, 2.0, 10.6, 4.4, 30.0, 0.165, 2.69, 45, 38),
    "XL430-W250": (1060, 2.0, 1.5, 1.4, 61.0, 0.0572, None, 45, 38),
    "XC430-W150": (1070, 2.0, 1.6, 1.4, 106.0, 0.065, None, 45, 38),
    "MX-64": (311, 2.0, 6.0, 4.1, 63.0, 0.126, 3.36, None, 38),
    "MX-28": (30, 2.0, 2.5, 1.4, 55.0, 0.072, None, None, 38),
    "AX-12A": (12, 1.0, 1.5, 1.5, 59.0, 0.0546, None, None, None),
}
# smallest and largest value and factory setting of what is not as in most models
OWN = {
    "XM430-W350": {},
    "XM540-W270": {
        "Drive Mode": (0, 15, 0), "Current Limit": (0, 2047, 2047), "Velocity Limit": (0, 1023, 128),
        "Goal Current": (-2047, 2047, None),
    },
    "XL430-W250": {
        "Temperature Limit": (0, 100, 72), "Max Voltage Limit": (60, 140, 140), "Min Voltage Limit": (60, 140, 60),
        "Velocity Limit": (0, 1023, 265), "Velocity I Gain": (0, 16383, 1000), "Position D Gain": (0, 16383, 4000),
        "Position P Gain": (0, 16383, 640),
    },
    "XC430-W150": {
        "Moving Threshold": (0, 1023, 20), "Max Voltage Limit": (60, 160, 160), "Min Voltage Limit": (60, 160, 60),
        "Velocity Limit": (0, 1023, 460), "Position P Gain": (0, 16383, 460),
    },
    "MX-64": {
        "Drive Mode": (0, 5, 0), "Current Limit": (0, 1941, 1941), "Velocity Limit": (0, 1023, 285),
        "Position P Gain": (0, 16383, 850), "Goal Current": (-1941, 1941, None),
    },
    "MX-28": {"Drive Mode": (0, 5, 0), "Velocity Limit": (0, 1023, 230), "Position P Gain": (0, 16383, 850)},
    "AX-12A": {},
}  # fmt: skip
MOST = {register.name: register for register in table.REGISTERS}


def test_every_model_has_its_figures_here() -> None:
    assert SERVOS.keys() == RATINGS.keys() == OWN.keys()


@pytest.mark.parametrize("name", RATINGS)
def test_ratings_are_those_printed(name: str) -> None:
    servo = SERVOS[name]
    assert RATINGS[name] == (
        servo.model_number, servo.protocol, servo.stall_torque_Nm, servo.stall_current_A, servo.no_load_rpm,
        servo.mass_kg, servo.current_unit_mA, servo.fast_sync_min_firmware, servo.watchdog_min_firmware,
    )  # fmt: skip


@pytest.mark.parametrize("name", OWN)
def test_registers_are_those_of_most_models_but_for_what_is_printed_otherwise(name: str) -> None:
    found = {
        register.name: (register.minimum, register.maximum, register.default)
        for register in SERVOS[name].registers.values()
        if register != MOST[register.name]
    }
    assert found == OWN[name]


@pytest.mark.parametrize(
    ("name", "firmware", "fast"), [("XL430-W250", 44, False), ("XL430-W250", 45, True), ("MX-64", 99, False)]
)
def test_fast_reads_are_answered_from_a_firmware_on_or_never(name: str, firmware: int, fast: bool) -> None:
    assert SERVOS[name].answers_fast(firmware) is fast


def test_servos_without_a_current_sensor_have_the_other_modes() -> None:
    voltage = {
        OperatingMode.VELOCITY, OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION, OperatingMode.PWM
    }  # fmt: skip
    assert {name for name, servo in SERVOS.items() if servo.modes == voltage} == {"XL430-W250", "XC430-W150", "MX-28"}


def test_what_a_model_has_no_register_for_has_no_factory_value() -> None:
    assert SERVOS["AX-12A"].default(table.SHUTDOWN) is None
    assert SERVOS["MX-64"].default(table.PRESENT_POSITION) is None


def test_a_share_is_of_the_stall_torque_and_of_none_where_any_count_is_taken() -> None:
    """Its torque at the stall is at 2.3 A (MX-64: 4.1 A), not at the largest current that it takes."""
    assert SERVOS["XM430-W350"].share_count(table.GOAL_CURRENT, 0.4) == round(0.4 * 2300 / 2.69) == 342
    assert SERVOS["MX-64"].share_count(table.GOAL_CURRENT, 1.0) == round(4100 / 3.36) == 1220
    assert SERVOS["XL430-W250"].share_count(table.GOAL_PWM, 1.0) == 885
    assert SERVOS["MX-64"].share_count(table.PRESENT_POSITION, 1.0) == 0
    assert models.CONTINUOUS_SHARE == 0.2


def test_a_model_can_be_a_key() -> None:
    assert len({*SERVOS.values()}) == len(SERVOS)


def test_a_table_of_registers_lacks_what_is_absent_and_has_what_is_changed() -> None:
    found = models._control_table([table.LED, *models._CURRENT_SENSE], *models._voltage(60, 140))
    assert MOST.keys() - found.keys() == {"LED", "Current Limit", "Goal Current", "Present Current"}
    changed = {name: (r.minimum, r.maximum, r.default) for name, r in found.items() if r != MOST[name]}
    assert changed == {"Max Voltage Limit": (60, 140, 140), "Min Voltage Limit": (60, 140, 60)}
    limit, goal = models._current(1941)
    assert (limit.minimum, limit.maximum, limit.default) == (0, 1941, 1941)
    assert (goal.minimum, goal.maximum) == (-1941, 1941)
