"""The driver on a real port, in real time, against emulated servos in another process with a real bus's timing."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import dynamixel_sdk as sdk
import numpy as np
import pytest

from drivers.clock import MonotonicClock
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import DxlServoFault, FaultCause, PortError, PortLostError, StaleJointsError
from drivers.dynamixel.events import DriverEvent, EventKind
from drivers.interface import DriverError, JointState, StaleStateError, Vector
from tests.support.servos.dxl_rig import WX200, at
from tests.support.servos.patience import be_patient
from tests.support.servos.wire_emulator import emulator

# 50 Hz and a long watchdog: a stalled test machine must not look like a dead servo
ARM = at(
    WX200,
    rate_hz=50.0,
    watchdog_s=2.5,
    joints=tuple(replace(j, start_rad=None, position_limit_ticks=(0, 4095)) for j in WX200.joints),
)
CYCLES = 50
STAY = np.zeros(4)
PATIENCE = 500  # cycles: what must happen happens long before


pytestmark = pytest.mark.paced


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    with emulator(tmp_path, timing=True) as port:
        yield port


@pytest.fixture
def driver(path: Path) -> Iterator[DynamixelDriver]:
    driver = DynamixelDriver(replace(ARM, port=str(path)), MonotonicClock(), scan_s=0.1)
    yield driver
    driver.disable()
    driver.close()


def command(path: Path, **fault) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.bind(str(path.parent / "reply"))
        sender.sendto(json.dumps({"arm": "left"} | fault).encode(), str(path.parent / "control"))
        assert sender.recv(1000) == b"ok"
    (path.parent / "reply").unlink()


def run(driver: DynamixelDriver, cycles: int, until: type[Exception] | None = None, offset_rad: Vector = STAY):
    """So many states of a loop that holds the arm so far from where it is; or those before an error of `until`, and it.

    Cycles without a state are repeated: on a machine that stalls some have none.
    """
    clock = MonotonicClock()
    states: list[JointState] = []
    start_ns = clock.now_ns()
    for k in range(PATIENCE):
        if until is None and len(states) >= cycles:
            break
        clock.sleep_until(start_ns + k * driver.arm.period_ns)
        tau = np.zeros(4)
        try:
            state = driver.read()
        except StaleJointsError:
            pass  # a machine that stalls; the next cycle is there soon
        except DriverError as error:
            if until is not None and isinstance(error, until):
                return states, error
            raise
        else:
            states.append(state)
            tau = 4.0 * (states[0].q + offset_rad - state.q) - 0.1 * state.dq
        driver.write(tau)
    assert until is None, f"{until.__name__} did not happen"
    return states, None


def at_rest(driver: DynamixelDriver) -> Vector:
    """Where an arm without torque has come to lie."""
    end_s, last, since_s = time.monotonic() + 30.0, driver.read().q, time.monotonic()
    while time.monotonic() - since_s < 0.3:
        assert time.monotonic() < end_s, "it still moves"
        time.sleep(0.02)
        with contextlib.suppress(StaleStateError):
            q = driver.read().q
            if np.abs(q - last).max() > 2e-3:
                last, since_s = q, time.monotonic()
    return last


def answered(read: Callable[..., tuple[int, int, int]], *of: object) -> int:
    """What the SDK reads twice in a row.

    It gives up after 34 ms, in which a busy machine may not have run the servos, and takes an answer that comes after
    that for the next one's.
    """
    before: int | None = None
    for _ in range(40):
        value, result, _ = read(*of)
        if result == sdk.COMM_SUCCESS and value == before:
            return value
        before = value if result == sdk.COMM_SUCCESS else None
    raise AssertionError("no answer")


def test_an_arm_is_brought_up_held_and_let_go(driver: DynamixelDriver, path: Path) -> None:
    info = driver.connect()
    assert "7 servos, firmware 46, fast sync read" in info.description
    driver.enable()
    states, _ = run(driver, CYCLES)
    assert len(states) == CYCLES
    stamps = [state.stamp_ns for state in states]
    assert stamps == sorted(set(stamps))
    assert np.abs(states[-1].q - states[0].q).max() < 0.05
    assert np.all(driver.health().temperature_C > 0)
    driver.disable()
    final = at_rest(driver)
    driver.close()
    handler = sdk.PortHandler(str(path))
    assert handler.setBaudRate(ARM.baud)
    packets = sdk.PacketHandler(2.0)
    ticks = [answered(packets.read4ByteTxRx, handler, i, 132) for i in (2, 4, 5, 6)]
    torque = [answered(packets.read1ByteTxRx, handler, i, 64) for i in range(1, 8)]
    handler.closePort()
    assert torque == [0] * 7
    assert np.allclose((np.array(ticks) - 2048) * 2 * np.pi / 4096, final, atol=0.01)


LEFT = ((4, 100, 2, 60), (3, 100, 2, 0), (1, 84, 2, 0), (1, 112, 4, 3), (7, 80, 2, 0))
WANTED = (885, 885, 800, 0, 4000)


@pytest.mark.fault("S7")
def test_a_joint_follows_whatever_another_program_has_left_in_the_servos(driver: DynamixelDriver, path: Path) -> None:
    """Goal PWM of the elbow and of the shadow, gain and profile of the held waist, gain of the gripper."""
    driver.connect()
    driver.enable()  # from now on no start changes a mode
    driver.disable()
    driver.close()
    handler, packets = sdk.PortHandler(str(path)), sdk.PacketHandler(2.0)
    assert handler.setBaudRate(ARM.baud)
    reads = {2: packets.read2ByteTxRx, 4: packets.read4ByteTxRx}
    writes = {2: packets.write2ByteTxRx, 4: packets.write4ByteTxRx}
    for servo_id, address, size, value in LEFT:
        while answered(reads[size], handler, servo_id, address) != value:
            writes[size](handler, servo_id, address, value)
    handler.closePort()
    events: list[DriverEvent] = []
    ours = DynamixelDriver(driver.arm, MonotonicClock(), on_event=events.append, scan_s=0.1)
    ours.connect()
    ours.enable()
    told = sorted((e.servo_id, e.text) for e in events if e.kind is EventKind.RAM_WRITTEN)
    assert told == [
        (1, "Position P Gain 0 → 800"), (1, "Profile Velocity 3 → 0"), (3, "Goal PWM 0 → 885"),
        (4, "Goal PWM 60 → 885"), (7, "Position D Gain 0 → 4000"),
    ]  # fmt: skip
    states, _ = run(ours, 4 * CYCLES, offset_rad=np.array([0.0, 0.4, 0.0, 0.0]))
    ours.disable()
    ours.close()
    assert states[-1].q[1] - states[0].q[1] == pytest.approx(0.4, abs=0.05)
    assert max(state.tau[1] for state in states[:CYCLES]) > 0.5  # 60 counts of PWM give 0.28 N·m and no more
    assert handler.setBaudRate(ARM.baud)
    found = [answered(reads[size], handler, servo_id, address) for servo_id, address, size, _ in LEFT]
    handler.closePort()
    assert tuple(found) == WANTED


@pytest.mark.fault("P5")
def test_second_driver_is_refused_before_a_byte_is_sent(driver: DynamixelDriver) -> None:
    driver.connect()
    second = DynamixelDriver(driver.arm, MonotonicClock())
    with pytest.raises(PortError, match="in use by"):
        second.connect()
    second.close()


def test_a_rebooted_servo_is_named(driver: DynamixelDriver, path: Path) -> None:
    driver.connect()
    driver.enable()
    run(driver, CYCLES)
    command(path, kind="reboot", servo=4)
    _, fault = run(driver, PATIENCE, until=DxlServoFault)
    assert isinstance(fault, DxlServoFault)
    assert fault.servo_id == 4
    assert fault.cause in (FaultCause.SILENT, FaultCause.REBOOTED)  # silent while it boots


def test_a_port_that_goes_and_comes_back_is_the_same_arm(driver: DynamixelDriver, path: Path) -> None:
    driver.connect()
    driver.enable()
    run(driver, CYCLES)
    command(path, kind="port_loss", duration_s=0.3)
    _, lost = run(driver, PATIENCE, until=PortLostError)
    assert isinstance(lost, PortLostError)
    for _ in range(PATIENCE):
        try:
            driver.reopen()
        except DriverError:
            time.sleep(0.02)
        else:
            break
    states, _ = run(driver, 5)
    assert states


def test_wrong_port_and_wrong_speed_are_refused(driver: DynamixelDriver, path: Path) -> None:
    wrong = DynamixelDriver(replace(driver.arm, baud=3_000_000), MonotonicClock(), scan_s=0.1)
    with pytest.raises(DriverError, match="answers at 1000000 bit/s, expected 3000000 bit/s"):
        wrong.connect()
    nowhere = DynamixelDriver(replace(driver.arm, port=str(path) + "_not_there"), MonotonicClock())
    with pytest.raises(PortError, match="nothing of that name"):
        nowhere.connect()
