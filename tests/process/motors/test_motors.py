"""`coop motors` and `coop doctor` as a person runs them, on real ptys; the official SDK is the witness.

The servos are processes of their own, the commands are in this one, but for one that runs beside another.
"""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dynamixel_sdk as sdk
import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.servo_map import arm_map
from drivers.clock import MonotonicClock
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.identify import IdentityError
from tests.support.command import coop
from tests.support.loaded import Loaded
from tests.support.servos.motor_emulator import loose_servos
from tests.support.servos.patience import PATIENT_COOP, be_patient

TWO_WX200 = str(configs.CELLS_DIR / "two_wx200.toml")
XM, XL = "XM430-W350", "XL430-W250"
THREE = ({"model": XM, "servo_id": 2, "Baud_Rate": 3}, {"model": XM, "servo_id": 3, "Baud_Rate": 3}, {
    "model": XL, "servo_id": 9, "Baud_Rate": 3,
})  # fmt: skip
SEARCH_S = 60


class Witness:
    """The SDK on the same port, closed again before the next tool opens it."""

    def __init__(self, port: Path, baud: int = 1_000_000) -> None:
        self._handler = sdk.PortHandler(str(port))
        self._packets = sdk.PacketHandler(2.0)
        self._baud = baud

    def __enter__(self) -> Witness:
        assert self._handler.setBaudRate(self._baud)
        return self

    def __exit__(self, *_: object) -> None:
        self._handler.closePort()

    def servos(self) -> dict[int, list[int]]:
        found, _ = self._packets.broadcastPing(self._handler)
        return dict(found)

    def byte(self, servo_id: int, address: int) -> int:
        value, result, error = self._packets.read1ByteTxRx(self._handler, servo_id, address)
        assert (result, error) == (0, 0)
        return int(value)

    def write(self, servo_id: int, address: int, value: int) -> None:
        assert self._packets.write1ByteTxRx(self._handler, servo_id, address, value) == (0, 0)

    def write_word(self, servo_id: int, address: int, value: int) -> None:
        assert self._packets.write4ByteTxRx(self._handler, servo_id, address, value) == (0, 0)


pytestmark = pytest.mark.paced


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)
    monkeypatch.setattr("agent.doctor.cycle.READS", 40)  # of which nothing is judged here


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "port"


@pytest.fixture
def three(port: Path) -> Iterator[Path]:
    with loose_servos(port, *THREE):
        yield port


