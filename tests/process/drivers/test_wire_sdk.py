"""The manufacturer's SDK, unchanged, against emulated servos in another process.

Where the SDK itself is wrong (unstuffed writes, dropped alert bits) the protocol specification is what is tested, in
tests/unit.  Its waits are wall-clock and short; on a loaded machine they are stretched, nothing else is touched.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import dynamixel_sdk as sdk
import pytest
from dynamixel_easy_sdk import Connector, OperatingMode

from tests.support.servos.patience import SDK_MS, be_patient
from tests.support.servos.wire_emulator import emulator

IDS = tuple(range(1, 8))
OK = sdk.COMM_SUCCESS


pytestmark = pytest.mark.paced


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with emulator(tmp_path_factory.mktemp("wire")) as port:
        yield port


@pytest.fixture
def movable(tmp_path: Path) -> Iterator[Path]:
    """The port of an arm of which the test leaves no servo where it was: the others find theirs in any order."""
    with emulator(tmp_path) as path:
        yield path


@pytest.fixture
def port(path: Path) -> Iterator[sdk.PortHandler]:
    handler = sdk.PortHandler(str(path))
    assert handler.setBaudRate(1_000_000)
    yield handler
    handler.closePort()


@pytest.fixture
def packets() -> sdk.Protocol2PacketHandler:
    return sdk.PacketHandler(2.0)


def test_ping_finds_the_model(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    assert packets.ping(port, 1) == (1020, OK, 0)
    assert packets.ping(port, 7) == (1060, OK, 0)


def test_broadcast_ping_finds_all(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    found, result = packets.broadcastPing(port)
    assert result == OK
    assert found == {i: [1020 if i < 6 else 1060, 46] for i in IDS}


def test_reads_and_writes_of_every_length(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    assert packets.write1ByteTxRx(port, 1, 65, 1) == (OK, 0)
    assert packets.read1ByteTxRx(port, 1, 65) == (1, OK, 0)
    assert packets.write2ByteTxRx(port, 1, 84, 555) == (OK, 0)
    assert packets.read2ByteTxRx(port, 1, 84) == (555, OK, 0)
    assert packets.write4ByteTxRx(port, 1, 112, 77) == (OK, 0)
    assert packets.read4ByteTxRx(port, 1, 112) == (77, OK, 0)
    assert packets.read4ByteTxRx(port, 4, 132) == (round(2048 - 0.1 * 4096 / 6.283185307), OK, 0)


def test_error_codes_arrive(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    assert packets.write1ByteTxRx(port, 1, 64, 2) == (OK, 4)
    assert packets.write2ByteTxRx(port, 1, 126, 2) == (OK, 7)
    assert packets.write2ByteTxRx(port, 6, 102, 0) == (OK, 7)
    assert packets.write2ByteTxRx(port, 1, 116, 0) == (OK, 5)


def test_reg_write_waits_for_action(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    packets.write1ByteTxRx(port, 2, 65, 0)
    assert packets.regWriteTxRx(port, 2, 65, 1, [1]) == (OK, 0)
    assert packets.read1ByteTxRx(port, 2, 65)[0] == 0
    assert packets.action(port, 2) == OK
    while port.getBytesAvailable() < 11:  # the SDK leaves the answer to ACTION unread, and would take it for the next
        time.sleep(0.001)
    assert packets.read1ByteTxRx(port, 2, 65)[0] == 1


@pytest.mark.parametrize("fast", [False, True])
def test_group_sync_read(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler, fast: bool) -> None:
    group = sdk.GroupSyncRead(port, packets, 126, 10)
    for servo_id in IDS:
        assert group.addParam(servo_id)
    assert (group.fastSyncRead() if fast else group.txRxPacket()) == OK
    for servo_id in IDS:
        assert group.isAvailable(servo_id, 132, 4)
    positions = [group.getData(i, 132, 4) for i in IDS]
    assert positions == [2048, 2178, 2178, 1983, 2048, 2048, 2048]


def test_group_sync_write_reaches_leaders_and_their_shadow(
    port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler
) -> None:
    group = sdk.GroupSyncWrite(port, packets, 100, 2)
    for servo_id in (1, 2, 4):
        assert group.addParam(servo_id, [servo_id, 0])
    assert group.txPacket() == OK
    assert [packets.read2ByteTxRx(port, i, 100)[0] for i in (1, 2, 3, 4)] == [1, 2, 2, 4]


@pytest.mark.parametrize("fast", [False, True])
def test_group_bulk_read(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler, fast: bool) -> None:
    group = sdk.GroupBulkRead(port, packets)
    for servo_id, address, length in ((1, 144, 2), (4, 132, 4), (7, 146, 1)):
        assert group.addParam(servo_id, address, length)
    assert (group.fastBulkRead() if fast else group.txRxPacket()) == OK
    assert [group.getData(1, 144, 2), group.getData(4, 132, 4), group.getData(7, 146, 1)] == [120, 1983, 25]


def test_group_bulk_write(port: sdk.PortHandler, packets: sdk.Protocol2PacketHandler) -> None:
    group = sdk.GroupBulkWrite(port, packets)
    assert group.addParam(1, 84, 2, [44, 1])
    assert group.addParam(7, 65, 1, [1])
    assert group.txPacket() == OK
    assert packets.read2ByteTxRx(port, 1, 84)[0] == 300
    assert packets.read1ByteTxRx(port, 7, 65)[0] == 1


def test_servo_moves_under_the_sdk(movable: Path, packets: sdk.Protocol2PacketHandler) -> None:
    port = sdk.PortHandler(str(movable))
    assert port.setBaudRate(1_000_000)
    assert packets.write1ByteTxRx(port, 5, 64, 1) == (OK, 0)
    assert packets.write4ByteTxRx(port, 5, 116, 2300) == (OK, 0)
    for _ in range(1000):
        if abs(packets.read4ByteTxRx(port, 5, 132)[0] - 2300) < 10:
            break
        time.sleep(0.01)
    else:
        pytest.fail("the servo did not reach its goal")
    assert packets.write1ByteTxRx(port, 5, 64, 0) == (OK, 0)
    port.closePort()


def test_wrong_baud_hears_nothing_until_it_is_set_right(
    path: Path, packets: sdk.Protocol2PacketHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    handler = sdk.PortHandler(str(path))
    handler.setBaudRate(57_600)
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 16)
    assert packets.ping(handler, 1)[1] == sdk.COMM_RX_TIMEOUT
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", SDK_MS)
    handler.setBaudRate(1_000_000)
    assert packets.ping(handler, 1)[1] == OK
    handler.closePort()


def test_port_can_be_opened_again_and_again(path: Path, packets: sdk.Protocol2PacketHandler) -> None:
    for _ in range(5):
        handler = sdk.PortHandler(str(path))
        handler.setBaudRate(1_000_000)
        assert packets.ping(handler, 3) == (1020, OK, 0)
        handler.closePort()


def test_easy_sdk_drives_motors_and_groups(movable: Path) -> None:
    connector = Connector(str(movable), 1_000_000)
    motors = connector.createAllMotors()
    assert [(m.id, m.model_name) for m in motors] == [
        (i, "xm430_w350.model" if i < 6 else "xl430_w250.model") for i in IDS
    ]
    elbow, gripper = motors[3], motors[6]
    elbow.disableTorque()
    elbow.setOperatingMode(OperatingMode.CURRENT_BASED_POSITION)
    assert elbow.getOperatingMode() == OperatingMode.CURRENT_BASED_POSITION
    elbow.enableTorque()
    elbow.setGoalCurrent(200)
    elbow.setGoalPosition(elbow.getPresentPosition())
    assert elbow.getPresentVelocity() == 0
    gripper.enableTorque()
    executor = connector.createGroupExecutor()
    executor.addCmd(elbow.stageGetPresentPosition())
    executor.addCmd(gripper.stageGetPresentPosition())
    assert executor.executeRead() == [1983, 2048]
    executor.addCmd(elbow.stageLEDOn())
    executor.addCmd(gripper.stageSetGoalPosition(2100))
    executor.executeWrite()
    assert elbow.isLEDOn() == 1
    for motor in (elbow, gripper):
        motor.disableTorque()
    elbow.setOperatingMode(OperatingMode.POSITION)
    connector.closePort()


def test_reboot_through_the_easy_sdk_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with emulator(tmp_path) as path:
        connector = Connector(str(path), 1_000_000)
        motor = connector.createMotor(5)
        motor.enableTorque()
        motor.reboot()
        monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 16)
        for _ in range(1000):  # silent while it boots
            if connector._packet_handler.ping(connector._port_handler, 5)[1] == OK:
                break
        monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", SDK_MS)
        assert motor.isTorqueOn() == 0
        connector.closePort()


def test_timed_bus_answers_the_sdk_too(tmp_path: Path, packets: sdk.Protocol2PacketHandler) -> None:
    with emulator(tmp_path, timing=True, baud=3_000_000, firmware=44) as path:
        handler = sdk.PortHandler(str(path))
        handler.setBaudRate(3_000_000)
        group = sdk.GroupSyncRead(handler, packets, 132, 4)
        for servo_id in IDS:
            group.addParam(servo_id)
        assert [group.txRxPacket() for _ in range(20)] == [OK] * 20
        handler.closePort()


def command(folder: Path, text: str) -> str:
    """Send a fault command to the control socket and return its answer."""
    own = folder / "answer"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as control:
        control.bind(str(own))
        control.settimeout(30.0)
        control.sendto(text.encode(), str(folder / "control"))
        answer = control.recv(1000).decode()
    own.unlink()
    return answer


def test_faults_are_taken_over_the_control_socket(
    tmp_path: Path, packets: sdk.Protocol2PacketHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    with emulator(tmp_path) as path:
        handler = sdk.PortHandler(str(path))
        handler.setBaudRate(1_000_000)
        assert command(tmp_path, json.dumps({"kind": "overload", "arm": "left", "servo": 2})) == "ok"
        assert packets.read1ByteTxRx(handler, 2, 70) == (0x20, OK, 0x80)
        assert "fault command: kind" in command(tmp_path, '{"kind": "fire", "arm": "left"}')
        assert command(tmp_path, json.dumps({"kind": "silent", "arm": "left", "servo": 1})) == "ok"
        monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 16)
        assert packets.ping(handler, 1)[1] == sdk.COMM_RX_TIMEOUT
        monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", SDK_MS)
        assert command(tmp_path, "clear") == "ok"
        assert packets.ping(handler, 1)[1] == OK
        handler.closePort()


def test_port_that_vanished_errors_its_client_and_returns(tmp_path: Path, packets: sdk.Protocol2PacketHandler) -> None:
    with emulator(tmp_path) as path:
        client = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert command(tmp_path, json.dumps({"kind": "port_loss", "arm": "left"})) == "ok"
        while path.is_symlink():
            time.sleep(0.001)
        with pytest.raises(OSError, match="Input/output error"):
            os.write(client, b"x")
        os.close(client)
        assert command(tmp_path, "clear") == "ok"
        while not path.is_symlink():
            time.sleep(0.001)
        handler = sdk.PortHandler(str(path))
        handler.setBaudRate(1_000_000)
        assert packets.ping(handler, 1)[1] == OK
        handler.closePort()
