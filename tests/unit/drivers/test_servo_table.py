"""The servo and register tables agree with themselves, with the maker's SDK and with the datasheet points."""

import ast
import dataclasses
import sys
from pathlib import Path
from types import ModuleType

import pytest
from dynamixel_easy_sdk.control_table import ControlTable
from dynamixel_easy_sdk.data_types import OperatingMode as SdkOperatingMode
from dynamixel_sdk import protocol2_packet_handler, robotis_def

from drivers.dynamixel.servo import codes, counts, models, table
from drivers.dynamixel.servo.codes import ALERT_BIT, Instruction, OperatingMode, StatusError
from drivers.dynamixel.servo.counts import VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import RATED_VOLTAGE_V, SERVOS, ServoModel
from drivers.dynamixel.servo.table import Access, Area, Register

PROTOCOL_2 = [servo for servo in SERVOS.values() if servo.protocol == 2.0]

# The SDK's shipped tables name a few registers otherwise, and name only the first of each indirect block.
SDK_NAME = {
    "BUS Watchdog": "Bus Watchdog",
    "Indirect Address Write": "Indirect Address 1",
    "Indirect Data Write": "Indirect Data 1",
    "Indirect Address Read": "Indirect Address 29",
    "Indirect Data Read": "Indirect Data 29",
}
NEWER_THAN_SDK = {"Startup Configuration", "Backup Ready"}


def every_register() -> list[tuple[str, Register]]:
    return [(servo.name, register) for servo in PROTOCOL_2 for register in servo.registers.values()]


def representable(register: Register) -> tuple[int, int]:
    bits = 8 * register.length
    return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if register.signed else (0, (1 << bits) - 1)


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_registers_do_not_overlap(servo: ServoModel) -> None:
    end = 0
    for register in servo.registers.values():
        assert register.address >= end, register
        end = register.address + register.length
    assert end == 662


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_no_register_crosses_from_eeprom_to_ram(servo: ServoModel) -> None:
    for register in servo.registers.values():
        last = register.address + register.length - 1
        assert (register.area is Area.EEPROM) == (last < table.TORQUE_ENABLE.address), register


def test_defaults_lie_in_their_range() -> None:
    checked = 0
    for servo, register in every_register():
        if register.default is not None and register.minimum is not None and register.maximum is not None:
            assert register.minimum <= register.default <= register.maximum, (servo, register)
            checked += 1
    assert checked > 6 * 100


def test_every_writable_value_fits_its_bytes() -> None:
    for servo, register in every_register():
        low, high = representable(register)
        if register.access is Access.READ_WRITE:
            assert low <= register.minimum <= register.maximum <= high, (servo, register)  # type: ignore[operator]
        else:
            assert (register.minimum, register.maximum) == (None, None), (servo, register)


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_registers_match_the_sdk(servo: ServoModel) -> None:
    shipped = ControlTable.getControlTable(servo.model_number)
    theirs = {SDK_NAME.get(name, name): (item.address, item.size) for name, item in shipped.items()}
    ours = {
        name: (register.address, register.length)
        for name, register in servo.registers.items()
        if name in theirs or not (name.startswith("Indirect ") or name in NEWER_THAN_SDK)
    }
    assert ours == theirs


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_model_number_is_the_one_the_sdk_knows(servo: ServoModel) -> None:
    known = ControlTable.getModelName(servo.model_number).removesuffix(".model")
    assert known == servo.name.lower().replace("-", "_")


def test_operating_modes_match_the_sdk() -> None:
    assert {mode.name: mode.value for mode in OperatingMode} == {mode.name: mode.value for mode in SdkOperatingMode}


def test_instruction_codes_match_the_sdk() -> None:
    theirs = {
        name.removeprefix("INST_"): value for name, value in vars(robotis_def).items() if name.startswith("INST_")
    }
    ours = {instruction.name: instruction.value for instruction in Instruction}
    assert len(theirs) == 15
    assert ours == {**theirs, "CONTROL_TABLE_BACKUP": 0x20}


def test_status_error_codes_match_the_sdk() -> None:
    constants = vars(protocol2_packet_handler)
    theirs = {name.removeprefix("ERRNUM_"): value for name, value in constants.items() if name.startswith("ERRNUM_")}
    assert {error.name: error.value for error in StatusError} == {**theirs, "NONE": 0}
    assert constants["ERRBIT_ALERT"] == ALERT_BIT


