"""The pseudo terminal that serial clients open: stable path, speed, and what survives a client."""

from __future__ import annotations

import fcntl
import os
import re
import struct
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from sim_backend.wire.pty import PortTakenError, PtyPort

TIOCGEXCL = 0x80045440


@pytest.fixture
def port(tmp_path: Path) -> Iterator[PtyPort]:
    port = PtyPort(tmp_path / "dev" / "arm-left")
    port.appear()
    yield port
    port.vanish()
    assert list((tmp_path / "dev").iterdir()) == []


def arrived(port: PtyPort, count: int) -> bytes:
    """Bytes the client wrote; the kernel hands them over a moment later."""
    data = b""
    while len(data) < count:
        data += port.read()
    return data


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 3_000_000, 4_500_000])
def test_speed_is_what_the_client_set(port: PtyPort, baud: int) -> None:
    with serial.Serial(str(port.link), baud):
        assert port.baud() == baud


def test_bytes_pass_unchanged_both_ways(port: PtyPort) -> None:
    everything = bytes(range(256))
    with serial.Serial(str(port.link), 1_000_000, timeout=30) as client:
        client.write(everything)
        assert arrived(port, 256) == everything
        port.write(everything)
        assert client.read(256) == everything


def test_port_survives_its_clients(port: PtyPort) -> None:
    for number in range(3):
        with serial.Serial(str(port.link), 1_000_000) as client:
            client.write(bytes((number,)))
            assert arrived(port, 1) == bytes((number,))
        assert port.read() == b""


def test_exclusive_flag_of_a_dead_client_is_cleared(port: PtyPort) -> None:
    def exclusive(fd: int) -> int:
        return int(struct.unpack("i", fcntl.ioctl(fd, TIOCGEXCL, bytes(4)))[0])

    fd = os.open(port.link, os.O_RDWR | os.O_NOCTTY)
    fcntl.ioctl(fd, termios.TIOCEXCL)
    os.close(fd)
    port.forget_exclusive()
    fd = os.open(port.link, os.O_RDWR | os.O_NOCTTY)
    assert exclusive(fd) == 0
    os.close(fd)


def test_client_that_does_not_read_loses_bytes_and_blocks_nobody(port: PtyPort) -> None:
    for _ in range(200):
        port.write(bytes(1000))
    assert port.overrun_bytes > 0


def test_link_left_by_a_killed_emulator_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "arm"
    link.symlink_to("/dev/pts/999999")
    port = PtyPort(link)
    port.appear()
    assert link.is_char_device()
    port.vanish()
    assert not link.is_symlink()


@pytest.mark.parametrize(
    "target", ["../dev/ttyUSB0", "/dev/ttyUSB0", "/dev/pts", "/dev/pts/ptmx", "/x/dev/pts/1", "file"]
)
def test_a_link_that_leads_elsewhere_is_refused_and_stays(tmp_path: Path, target: str) -> None:
    """As that to the port of a real arm; `file` is there, the others need not be."""
    link = tmp_path / "arm"
    (tmp_path / "file").write_text("mine")
    link.symlink_to(target)
    port = PtyPort(link)
    with pytest.raises(
        PortTakenError,
        match=rf"^emulated port {link}: found a link to {re.escape(target)}, expected a free name, or .*--ports$",
    ):
        port.appear()
    assert not port.present
    assert link.readlink() == Path(target)
    assert {path.name for path in tmp_path.iterdir()} == {"arm", "file"}


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_no_link_is_refused_and_stays(tmp_path: Path, kind: str) -> None:
    name = tmp_path / "arm"
    name.write_text("mine") if kind == "file" else name.mkdir()
    with pytest.raises(PortTakenError, match="found something that is no link, expected a free name"):
        PtyPort(name).appear()
    assert list(tmp_path.iterdir()) == [name]
    assert not name.is_symlink()


def test_vanishing_leaves_the_link_of_a_successor_alone(tmp_path: Path) -> None:
    old, new = PtyPort(tmp_path / "arm"), PtyPort(tmp_path / "arm")
    old.appear()
    new.appear()
    old.vanish()
    assert (tmp_path / "arm").is_char_device()
    new.vanish()


def test_appearing_and_vanishing_twice_does_no_harm(port: PtyPort) -> None:
    port.appear()
    assert port.present
    port.vanish()
    port.vanish()
    assert not port.present
    assert port.fileno() == -1
