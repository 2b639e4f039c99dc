"""A virtual port at which a packet of a phase, or two, get lost, their answers do, or with which the process ends.

Packets are counted from `count` to `rest`.  A process that is killed has written the whole of what it began to write:
the kernel sends that without it.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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
    """What happens to the packet of that number; servo: to which of several, None for all; then: to a later one."""

    what: What
    number: int
    servo: int | None = None
    then: Loss | None = None

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
        self.struck = False
        self.dead = False
        self.first_ns = 0  # when the first torque went out
        self._after = after
        self._due: dict[int, Loss] = {}
        self._counts = False
        self._writes = 0

    def count(self, loss: Loss | None) -> None:
        """The phase begins."""
        self.packets, self._counts, self._writes = [], True, 0
        while loss is not None:
            self._due[loss.number] = loss
            loss = loss.then

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
        bus, kept, spoiled, kills = self._line.bus, list[bytes](), dict[tuple[bytes, int], Loss](), False
        for packet in packets_of(data):
            loss = self._due.pop(len(self.packets), None)
            if loss is not None:
                self.struck, kills = True, kills or loss.kills
                if loss.what is not What.LOST:
                    spoiled[packet, kept.count(packet)] = loss
            if loss is None or loss.what is not What.LOST:
                kept.append(packet)
            self.packets.append(Packet(packet, self._writes, concerned(packet, bus.servos)))
        self._writes += 1
        if spoiled:
            spoil(bus, spoiled)
        try:
            if kept:
                super().write(b"".join(kept), deadline_ns)
        finally:
            if spoiled:
                heal(bus)
        self._after()
        if kills:
            self.dead = True
            raise Died

    def _need(self) -> None:
        if self.dead:
            raise Died
        super()._need()


def spoil(bus: Bus, losses: Mapping[tuple[bytes, int], Loss]) -> None:
    """Until `heal` these packets, and what answers them, fare as told; by bytes, and how many are equal before."""
    really = bus.responder.respond
    wanted = {(_command(packet), place): loss for (packet, place), loss in losses.items()}
    seen: Counter[tuple[int, int, bytes]] = Counter()

    def respond(command: Command, listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        this = command.servo_id, command.instruction, command.parameters
        loss = wanted.get((this, seen[this]))
        seen[this] += 1
        bus.tamper = None if loss is None else partial(_answer, loss)
        if loss is not None and loss.what is What.MISSED:
            listeners = [servo for servo in listeners if servo.id != loss.servo]
        return really(command, listeners, now_ns)

    responder: Any = bus.responder
    responder.respond = respond


def _command(packet: bytes) -> tuple[int, int, bytes]:
    """Servo, instruction and parameters, as a servo takes them from the packet."""
    return packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def _answer(loss: Loss, servo_id: int, data: bytes) -> list[Tampered]:
    """What becomes of a servo's answer."""
    if loss.servo not in (None, servo_id):
        return [Tampered(data, 0)]
    if loss.what is What.UNANSWERED:
        return []
    if loss.what is What.UNREADABLE:
        data = data[:-1] + bytes((data[-1] ^ 0x40,))
    return [Tampered(data, 0)]


def heal(bus: Bus) -> None:
    """As it was."""
    bus.tamper = None
    del bus.responder.respond  # type: ignore[attr-defined]  # the method of its class again