@contextlib.contextmanager
def held(port: Path, how: str) -> Iterator[int]:
    """Another program has the port open; yields its process ID."""
    with subprocess.Popen(
        [sys.executable, "-c", f"import sys\n{how}\nprint('open', flush=True)\nsys.stdin.read()", str(port)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as other:  # fmt: skip
        assert other.stdout is not None
        assert other.stdout.readline() == "open\n"
        yield other.pid
        other.communicate("")


BY_SDK = "import dynamixel_sdk as s; h = s.PortHandler(sys.argv[1]); h.openPort()"
BY_DRIVER = (
    "from drivers.clock import MonotonicClock; from drivers.dynamixel.line.port import SerialPort\n"
    "p = SerialPort(sys.argv[1], 1000000, MonotonicClock()); p.open()"
)


# --- scan ------------------------------------------------------------------------------------------------------------


def test_scan_lists_what_the_sdk_sees_and_how_it_is(three: Path) -> None:
    done = coop("motors", "scan", "--port", three, "--baud", "1000000", "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    rows = document["servos"]
    assert (list(document), document["schema"]) == (["schema", "servos"], 1)
    with Witness(three) as witness:
        assert {row["id"]: [row["model_number"], row["firmware"]] for row in rows} == witness.servos()
        assert [witness.byte(i, 64) for i in (2, 3, 9)] == [0, 0, 0]
    assert [row["model"] for row in rows] == [XM, XM, XL]
    assert all(row["voltage_V"] == 12.0 and row["temperature_C"] == 25 and row["hardware_error"] == 0 for row in rows)
    table = coop("motors", "scan", "--port", three, "--baud", "1000000").out
    assert re.search(r"9\s+XL430-W250\s+46\s+12\.0 V\s+25 °C\s+2048\s+none", table)


def test_scan_finds_nothing_and_says_so_in_its_exit_code(three: Path) -> None:
    done = coop("motors", "scan", "--port", three, "--baud", "2000000", "--json")
    assert done.code == 1
    assert json.loads(done.out) == {"schema": 1, "servos": []}
    assert "is the 12 V supply on?" in done.err


def test_a_shared_id_is_named_which_the_sdk_does_not_see(port: Path) -> None:
    with loose_servos(port, {"model": XM, "servo_id": 5, "Baud_Rate": 3}, {"model": XL, "servo_id": 5, "Baud_Rate": 3}):
        with Witness(port) as witness:
            assert 5 not in witness.servos()
        done = coop("motors", "scan", "--port", port, "--baud", "1000000", "--json")
    rows = json.loads(done.out)["servos"]
    assert [(row["id"], row["note"]) for row in rows] == [(5, "more than one servo has this ID")]


@pytest.mark.parametrize("how", [BY_SDK, BY_DRIVER], ids=["without a lock", "locked"])
def test_a_port_in_use_is_refused_naming_the_program(three: Path, how: str) -> None:
    with held(three, how) as pid:
        done = coop("motors", "scan", "--port", three)
    assert done.code == 3
    assert re.search(rf"^coop: port .*: found in use by .*\({pid}\), expected nobody else on the bus; ", done.err, re.M)


def test_a_port_that_is_not_there_and_a_speed_nobody_knows_are_refused(tmp_path: Path) -> None:
    done = coop("motors", "scan", "--port", tmp_path / "nothing")
    assert done.code == 3
    assert "found nothing of that name, expected a serial port" in done.err
    done = coop("motors", "scan", "--port", tmp_path / "nothing", "--baud", "1234")
    assert done.code == 2
    assert "baud rate: found 1234, expected 9600" in done.err


# --- setup -----------------------------------------------------------------------------------------------------------


def test_setup_asks_first_and_then_makes_a_shoulder_shadow(tmp_path: Path) -> None:
    """On two ports at once, for it looks for the servo at every speed; one is asked for, the other is not."""
    how = ("--arm-model", "wx200", "--joint", "shoulder", "--shadow")
    asking, sure = tmp_path / "asking", tmp_path / "sure"
    with loose_servos(asking, {"model": XM}), loose_servos(sure, {"model": XM}):
        done = subprocess.Popen(
            [*PATIENT_COOP, "motors", "setup", "--port", sure, *how, "--yes"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        declined = coop("motors", "setup", "--port", asking, *how, stdin="n\n")
        assert declined.code == 1
        for change in ("ID: 1 → 3", "Baud Rate: 1 → 3", "Drive Mode: 0 → 1", "Secondary(Shadow) ID: 255 → 2",
                       "Return Delay Time: 250 → 0", "Min Position Limit: 0 → 819"):  # fmt: skip
            assert change in declined.out
        with Witness(asking, 57_600) as witness:
            assert witness.byte(1, 9) == 250
        _, err = done.communicate(timeout=SEARCH_S)
        assert done.returncode == 0, err
        with Witness(sure) as witness:
            assert [witness.byte(3, address) for address in (7, 8, 9, 10, 12, 64)] == [3, 3, 0, 1, 2, 0]


def test_setup_on_an_arm_is_refused(three: Path) -> None:
    done = coop("motors", "setup", "--port", three, "--arm-model", "wx200", "--joint", "elbow", "--yes")
    assert done.code == 3
    assert "found ID 2 at 1000000 bit/s, ID 3 at 1000000 bit/s, ID 9 at 1000000 bit/s, expected exactly one" in done.err


def test_setup_for_an_arm_or_joint_that_is_not_described_is_refused_before_the_port_is_opened() -> None:
    for arm, joint, text in (("wx2000", "elbow", "arm model: found 'wx2000'"), ("wx200", "elbov", "joint of wx200")):
        done = coop("motors", "setup", "--port", "/dev/coop-not-there", "--arm-model", arm, "--joint", joint)
        assert done.code == 2
        assert text in done.err


# --- dump and restore ------------------------------------------------------------------------------------------------


def test_what_the_sdk_changed_a_restore_brings_back(three: Path, tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    done = coop("motors", "dump", "--port", three, "--baud", "1000000", "--out", file)
    assert done.code == 0, done.err
    content = tomllib.loads(file.read_text())
    assert [servo["id"] for servo in content["servos"]] == [2, 3, 9]
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".arm")] == []
    with Witness(three) as witness:
        witness.write(3, 9, 77)  # Return Delay Time
        witness.write(9, 31, 60)  # Temperature Limit
    dry = coop("motors", "restore", file, "--port", three, "--dry-run")
    assert dry.code == 0, dry.err
    assert dry.out.splitlines() == [
        "servo 3: Return Delay Time: found 77, wanted 250",
        "servo 9: Temperature Limit: found 60, wanted 72",
        "2 registers would be written",
    ]
    with Witness(three) as witness:
        assert witness.byte(3, 9) == 77
    done = coop("motors", "restore", file, "--port", three)
    assert done.code == 0, done.err
    assert done.out.endswith("2 registers written and read back\n")
    with Witness(three) as witness:
        assert [witness.byte(3, 9), witness.byte(9, 31)] == [250, 72]
        assert [witness.byte(i, 64) for i in (2, 3, 9)] == [0, 0, 0]
    assert coop("motors", "restore", file, "--port", three).out == "no differences\n"


def test_a_dump_does_not_replace_a_file_unless_told_to(three: Path, tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    file.write_text("the only one")
    done = coop("motors", "dump", "--port", three, "--baud", "1000000", "--out", file)
    assert (done.code, file.read_text()) == (2, "the only one")
    done = coop("motors", "dump", "--port", three, "--baud", "1000000", "--out", file, "--force")
    assert done.code == 0
    assert "servos" in tomllib.loads(file.read_text())


def test_torque_on_and_another_model_refuse_a_restore(three: Path, tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    assert coop("motors", "dump", "--port", three, "--baud", "1000000", "--out", file).code == 0
    with Witness(three) as witness:
        witness.write(3, 9, 77)
        witness.write(9, 64, 1)
    done = coop("motors", "restore", file, "--port", three)
    assert done.code == 3
    assert "servo 9: torque: found on, expected off" in done.err
    with Witness(three) as witness:
        assert [witness.byte(3, 9), witness.byte(9, 64)] == [77, 1]
    text = file.read_text().replace("id = 2", "id = 9").replace("ID = 2", "ID = 9")
    file.write_text(text[: text.index("[[servos]]", text.index("[[servos]]") + 1)])
    done = coop("motors", "restore", file, "--port", three)
    assert done.code == 3
    assert "servo 9: model: found XL430-W250, expected XM430-W350 as in the file" in done.err


def test_a_missing_servo_is_one_line_and_exit_code_1(three: Path, tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    assert coop("motors", "dump", "--port", three, "--baud", "1000000", "--out", file).code == 0
    file.write_text(file.read_text().replace("id = 9", "id = 8").replace("ID = 9", "ID = 8"))
    done = coop("motors", "restore", file, "--port", three, "--dry-run")
    assert done.code == 1
    assert "servo 8: found none, wanted a XL430-W250; check its cable and supply" in done.out


# --- doctor ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """`coop emulate` of the wx200 cell, which the doctor only looks at; yields the folder of its ports."""
    folder = tmp_path_factory.mktemp("emulated")
    place = ("--ports", folder / "ports", "--ring", folder / "plant.ring")
    emulator = Loaded("emulate", TWO_WX200, *place, cwd=folder)
    try:
        assert emulator.stdout.readline().startswith("READY")
        deadline = time.monotonic() + SEARCH_S
        while not (folder / "ports" / "right").exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield folder / "ports"
    finally:
        emulator.terminate()
        emulator.communicate(SEARCH_S)
        assert emulator.returncode == 0


TIMED = {"read of all servos, measured", "overhead of each read", "read in its period", "replies"}


def against_arms(document: dict[str, Any]) -> list[str]:
    """What is said against the arms but for timing, for which a busy test machine may be to blame."""
    arms = [f for f in document["findings"] if f["where"] not in ("host", "cell") and f["what"] not in TIMED]
    return [f"{f['where']}: {f['what']}" for f in arms if f["verdict"] != "ok"]


def test_doctor_finds_an_emulated_cell_fit_and_leaves_it_as_it_was(cell: Path, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("before.toml", "after.toml")]
    assert coop("motors", "dump", "--port", cell / "left", "--baud", "1000000", "--out", files[0]).code == 0
    done = coop("doctor", TWO_WX200, "--ports", cell, "--logs", tmp_path, "--json")
    document = json.loads(done.out)
    assert done.code == {"ok": 0, "warning": 1, "refused": 2}[document["verdict"]]
    assert against_arms(document) == []
    assert set(document["cycles"]) == {"left", "right"}
    assert coop("motors", "dump", "--port", cell / "left", "--baud", "1000000", "--out", files[1]).code == 0
    before, after = (tomllib.loads(file.read_text())["servos"] for file in files)
    assert before == after
    with Witness(cell / "left") as witness:
        assert [witness.byte(i, 64) for i in range(1, 8)] == [0] * 7


def test_doctor_names_the_program_that_has_the_port_and_looks_at_the_other_arm(cell: Path, tmp_path: Path) -> None:
    with held(cell / "left", BY_DRIVER) as pid:
        done = coop("doctor", TWO_WX200, "--ports", cell, "--logs", tmp_path)
    assert done.code == 2
    assert re.search(
        rf"^refused  left: port .*: found in use by .*\({pid}\), wanted nobody else on the bus; ", done.out, re.M
    )
    assert re.search(r"^ok       right: servos: 7, IDs 1, 2, 3, 4, 5, 6, 7", done.out, re.M)
    assert "left: servos" not in done.out


def test_doctor_sees_a_defect_that_the_sdk_made(cell: Path, tmp_path: Path) -> None:
    with Witness(cell / "left") as witness:
        before = witness.byte(4, 10)
        witness.write(4, 10, 0)  # Drive Mode of the reversed elbow
    done = coop("doctor", TWO_WX200, "--arm", "left", "--ports", cell, "--logs", tmp_path)
    with Witness(cell / "left") as witness:
        witness.write(4, 10, before)
    assert done.code == 2
    assert re.search(
        r"^refused  left: servo 4 \(elbow\): Drive Mode, direction: found normal .*, wanted reverse .*;",
        done.out,
        re.M,
    )


MARKS = ("--set", "arms.left.dynamixel.mark=1", "--set", "arms.right.dynamixel.mark=2")


def test_an_arm_that_was_given_a_mark_is_refused_at_the_port_of_another(cell: Path) -> None:
    """The real driver on real ports; the servos are an emulator's, alike but for what `coop motors mark` writes."""
    for arm in ("left", "right"):
        with Witness(cell / arm) as witness:
            for i in range(1, 8):
                witness.write_word(i, 24, 10)  # as they leave the factory, also where this test is made again
    asked = coop("motors", "mark", TWO_WX200, "--arm", "left", "--ports", cell, *MARKS, stdin="y\n")
    assert asked.code == 0, asked.err
    assert "servo 7: Moving Threshold: found 10, wanted 1\n" in asked.out
    assert "arm left: mark 1 is in 7 servos, read back; torque was never on" in asked.out
    other = coop("motors", "mark", TWO_WX200, "--arm", "right", "--ports", cell, "--yes", *MARKS)
    assert other.code == 0, other.err
    for arm, mark in (("left", 1), ("right", 2)):
        with Witness(cell / arm) as witness:
            assert [witness.byte(i, 24) for i in range(1, 8)] == [mark] * 7
    described = load_cell(configs.CELLS_DIR / "two_wx200.toml", MARKS[1::2])
    left = described.arms[0]
    for arm, fits in (("left", True), ("right", False)):
        servos = arm_map(described, left, str(cell / arm), np.array(left.entry.q_near_rad))
        driver = DynamixelDriver(servos, MonotonicClock(), scan_s=0.05, read_share=4.0)
        with contextlib.ExitStack() as after:
            after.callback(driver.close)
            if not fits:
                after.enter_context(pytest.raises(IdentityError, match=r"found 2, arm right's, .* swapped$"))
            driver.connect()


def test_the_file_of_one_arm_leaves_the_other_its_mark_and_a_wrong_mark_has_a_way_out(
    cell: Path, tmp_path: Path
) -> None:
    mark, at = ("motors", "mark", TWO_WX200, "--arm"), ("--ports", cell, *MARKS)
    file, port = tmp_path / "left.toml", cell / "right"
    for arm in ("left", "right"):
        assert coop(*mark, arm, "--yes", *at).code == 0
    assert coop("motors", "dump", "--port", cell / "left", "--baud", "1000000", "--out", file).code == 0
    left = coop("motors", "restore", file, "--port", port)
    told = "servo 7: Moving Threshold: found 2, wanted 1; not written, for it may be an arm's mark: --mark\n"
    assert (left.code, told in left.out, left.out.count("; not written, ")) == (0, True, 7)
    assert coop("motors", "restore", file, "--port", port, "--mark").out.endswith("registers written and read back\n")
    refused = coop(*mark, "right", "--yes", *at)
    assert (refused.code, "found 1, arm left's" in refused.err, "--force replaces" in refused.err) == (3, True, True)
    for words, answer, code in ((("--force", "--yes"), "y\n", 2), (("--force",), "n\n", 1), (("--force",), "y\n", 0)):
        with Witness(port) as witness:
            assert [witness.byte(i, 24) for i in range(1, 8)] == [1] * 7
        assert coop(*mark, "right", *words, *at, stdin=answer).code == code
    with Witness(port) as witness:
        assert [witness.byte(i, 24) for i in range(1, 8)] == [2] * 7


@pytest.mark.long  # tests/unit/verify/test_check_bus.py
def test_check_refuses_a_rate_that_the_bus_cannot_carry() -> None:
    done = coop("check", TWO_WX200, "--set", "rate_hz=500")
    assert done.code == 2
    assert re.search(r"rate on the servo bus \(left\): found 500 Hz, expected ≤ \d+ Hz \(7 servos", done.err)
