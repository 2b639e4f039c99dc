"""The serial port on a real pseudo terminal: exclusive, bounded, and every refusal names its remedy."""

from __future__ import annotations

import fcntl
import grp
import os
import stat
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import MonotonicClock
from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.dynamixel.line import ports
from drivers.dynamixel.line.port import SerialPort
from drivers.dynamixel.line.ports import holders, open_error, require_usable, way_in
from drivers.interface import DriverError

CLOCK = MonotonicClock()


@pytest.fixture
def pty():
    master, slave = os.openpty()
    os.set_blocking(master, False)
    ends = [master, slave]
    yield master, os.ttyname(slave), ends
    for fd in ends:
        os.close(fd)


def opened(path: str, baud: int = 1_000_000) -> SerialPort:
    port = SerialPort(path, baud, CLOCK)
    port.open()
    return port


def soon(ms: float) -> int:
    return CLOCK.now_ns() + round(ms * 1e6)


@pytest.mark.parametrize("in_use", [False, True])
def test_a_borrowed_port_is_made_ready_unless_somebody_is_in_an_exchange_on_it(pty, in_use: bool) -> None:
    master, path, (_, slave) = pty
    owner = opened(path, 57_600)
    os.write(master, b"R" * 40)  # an answer that the owner has not read yet
    attributes = termios.tcgetattr(slave)
    attributes[3] |= termios.ECHO
    termios.tcsetattr(slave, termios.TCSANOW, attributes)
    other = SerialPort(path, 1_000_000, CLOCK, lambda: os.dup(owner.fileno()), in_use=in_use)
    other.open()
    assert len(owner.read_now()) == (40 if in_use else 0)
    assert bool(termios.tcgetattr(slave)[3] & termios.ECHO) == in_use, "its settings"
    other.close()
    owner.close()


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 3_000_000, 4_000_000, 4_500_000])
def test_bytes_pass_unchanged_at_any_speed(pty, baud):
    master, path, _ = pty
    port = opened(path, baud)
    everything = bytes(range(256))
    port.write(everything, soon(100))
    assert os.read(master, 1000) == everything
    os.write(master, everything)
    assert port.read_until(soon(100)) == everything
    port.close()


def test_waits_end_at_their_deadline(pty):
    _, path, _ = pty
    port = opened(path)
    begin = time.monotonic()
    assert port.read_until(soon(20)) == b""
    assert time.monotonic() - begin >= 0.0199
    assert port.read_now() == b""
    port.close()


def test_old_input_can_be_thrown_away(pty):
    master, path, _ = pty
    port = opened(path)
    os.write(master, b"late reply")
    while not (count := port.discard_input()):
        pass
    assert count == 10
    assert port.read_now() == b""
    port.close()


