"""Health of servos, from what a driver says to a table of the log and to `/diagnostics`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from agent.log import Run, load
from agent.log.columns import Table
from agent.log.diagnostics import servo_message
from agent.log.read import read_log
from agent.log.servos import ServoTable
from agent.modes import Mode
from agent.report.grip import GripResults, grip_results
from agent.telemetry.row.event import TEXT_MAX_BYTES, encode
from agent.telemetry.row.health import Health, grip_values, health_values
from drivers.interface import GripState, ServoHealth
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.telemetry_cell import SERVOS, UTC_0_NS, make_rows

STORE = get_typestore(Stores.ROS2_JAZZY)
NAN = float("nan")


def text(utc_ns: int, /, **changes: object) -> bytes:
    return encode({"utc_ns": utc_ns} | SERVOS | changes)


def diagnosed(message: bytes) -> list[tuple[str, int, str, dict[str, str]]]:
    found = STORE.deserialize_cdr(message, "diagnostic_msgs/msg/DiagnosticArray")
    return [(s.name, s.level, s.message, {v.key: v.value for v in s.values}) for s in found.status]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """100 rows of `left` from t = 0; health at 0.1 s, again at 0.1 s, and at 0.402 s, where servo 2 is missing."""
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", make_rows("left", 100))
    maker.write("right", make_rows("right", 100))
    fewer = {name: column[::2] for name, column in SERVOS.items()}
    maker.health(UTC_0_NS + 402_000_000, text(UTC_0_NS + 402_000_000, **fewer))
    for _ in range(2):  # as a telemetry process does that was started again
        maker.health(UTC_0_NS + 100_000_000, text(UTC_0_NS + 100_000_000))
    maker.flush()
    maker.finish()
    return load(tmp_path / "run.mcap")


def test_the_log_has_a_table_of_each_arm_that_has_servos(run: Run) -> None:
    assert set(run.servos) == {"left"}
    table = run.servos["left"]
    assert len(table) == 2
    assert table.utc_ns.tolist() == [UTC_0_NS + 100_000_000, UTC_0_NS + 402_000_000]
    np.testing.assert_allclose(table.t, [0.1, 0.402], atol=1e-12)
    assert (table.servo_id, table.joint) == ((1, 2, 3), ("waist", "shoulder", "shoulder"))
    np.testing.assert_array_equal(table.temperature_C, [[30.0, 31.0, NAN], [30.0, NAN, NAN]])
    np.testing.assert_array_equal(table.voltage_V, [[12.1, 12.0, 11.9], [12.1, NAN, 11.9]])
    np.testing.assert_array_equal(table.current_A, [[0.25, -1.5, NAN], [0.25, NAN, NAN]])
    np.testing.assert_array_equal(table.load, [[NAN, NAN, 0.125], [NAN, NAN, 0.125]])
    np.testing.assert_array_equal(table.error_bits, [[0, 32, 0], [0, 0, 0]])
    assert table.error_bits.dtype == np.uint8
    assert (run.problems, run.complete) == ((), True)


def test_its_arrays_are_read_only(run: Run) -> None:
    table: ServoTable = run.servos["left"]
    for name in ("utc_ns", "t", "temperature_C", "voltage_V", "current_A", "load", "error_bits"):
        assert not getattr(table, name).flags.writeable, name


def test_before_a_start_that_is_not_set_the_time_is_that_of_the_rows(tmp_path: Path) -> None:
    rows = make_rows("left", 100)
    rows["t"][:50] -= 86_400.0  # READY counts towards a start a day ahead
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", rows)
    for ms in (-3, 247, 251):
        maker.health(UTC_0_NS + ms * 1_000_000, text(UTC_0_NS + ms * 1_000_000))
    maker.finish()
    found = read_log(tmp_path / "run.mcap").servos["left"].t
    np.testing.assert_allclose(found, [-86_400.003, -86_399.753, 0.251], atol=1e-9)


def test_a_gripper_has_columns_of_its_own_and_older_texts_have_none_of_it(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", make_rows("left", 100))
    grip = GripState(0, width_m=0.04391, speed_m_per_s=0.0, effort=0.2, force_N=8.26, width_cmd_m=0.03, force_max_N=9.1)
    for ms, values in (
        (100, grip_values(grip)),
        (200, grip_values(None)),
        (300, grip_values(replace(grip, force_N=3.0))),
    ):
        maker.health(UTC_0_NS + ms * 1_000_000, text(UTC_0_NS + ms * 1_000_000, **values))
    maker.finish()
    log = read_log(tmp_path / "run.mcap")
    table = log.servos["left"]
    np.testing.assert_array_equal(table.grip_width_m, [0.0439, NAN, 0.0439])
    np.testing.assert_array_equal(table.grip_width_cmd_m, [0.03, NAN, 0.03])
    np.testing.assert_array_equal(table.grip_force_N, [8.3, NAN, 3.0])
    np.testing.assert_array_equal(table.grip_force_max_N, [9.1, NAN, 9.1])
    rows = Table.of(log.agents["left"])
    assert grip_results(rows, table) == GripResults(0.03, 0.0439, 0.0439, 3.0, 8.3, 9.1)
    away = np.array(log.agents["left"])
    away["mode"][away["utc_ns"] < UTC_0_NS + 250_000_000] = Mode.APPROACH
    held = grip_results(Table.of(away), table)
    assert held is not None
    assert (held.force_min_N, held.force_max_N) == (3.0, 3.0), "what it held while the arm held the object alone"
    assert grip_results(rows, None) is None
    with pytest.raises(ValueError, match="values to unpack"):
        Health.from_json(text(1, grip=[0.1]))


def test_what_is_no_health_is_told_and_left_out(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", make_rows("left", 10))
    maker.health(UTC_0_NS, b'{"utc_ns":1,"temperature_C":[31.5]}')
    maker.finish()
    log = read_log(tmp_path / "run.mcap")
    assert log.servos == {}
    assert log.problems == ("left: a health text that is none: not the health of servos: KeyError('servo_id')",)


def test_the_log_has_a_diagnosis_of_every_servo(run: Run, tmp_path: Path) -> None:
    with (tmp_path / "run.mcap").open("rb") as file:
        found = [m.data for _, _, m in make_reader(file).iter_messages(["/diagnostics"]) if b"servo" in m.data]
    assert len(found) == 3
    first = diagnosed(found[0])
    assert first == [
        ("arm left: servo 1 waist", 0, "no error",
         {"temperature_C": "30", "voltage_V": "12.1", "current_A": "0.25", "error_bits": "0"}),
        ("arm left: servo 2 shoulder", 2, "OVERLOAD",
         {"temperature_C": "31", "voltage_V": "12", "current_A": "-1.5", "error_bits": "32"}),
        ("arm left: servo 3 shoulder", 0, "no error", {"voltage_V": "11.9", "load": "0.125", "error_bits": "0"}),
    ]  # fmt: skip


def test_error_bits_have_their_names_or_their_number() -> None:
    def words(bits: int) -> str:
        return diagnosed(servo_message("left", Health.from_json(text(1, error_bits=[bits, 0, 0]))))[0][2]

    assert words(0x24) == "OVERHEATING OVERLOAD"
    assert words(0x80) == "error bits 0x80"


def test_nine_servos_of_a_driver_fit_and_come_back_rounded() -> None:
    nine = np.arange(9.0)
    health = ServoHealth(
        5, tuple(range(244, 253)), ("forearm_rotation",) * 9, 60.0 + nine, 11.123 + 0.001 * nine,
        np.full(9, 0x2D, np.uint8), np.where(nine < 6, -1.23456, NAN), np.where(nine < 6, NAN, -0.1234),
        80.0 + nine, np.full(9, 9.5), np.full(9, 16.0), np.full(9, 2.3), np.zeros(9, np.int64),
    )  # fmt: skip
    grip = GripState(0, -0.12345, 0.0, 1.0, -123.45, 0.12345, 123.45)
    encoded = encode({"utc_ns": UTC_0_NS, **health_values(health), **grip_values(grip)})
    assert len(encoded) <= TEXT_MAX_BYTES
    told = Health.from_json(encoded)
    assert (told.utc_ns, told.servo_id, told.joint) == (UTC_0_NS, health.servo_ids, health.joints)
    assert told.temperature_C == tuple(60.0 + nine)
    np.testing.assert_allclose(told.voltage_V, health.voltage_V, atol=0.005)
    np.testing.assert_array_equal(told.current_A, [-1.235] * 6 + [NAN] * 3)
    np.testing.assert_array_equal(told.load, [NAN] * 6 + [-0.123] * 3)
    assert told.error_bits == (0x2D,) * 9
    assert told.temperature_limit_C == tuple(80.0 + nine)
    assert (told.voltage_min_V, told.voltage_max_V, told.stall_current_A) == ((9.5,) * 9, (16.0,) * 9, (2.3,) * 9)


def test_a_text_of_an_older_log_has_no_limits() -> None:
    told = Health.from_json(text(1))
    for name in ("temperature_limit_C", "voltage_min_V", "voltage_max_V", "stall_current_A"):
        np.testing.assert_array_equal(getattr(told, name), [NAN] * 3)


@pytest.mark.parametrize(
    "changes",
    [
        {"servo_id": [1, 2]}, {"servo_id": [1, 1, 2]}, {"servo_id": [1, 2, 256]}, {"servo_id": [1, 2, True]},
        {"joint": ["a", "b", 3]}, {"error_bits": [0, 0, -1]}, {"load": [1.0, "2", 3.0]}, {"voltage_V": 12.0},
        {"load": [True, 0.0, 0.0]}, {"utc_ns": -1}, {"utc_ns": 1.5},
    ],
)  # fmt: skip
def test_what_comes_from_anywhere_is_checked(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"servo|number|name|time"):
        Health.from_json(text(1, **changes))


@pytest.mark.parametrize("payload", [b"", b"[]", b"null", b"[" * 900, b'{"utc_ns":NaN}', b" " * 1001])
def test_what_is_no_text_of_ours_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r".+"):
        Health.from_json(payload)


def test_numbers_that_are_not_finite_are_refused() -> None:
    raw = json.dumps({"utc_ns": 1, **SERVOS}).encode()
    assert b"NaN" in raw
    with pytest.raises(ValueError, match="no number"):
        Health.from_json(raw)