def test_indirect_registers_map_onto_their_data_by_default() -> None:
    for address, data in zip(table.INDIRECT_ADDRESSES, table.INDIRECT_DATA, strict=True):
        assert address.default == data.address
        assert address.name.removeprefix("Indirect Address ") == data.name.removeprefix("Indirect Data ")
    assert table.INDIRECT_ADDRESSES[27].address == 222
    assert table.INDIRECT_ADDRESSES[28].address == 578
    assert [data.address for data in table.INDIRECT_DATA] == [*range(224, 252), *range(634, 662)]


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_current_registers_exist_exactly_where_current_is_sensed(servo: ServoModel) -> None:
    names = {"Current Limit", "Goal Current", "Present Current"}
    assert (names & servo.registers.keys()) == (names if servo.has_current_mode else set())
    assert ("Present Load" in servo.registers) == (not servo.has_current_mode)
    assert (servo.current_unit_mA is not None) == servo.has_current_mode
    assert (OperatingMode.CURRENT_BASED_POSITION in servo.modes) == servo.has_current_mode


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_current_limit_does_not_protect_from_stall(servo: ServoModel) -> None:
    factory_limit = servo.default(table.CURRENT_LIMIT)
    if servo.current_unit_mA is None or factory_limit is None:
        assert not servo.has_current_mode
        with pytest.raises(KeyError, match="Goal Current"):
            servo.register(table.GOAL_CURRENT)
    else:
        assert factory_limit * servo.current_unit_mA / 1000.0 > servo.stall_current_A
        assert servo.register(table.GOAL_CURRENT).maximum == factory_limit


@pytest.mark.parametrize("servo", SERVOS.values(), ids=lambda s: s.name)
def test_motor_model_meets_both_datasheet_points(servo: ServoModel) -> None:
    full = servo.stall_torque_Nm_per_V * RATED_VOLTAGE_V
    assert full == pytest.approx(servo.stall_torque_Nm)
    assert full - servo.back_emf_damping_Nm_s_per_rad * servo.no_load_rad_per_s == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "resistance", "torque_constant", "back_emf", "torque_per_volt", "damping"),
    [
        ("XM430-W350", 5.22, 1.783, 2.491, 0.342, 0.851),
        ("XL430-W250", 8.57, 1.071, 1.879, 0.125, 0.235),
        ("XM540-W270", 2.73, 2.409, 3.820, 0.883, 3.37),
        ("MX-64", 2.93, 1.463, 1.819, 0.500, 0.910),
        ("MX-28", 8.57, 1.786, 2.084, 0.208, 0.434),
        ("AX-12A", 8.0, 1.0, 1.942, 0.125, 0.243),
    ],
)
def test_motor_constants_are_those_derived_by_hand(
    name: str, resistance: float, torque_constant: float, back_emf: float, torque_per_volt: float, damping: float
) -> None:
    servo = SERVOS[name]
    assert servo.resistance_ohm == pytest.approx(resistance, rel=2e-3)
    assert servo.torque_constant_Nm_per_A == pytest.approx(torque_constant, rel=1e-3)
    assert servo.back_emf_V_s_per_rad == pytest.approx(back_emf, rel=1e-3)
    assert servo.stall_torque_Nm_per_V == pytest.approx(torque_per_volt, rel=3e-3)
    assert servo.back_emf_damping_Nm_s_per_rad == pytest.approx(damping, rel=2e-3)


def test_velocity_unit_is_that_of_the_manual_and_close_to_the_sdk() -> None:
    unit = VELOCITY_UNIT_RAD_PER_S
    assert unit == pytest.approx(0.0239808, rel=1e-5)
    assert unit == pytest.approx(0.0239691227, rel=6e-4)  # what the SDK ships


@pytest.mark.parametrize("servo", PROTOCOL_2, ids=lambda s: s.name)
def test_shutdown_default_is_the_manuals_52(servo: ServoModel) -> None:
    assert servo.default(table.SHUTDOWN) == 52


def test_ax_12a_offers_nothing_to_control() -> None:
    servo = SERVOS["AX-12A"]
    assert servo.protocol == 1.0
    assert not servo.modes
    assert not servo.registers
    assert servo.tick_rad * 1024 == pytest.approx(5.23599, rel=1e-5)


def test_tables_are_read_only() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError, match="mass_kg"):
        SERVOS["MX-64"].mass_kg = 1.0  # type: ignore[misc]
    with pytest.raises(TypeError, match="item assignment"):
        SERVOS["MX-64"] = SERVOS["MX-28"]  # type: ignore[index]
    with pytest.raises(TypeError, match="item assignment"):
        SERVOS["MX-64"].registers["ID"] = table.LED  # type: ignore[index]


@pytest.mark.parametrize("module", [codes, counts, models, table], ids=lambda m: m.__name__.rpartition(".")[2])
def test_tables_import_nothing_but_the_standard_library_and_each_other(module: ModuleType) -> None:
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    imported = {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    others = imported - {m.__name__ for m in (codes, counts, models, table)}
    assert {name.partition(".")[0] for name in others} <= sys.stdlib_module_names
