"""The half-duplex line of one arm: when a servo hears the host, and when the host can read what servos answer.

Bytes and times come in, bytes with due times come out; clocks and ports are outside.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from sim_backend.wire.options import BusOptions
from sim_backend.wire.packet import BROADCAST_ID, Damaged, InstructionParser
from sim_backend.wire.responder import Responder, Turn
from sim_backend.wire.servo import Servo
from sim_backend.wire.timing import BusTiming, Delivery, Line, UsbBuffer, byte_ns

BAUD_TOLERANCE = 0.03  # an FT232H makes 4.571 Mbit/s of 4.5, which works
DEFAULTS = BusOptions()


class Tampered(NamedTuple):
    """One appearance of a reply at the host, later by `extra_ns` than the wire would have it."""

    data: bytes
    extra_ns: int


class Tamper(Protocol):
    """Faults between the servos and the host."""

    def __call__(self, servo_id: int, data: bytes) -> list[Tampered]:
        """What becomes of a reply: nothing, one or several appearances."""
        ...


@dataclass(slots=True)
class BusCounters:
    """Cumulative since power-up."""

    instructions: int = 0
    replies: int = 0
    damaged: int = 0
    collisions: int = 0  # instructions sent while servos were talking; nobody understood them
    wrong_baud: int = 0
    watchdog_trips: int = 0


class Bus:
    """One line of servos.  `timing` None makes every reply available at once."""

    def __init__(
        self, servos: Sequence[Servo], timing: BusTiming | None = None, options: BusOptions = DEFAULTS
    ) -> None:
        self.servos = tuple(servos)
        self.counters = BusCounters()
        self.responder = Responder(options)
        self.tamper: Tamper | None = None
        self.talked_over = False  # a servo never stops talking: it garbles whatever anybody else says
        self._parser = InstructionParser(options.unstuffed_header)
        self._line = Line(timing)
        self._usb = UsbBuffer(timing.usb if timing else None)
        self._pending: list[tuple[int, int, bytes]] = []
        self._order = 0

    def receive(self, data: bytes, now_ns: int, baud: int) -> None:
        """Take bytes the host wrote at `now_ns` while its port was set to `baud`."""
        matching = [s for s in self.servos if abs(s.baud - baud) <= BAUD_TOLERANCE * s.baud]
        if not matching:
            self.counters.wrong_baud += 1
            self._parser.reset()
            return
        for place, packet in enumerate(self._parser.feed(data, now_ns)):
            listeners = [s for s in matching if s.hears(now_ns)]
            if not self._line.request(now_ns, packet.size, baud, queued=place > 0) or self.talked_over:
                self.counters.collisions += 1
            elif isinstance(packet, Damaged):
                self.counters.damaged += 1
                self._transmit(self.responder.complain(packet, listeners), baud)
            else:
                self.counters.instructions += 1
                for s in listeners:
                    s.firmware.heard_packet(now_ns, own=packet.servo_id in (BROADCAST_ID, s.id, s.secondary_id))
                self._transmit(self.responder.respond(packet, listeners, now_ns), baud)

    def take(self, now_ns: int) -> bytes:
        """Bytes the host can read at `now_ns`; they are handed over once."""
        for delivery in self._usb.settle(now_ns):
            self._queue(delivery)
        pending = self._pending
        if not pending or pending[0][0] > now_ns:
            return b""
        out = bytearray()
        while pending and pending[0][0] <= now_ns:
            out += heapq.heappop(pending)[2]
        return bytes(out)

    def due_ns(self) -> int | None:
        """When the next bytes become readable; None when nothing is on its way."""
        held_ns = self._usb.due_ns()
        if not self._pending:
            return held_ns
        first_ns = self._pending[0][0]
        return first_ns if held_ns is None else min(first_ns, held_ns)

    def tick(self, now_ns: int) -> int:
        """Let bus watchdogs fire; return how many did."""
        fired = 0
        for servo in self.servos:
            fired += servo.firmware.check_watchdog(now_ns)
        self.counters.watchdog_trips += fired
        return fired

    def inject(self, data: bytes, now_ns: int) -> None:
        """Noise: bytes that no servo sent."""
        self._queue(Delivery(now_ns, data))

    def clear(self) -> None:
        """Lose everything under way, as when the adapter is unplugged."""
        self._parser.reset()
        self._usb.clear()
        self._pending.clear()

    def _transmit(self, turns: list[Turn], baud: int) -> None:
        """Put turns on the line one after the other and hand them to the adapter, through the faults."""
        line, timing = self._line, self._line.timing
        byte_time_ns = byte_ns(baud) if timing else 0.0
        for servo, data, silent_bytes, merged in turns:
            if servo is None:
                line.wait(round(byte_time_ns * silent_bytes) + (timing.turnaround_ns if timing else 0))
                continue
            pause_ns = 0
            if timing:
                pause_ns = servo.return_delay_ns + (timing.fast_gap_ns if merged else timing.turnaround_ns)
            self.counters.replies += 1
            start_ns = line.reply(len(data), baud, pause_ns)
            for piece, extra_ns in self.tamper(servo.id, data) if self.tamper else (Tampered(data, 0),):
                if extra_ns:
                    self._queue(Delivery(start_ns + round(byte_time_ns * len(piece)) + extra_ns, piece))
                    continue
                for delivery in self._usb.push(start_ns, byte_time_ns, piece):
                    self._queue(delivery)

    def _queue(self, delivery: Delivery) -> None:
        self._order += 1
        heapq.heappush(self._pending, (delivery.due_ns, self._order, delivery.data))