@pytest.mark.parametrize("path", ["/dev/null", "/dev/zero", "a file"])
def test_what_is_no_serial_port_is_told_so_whoever_has_it_open(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if path == "a file":
        path = str(tmp_path / "file")
        Path(path).touch()
    monkeypatch.setattr(ports, "holders", lambda _: ["bash (1)"])
    for opens in (require_usable, opened):
        with pytest.raises(PortError, match=f"^port {path}: found not a terminal device, expected a serial port; "):
            opens(path)


def test_a_serial_port_that_others_have_is_told_so_and_one_that_nobody_has_is_left_closed(
    pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path, _ = pty
    before = sorted(Path("/proc/self/fd").iterdir())
    require_usable(path)
    assert sorted(Path("/proc/self/fd").iterdir()) == before
    monkeypatch.setattr(ports, "holders", lambda _: ["bash (1)"])
    with pytest.raises(PortError, match=r"in use by bash \(1\)"):
        require_usable(path)


@pytest.mark.fault("B4")
@pytest.mark.parametrize("step", ["flock", "tcsetattr", "ioctl"])
def test_a_port_that_goes_while_it_is_opened_is_a_refusal_and_left_closed(
    pty, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """A plug that makes and breaks contact: whoever opens it tries again."""
    master, path, ends = pty
    before = len(list(Path("/proc/self/fd").iterdir()))
    of: Any = termios if step == "tcsetattr" else fcntl
    then = getattr(of, step)

    def unplugged(*arguments: Any) -> Any:
        if master in ends:
            ends.remove(master)
            os.close(master)
        return then(*arguments)

    monkeypatch.setattr(of, step, unplugged)
    port = SerialPort(path, 1_000_000, CLOCK)
    with pytest.raises(PortError, match=f"^port {path}.*: found Input/output error, expected "):
        port.open()
    assert not port.is_open
    assert len(list(Path("/proc/self/fd").iterdir())) == before - 1, "the master's"


def test_a_stuck_port_is_an_error_at_the_deadline(pty):
    _, path, _ = pty
    port = opened(path)
    with pytest.raises(WriteTimeoutError, match="of 1000000 bytes taken"):
        port.write(bytes(1_000_000), soon(30))
    port.close()


def test_a_port_that_vanishes_is_an_error_and_closing_it_is_safe(pty):
    _, path, ends = pty
    port = opened(path)
    for fd in ends:
        os.close(fd)
    ends.clear()
    with pytest.raises(PortLostError, match="hung up"):
        port.read_until(soon(100))
    with pytest.raises(PortLostError, match=path):
        port.write(b"x", soon(100))
    port.close()
    port.close()
    with pytest.raises(PortLostError, match="closed"):
        port.read_now()


def test_second_user_is_told_who_the_first_is(pty):
    _, path, _ = pty
    script = (
        "import sys\n"
        "from drivers.clock import MonotonicClock\n"
        "from drivers.dynamixel.line.port import SerialPort\n"
        "port = SerialPort(sys.argv[1], 1000000, MonotonicClock())\n"
        "port.open()\n"
        "print('open', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout.readline() == "open\n"
        with pytest.raises(PortError, match=rf"in use by .*\({first.pid}\)"):
            opened(path)
        first.kill()
    opened(path).close()  # nothing of the killed one is left


def test_lock_is_released_on_close(pty):
    _, path, _ = pty
    opened(path).close()
    second = opened(path)
    second.open()  # twice is harmless
    second.close()


def test_missing_port_lists_what_is_there():
    with pytest.raises(PortError, match=r"nothing of that name.*ports here: "):
        opened("/dev/ttyUSB_not_there")


def test_a_file_is_not_a_port(tmp_path):
    path = tmp_path / "port"
    path.write_bytes(b"")
    with pytest.raises(PortError, match="not a terminal device"):
        opened(str(path))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open anything")
def test_missing_permission_names_the_way_in(pty):
    _, path, _ = pty
    Path(path).chmod(0)
    with pytest.raises(PortError, match=r"no permission .* install the udev rule"):
        opened(path)


def test_permission_refusal_names_mode_and_group(pty):
    _, path, _ = pty
    error = open_error(path, PermissionError(13, "denied"))
    group = grp.getgrgid(Path(path).stat().st_gid).gr_name
    assert f"group {group}" in str(error)


@pytest.mark.parametrize(
    ("mode", "group", "said"),
    [
        (0o660, "dialout", "usermod -aG dialout"),
        (0o620, "dialout", "udev rule"),
        (0o640, "tty", "udev rule"),
        (0o660, "root", "udev rule"),
    ],
)
def test_nobody_is_told_to_join_a_group_that_does_not_help_or_is_roots(mode, group, said):
    assert said in way_in(stat.S_IFCHR | mode, group)


def test_busy_device_is_named_as_such(pty):
    _, path, _ = pty
    error = open_error(path, OSError(16, "busy"))
    assert "in use by" in str(error)


def test_speed_can_be_changed(pty):
    _, path, ends = pty
    port = opened(path, 57_600)
    port.set_baud(3_000_000)
    assert port.baud == 3_000_000
    settings = struct.unpack("<4IB19s2I", fcntl.ioctl(ends[1], 0x802C542A, bytes(44)))  # TCGETS2
    assert settings[6:] == (3_000_000, 3_000_000)
    port.close()


def test_pseudo_terminals_have_no_latency_timer(pty):
    _, path, _ = pty
    port = opened(path)
    assert port.latency_timer_ms is None
    assert not port.low_latency
    port.close()


def test_terminal_is_raw(pty):
    _, path, ends = pty
    port = opened(path)
    iflag, oflag, cflag, lflag, *_ = termios.tcgetattr(ends[1])
    assert (iflag, oflag, lflag) == (0, 0, 0)
    assert cflag & termios.CSIZE == termios.CS8
    assert not cflag & (termios.PARENB | termios.CSTOPB | termios.CRTSCTS)
    port.close()


def test_holders_of_nothing():
    assert holders("/dev/ttyUSB_not_there") == []


def test_failures_are_driver_errors():
    assert issubclass(PortError, DriverError)
    assert issubclass(PortLostError, DriverError)
    assert issubclass(WriteTimeoutError, DriverError)
