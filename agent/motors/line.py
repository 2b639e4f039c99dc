"""The servo line of one port, opened for a tool: alone on it, and with bounded waits.

The tools use the driver's own bus, and not the official SDK that the project otherwise takes for setting up, because on
the same emulated servos the SDK

- shows one servo, or none, where two share an ID: its broadcast ping keeps one entry per ID and drops damaged replies,
  so exactly the mistake that a set-up tool is there for stays unseen;
- takes a port that another program is using: it locks nothing, and two programs on one bus break each other's packets;
- writes what contains FF FF FD without its stuffing byte, which a negative Homing Offset can;
- waits busily, by the wall clock, and 34 ms beyond every reply that does not come;
- drops the alert bit in group reads and does not know 4.5 Mbit/s.

The SDK is used where it knows more: Protocol 1.0 (`drivers.dynamixel.line.protocol1`), and in tests, as the independent
witness that reads back what these tools wrote.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.clock import MonotonicClock
from drivers.dynamixel.errors import PortError
from drivers.dynamixel.line.bus import QUIET_NS, Bus, DxlCounters
from drivers.dynamixel.line.port import Now, SerialPort
from drivers.dynamixel.line.ports import candidates, require_usable

DEFAULT_BAUD = 1_000_000


def ports() -> list[str]:
    """Serial ports of this machine, each once, by the name that stays when the cable moves to another socket."""
    by_device: dict[Path, str] = {}
    for path in candidates():  # lasting names come first
        by_device.setdefault(Path(path).resolve(), path)
    return list(by_device.values())


@contextmanager
def open_line(path: str, baud: int = DEFAULT_BAUD) -> Iterator[Bus]:
    """The bus on a serial port, closed again at the end.

    Raises PortError: not there, no permission, no serial port, in use (also without a lock), not silent.
    """
    require_usable(path)
    clock = MonotonicClock()
    port = SerialPort(path, baud, clock)
    port.open()
    try:
        bus = Bus(port, clock, DxlCounters())
        refuse_noise(bus, path, clock)
        yield bus
    finally:
        port.close()


def refuse_noise(bus: Bus, path: str, clock: Now) -> None:
    """Raise PortError when the line does not fall silent: servos speak only when asked."""
    bus.settle()
    if bus.port.read_until(clock.now_ns() + QUIET_NS):
        raise PortError(
            f"port {path}",
            found="bytes that nobody asked for",
            expected="silence until a servo is asked",
            remedy="another program or adapter talks on this bus, or it picks up noise: unplug what does not belong",
        )
