"""Servos that still speak Protocol 1.0: found by ping, so that a person learns why they do not answer.

Through the official SDK, for the rest of this stack does not know that protocol; only its wait is bounded here, which
on a line that never falls silent has no end, and its port is kept from others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import dynamixel_sdk as sdk

from drivers.dynamixel.errors import PortError
from drivers.dynamixel.line.ports import claim
from drivers.dynamixel.servo.codes import MAX_ID

BAUDS = (1_000_000, 57_600)  # as AX and MX servos leave the factory
REFLASHABLE = {29: "MX-28", 310: "MX-64"}  # model number under Protocol 1.0
IDS = range(MAX_ID + 1)
PING_S = 1.0  # the SDK gives up by itself after 0.034 s


class OldServo(NamedTuple):
    """A servo that answered in Protocol 1.0."""

    baud: int
    servo_id: int
    model_number: int

    @property
    def remedy(self) -> str:
        """What its owner can do."""
        name = REFLASHABLE.get(self.model_number)
        if name is None:
            return "Protocol 1.0: this stack cannot drive it"
        return f"Protocol 1.0 {name}: give it Protocol 2.0 firmware with DYNAMIXEL Wizard 2.0"


class _BoundedPort(sdk.PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's port, whose reads end; opened once for all speeds, and kept from others."""

    deadline_s = 0.0

    def setupPort(self, cflag_baud: int) -> bool:
        """Called by the SDK for each speed.  Raises PortError where another program has the port, OSError."""
        if self.is_open:
            self.ser.baudrate = cflag_baud
            self.ser.reset_input_buffer()
            self.tx_time_per_byte = 1e4 / cflag_baud  # ms
        else:
            super().setupPort(cflag_baud)
            claim(self.ser.fileno(), self.port_name)
        return True

    def readPort(self, length: int) -> bytes:
        """Called by the SDK until its packet is whole or its own time is over.  Raises PortError after PING_S."""
        if time.monotonic() > self.deadline_s:
            raise PortError(
                f"port {self.port_name}", found="bytes without end", expected="silence until a servo is asked",
                remedy="another program or adapter talks on this bus: unplug what does not belong",
            )  # fmt: skip
        return bytes(super().readPort(length))


def find(
    path: str, bauds: Sequence[int], tell: Callable[[str], None], ids: Iterable[int] | None = None
) -> list[OldServo]:
    """Ping every ID at each speed; 9 s per speed for all of them.  Raises PortError."""
    port, packets = _BoundedPort(path), sdk.PacketHandler(1.0)
    wanted = tuple(IDS if ids is None else ids)
    found = []
    try:
        for baud in bauds:
            tell(f"looking for Protocol 1.0 at {baud} bit/s")
            if not port.setBaudRate(baud):
                tell(f"the SDK does not know {baud} bit/s")
                continue
            for servo_id in wanted:
                port.deadline_s = time.monotonic() + PING_S
                model_number, result, _ = packets.ping(port, servo_id)
                if result == sdk.COMM_SUCCESS:
                    found.append(OldServo(baud, servo_id, model_number))
    except OSError as error:  # pyserial's own is one
        raise PortError(
            f"port {path}", found=str(error), expected="a serial port that can be opened", remedy="check the adapter"
        ) from error
    finally:
        if port.ser is not None:
            port.closePort()
    return found
