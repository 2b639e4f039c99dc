"""A stock Mark II's servos speak Protocol 1.0: `coop motors scan --protocol-1` says so, and never hangs."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from agent.motors.find import survey_old
from drivers.clock import MonotonicClock
from drivers.dynamixel.errors import PortError
from drivers.dynamixel.line import protocol1
from drivers.dynamixel.line.port import SerialPort

AX_12A, MX_28, PING, READ = 12, 29, 1, 2

pytestmark = pytest.mark.realtime


def status(servo_id: int, data: bytes = b"") -> bytes:
    body = bytes((servo_id, len(data) + 2, 0)) + data
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def answers(servos: dict[int, int]) -> Callable[[bytes], bytes]:
    """Protocol 1.0 servos: ID -> model number.  Knows ping and the read of the model number."""

    def answer(request: bytes) -> bytes:
        out = b""
        for packet in filter(None, request.split(b"\xff\xff")):
            servo_id, instruction = packet[0], packet[2]
            if servo_id in servos and instruction == PING:
                out += status(servo_id)
            elif servo_id in servos and packet[2:5] == bytes((READ, 0, 2)):
                out += status(servo_id, servos[servo_id].to_bytes(2, "little"))
        return out

    return answer


@contextmanager
def line(answer: Callable[[bytes], bytes], *, unasked: bool = False) -> Iterator[str]:
    """A pty with servos behind it; unasked: what answers does not wait for a request."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            asked, _, _ = select.select((master,), (), (), 0.0 if unasked else 0.05)
            request = os.read(master, 256) if asked else b""
            if request or unasked:
                with contextlib.suppress(BlockingIOError):
                    os.write(master, answer(request))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        stop.set()
        thread.join()
        os.close(slave)
        os.close(master)


def test_old_servos_are_named_with_what_can_be_done() -> None:
    told: list[str] = []
    with line(answers({2: MX_28, 5: AX_12A})) as path:
        found = protocol1.find(path, [1_000_000], told.append, ids=range(1, 8))
    assert found == [(1_000_000, 2, MX_28), (1_000_000, 5, AX_12A)]
    assert [servo.remedy for servo in found] == [
        "Protocol 1.0 MX-28: give it Protocol 2.0 firmware with DYNAMIXEL Wizard 2.0",
        "Protocol 1.0: this stack cannot drive it",
    ]
    assert told == ["looking for Protocol 1.0 at 1000000 bit/s"]


def test_they_are_listed_as_servos_with_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol1, "IDS", range(3))
    with line(answers({2: MX_28})) as path:
        (servo,) = survey_old(path, [57_600], lambda _: None)
    assert (servo.servo_id, servo.baud, servo.model_number, servo.firmware) == (2, 57_600, MX_28, None)
    assert "Protocol 2.0 firmware" in servo.note


def test_nobody_else_comes_to_the_port_until_all_speeds_were_asked() -> None:
    refused: list[bool] = []

    def come(_: str) -> None:
        port = SerialPort(path, 1_000_000, MonotonicClock())
        try:
            port.open()
        except PortError as error:
            refused.append("in use by" in str(error))
        else:
            refused.append(False)
            port.close()

    with line(answers({2: MX_28})) as path:
        found = protocol1.find(path, [1_000_000, 57_600], come, ids=[2])
        come("it is over")
    assert refused == [False, True, False]
    assert [servo.baud for servo in found] == [1_000_000, 57_600]


def test_each_speed_is_that_of_the_line_while_it_is_asked() -> None:
    speeds: list[int] = []

    def noted(request: bytes) -> bytes:
        looking = os.open(path, os.O_RDWR | os.O_NOCTTY)
        speeds.append(termios.tcgetattr(looking)[4])
        os.close(looking)
        return answers({})(request)

    with line(noted) as path:
        protocol1.find(path, [1_000_000, 57_600], lambda _: None, ids=[2])
    assert speeds == [termios.B1000000, termios.B57600]


def test_a_port_that_somebody_has_meanwhile_is_left_alone() -> None:
    with line(answers({2: MX_28})) as path:
        port = SerialPort(path, 1_000_000, MonotonicClock())
        port.open()
        with pytest.raises(PortError, match="in use by"):
            protocol1.find(path, [1_000_000], lambda _: None, ids=[2])
        port.close()


def test_noise_without_end_is_refused_and_not_listened_to_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol1, "PING_S", 0.05)
    with (
        line(lambda _: bytes(4096), unasked=True) as path,
        pytest.raises(PortError, match="found bytes without end"),
    ):
        protocol1.find(path, [1_000_000], lambda _: None, ids=range(200))


def test_a_speed_that_the_sdk_does_not_know_is_told() -> None:
    told: list[str] = []
    with line(answers({})) as path:
        assert protocol1.find(path, [4_500_000], told.append, ids=[1]) == []
    assert told[-1] == "the SDK does not know 4500000 bit/s"


def test_a_port_that_is_not_there_is_refused() -> None:
    with pytest.raises(PortError, match="expected a serial port that can be opened"):
        protocol1.find("/dev/coop-not-there", [1_000_000], lambda _: None)
