"""A virtual port at which one packet of a phase gets lost, its answer does, or with which the process ends.

Packets are counted from `count` to `rest`.  A process that is killed has written the whole of what it began to write:
the kernel sends that without it.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from agent.faults import virtual
from drivers.dynamixel.servo.codes import BROADCAST_ID, Instruction
from sim_backend.wire.bus import Bus, Tampered
from sim_backend.wire.packet import Command
from sim_backend.wire.responder import Turn
from sim_backend.wire.servo import Servo
from tests.support.servos.dxl_rig import VirtualPort, packets_of
from tests.support.servos.guarded_rig import GOALS, Died

_GROUPS = {Instruction.SYNC_READ: 1, Instruction.FAST_SYNC_READ: 1, Instruction.SYNC_WRITE: 0}


class What(enum.Enum):
    """What becomes of one packet."""

    LOST = "the instruction is lost"
    MISSED = "one of several servos misses the instruction"
    UNANSWERED = "the answer is lost"
    UNREADABLE = "the answer's checksum is wrong"
    LAST = "the process is killed once it is written"
    ALONE = "the process is killed once it is written, and nobody takes over"


@dataclass(frozen=True)
class Loss:
    """What happens to the packet of that number; servo: to which of several, None for all."""

    what: What
    number: int
    servo: int | None = None

    @property
    def kills(self) -> bool:
        """Whether the process ends."""
        return self.what in (What.LAST, What.ALONE)


@dataclass(frozen=True)
class Packet:
    """One that has been sent: its bytes, in which write, and which servos it concerns."""

    data: bytes
    write: int
    servos: tuple[int, ...]

    @property
    def answered(self) -> bool:
        """Whether anybody answers it."""
        return self.data[7] not in (Instruction.SYNC_WRITE, Instruction.BULK_WRITE)


def concerned(packet: bytes, servos: Sequence[Servo]) -> tuple[int, ...]:
    """IDs of those that do something with it, a shadow with what is written to the servo that it follows."""
    target, instruction = packet[4], packet[7]
    every = tuple(servo.id for servo in servos)
    if instruction == Instruction.SYNC_WRITE:
        size = 1 + int.from_bytes(packet[10:12], "little")
        named = set(packet[12:-2:size])
    elif instruction in _GROUPS:
        return tuple(i for i in packet[12:-2] if i in every)
    elif target == BROADCAST_ID:
        return every
    else:
        named = {target}
    writes = instruction in (Instruction.SYNC_WRITE, Instruction.WRITE)
    return tuple(servo.id for servo in servos if servo.id in named or (writes and servo.secondary_id in named))


class LossyPort(VirtualPort):
    """One process's port; after: is called once what was written has done what it does."""

    def __init__(self, line: virtual.Line, baud: int, after: Callable[[], None] = lambda: None) -> None:
        super().__init__(line, baud)
        self.packets: list[Packet] = []  # of the phase
        self.loss: Loss | None = None
        self.struck = False
        self.dead = False
        self.first_ns = 0  # when the first torque went out
        self._after = after
        self._counts = False
        self._writes = 0

    def count(self, loss: Loss | None) -> None:
        """The phase begins."""
        self.packets, self.loss, self._counts, self._writes = [], loss, True, 0

    def rest(self) -> None:
        """It is over: nothing gets lost any more."""
        self._counts = False

    def write(self, data: bytes, deadline_ns: int) -> None:
        self._need()
        if not self.first_ns and data[7] == Instruction.SYNC_WRITE and data[8:10] in GOALS:
            self.first_ns = self._line.clock.now_ns()
        if not self._counts:
            super().write(data, deadline_ns)
            self._after()
            return
        bus, loss, kept, struck = self._line.bus, self.loss, b"", None
        for packet in packets_of(data):
            if loss is not None and loss.number == len(self.packets):
                self.struck, struck = True, packet
            if struck is not packet or loss is None or loss.what is not What.LOST:
                kept += packet
            self.packets.append(Packet(packet, self._writes, concerned(packet, bus.servos)))
        self._writes += 1
        if struck is not None and loss is not None:
            spoil(bus, struck, loss)
        try:
            if kept:
                super().write(kept, deadline_ns)
        finally:
            if struck is not None:
                heal(bus)
        self._after()
        if struck is not None and loss is not None and loss.kills:
            self.dead = True
            raise Died

    def _need(self) -> None:
        if self.dead:
            raise Died
        super()._need()


def spoil(bus: Bus, packet: bytes, loss: Loss) -> None:
    """Until `heal` one packet, and what answers it, fares as told."""
    really = bus.responder.respond
    spoiled = False
    wanted = packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")

    def respond(command: Command, listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        nonlocal spoiled
        this = not spoiled and (command.servo_id, command.instruction, command.parameters) == wanted
        spoiled = spoiled or this
        bus.tamper = tamper if this else None
        if this and loss.what is What.MISSED:
            listeners = [servo for servo in listeners if servo.id != loss.servo]
        return really(command, listeners, now_ns)

    def tamper(servo_id: int, data: bytes) -> list[Tampered]:
        if loss.servo not in (None, servo_id):
            return [Tampered(data, 0)]
        if loss.what is What.UNANSWERED:
            return []
        if loss.what is What.UNREADABLE:
            data = data[:-1] + bytes((data[-1] ^ 0x40,))
        return [Tampered(data, 0)]

    responder: Any = bus.responder
    responder.respond = respond


def heal(bus: Bus) -> None:
    """As it was."""
    bus.tamper = None
    del bus.responder.respond  # type: ignore[attr-defined]  # the method of its class again
