"""One conversation at a time on one servo bus: requests, bounded waits, counters.

Two kinds of exchange.  `read`, `write`, `ping` are for setting up: they wait generously and retry.  A servo answers in
the order in which it is asked; so after a missed reply it is first asked what no other question is answered alike, and
once that answer is there, no older one can come and be taken for the next one's.  (The marks of these questions repeat:
an answer that is a third of a second late, with none after it, could be.)  `exchange` is for the cycle: one request and
one bounded wait.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from typing import NamedTuple

from drivers.dynamixel.errors import Heard, NoReplyError, RejectedError
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.codec import Status, StatusScanner
from drivers.dynamixel.line.group import GroupRead, GroupReply, Row
from drivers.dynamixel.line.port import Now, Port
from drivers.dynamixel.servo.codes import ALERT_BIT, BROADCAST_ID
from drivers.dynamixel.servo.table import Register
from drivers.interface import BusCounters

ATTEMPTS = 3
REPLY_WAIT_NS = 60_000_000  # beyond the wire time: the slowest latency timer (16 ms) and a stalled host
QUIET_NS = 25_000_000
QUIET_LIMIT_NS = 150_000_000
PING_BYTES = 3  # of the answer: model and firmware
MARKS = (5, 7, 8, 9)  # bytes from 0 on, which every servo has; no register, page or cycle is answered with so many
BABBLE_BYTES = 768  # more than any exchange of a cycle with its retry and a late reply: stop listening


@dataclass(slots=True)
class DxlCounters(BusCounters):
    """What happened on the bus since the first `connect`; per_servo: cycles in which a servo gave no fresh value."""

    late: int = 0  # intact replies to an earlier request
    stray_bytes: int = 0  # input thrown away before a request
    health_misses: int = 0  # health reads without an answer


class Ping(NamedTuple):
    """A servo that answered a ping."""

    servo_id: int
    model_number: int
    firmware: int


class Exchange(NamedTuple):
    """What one exchange of the cycle brought."""

    reply: GroupReply
    heard: bytes  # all that came, whatever it was


class Bus:
    """Transactions on an open port."""

    def __init__(self, port: Port, clock: Now, counters: DxlCounters) -> None:
        self.port = port
        self.counters = counters
        self._clock = clock
        self._owing: set[int] = set()  # servos whose answer to an earlier question may still come
        self._marks = cycle(MARKS)
        self._patient_until_ns: int | None = None  # None: always

    @contextmanager
    def patient(self, seconds: float) -> Generator[None]:
        """Meanwhile no question is asked again later than that: its NoReplyError comes sooner."""
        self._patient_until_ns = self._clock.now_ns() + round(seconds * 1e9)
        try:
            yield
        finally:
            self._patient_until_ns = None

    # --- setting up -----------------------------------------------------------------------------------------------

    def ping(self, servo_id: int, attempts: int = ATTEMPTS) -> Ping:
        """Model and firmware.  Raises NoReplyError."""
        reply = self._ask(codec.ping(servo_id), servo_id, PING_BYTES, "ping", attempts)
        return Ping(servo_id, int.from_bytes(reply.params[:2], "little"), reply.params[2])

    def ping_all(self, wait_s: float) -> list[Ping]:
        """Every servo that answers a broadcast ping within wait_s, an ID twice if two servos have it."""
        self.settle()
        scanner = StatusScanner()
        self._send(codec.ping(BROADCAST_ID))
        deadline_ns = self._clock.now_ns() + round(wait_s * 1e9)
        found = []
        while self._clock.now_ns() < deadline_ns:
            scanner.feed(self.port.read_until(deadline_ns))
            while (reply := scanner.take()) is not None:
                if len(reply.params) == PING_BYTES:
                    model = int.from_bytes(reply.params[:2], "little")
                    found.append(Ping(reply.servo_id, model, reply.params[2]))
        self.counters.corrupt += scanner.damaged
        return found

    def read(self, servo_id: int, register: Register) -> int:
        """Value of one register.  Raises NoReplyError, RejectedError."""
        data = self.read_bytes(servo_id, register.address, register.length)
        return int.from_bytes(data, "little", signed=register.signed)

    def read_bytes(self, servo_id: int, address: int, length: int) -> bytes:
        """Consecutive bytes of the control table.  Raises NoReplyError, RejectedError."""
        what = f"read of {length} bytes at {address}"
        return self._ask(codec.read(servo_id, address, length), servo_id, length, what, ATTEMPTS).params

    def read_all(
        self, address: int, fields: str, servo_ids: Sequence[int], wait_ns: int = REPLY_WAIT_NS
    ) -> dict[int, Row]:
        """Fields as of `GroupRead`, by ID, of the servos that answer one question to all.  Once, on a quiet line."""
        group = GroupRead(address, fields, servo_ids, fast=False)  # not fast: one that is silent hides no other
        rows = self.exchange(group, self._clock.now_ns() + wait_ns).reply.rows
        found = zip(servo_ids, rows, strict=True)
        return {servo_id: row[1:] for servo_id, row in found if row is not None and not row[0] & ~ALERT_BIT}

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Write one register and wait for the servo's word that it did.  Raises NoReplyError, RejectedError."""
        data = value.to_bytes(register.length, "little", signed=value < 0)
        what = f"write of {value} to {register.name} ({register.address})"
        self._ask(codec.write(servo_id, register.address, data), servo_id, 0, what, ATTEMPTS)

    def write_blind(self, register: Register, values: Mapping[int, int]) -> None:
        """Write one register of several servos without any answer."""
        self.write_all_blind([(register, values)])

    def write_all_blind(self, writes: Sequence[tuple[Register, Mapping[int, int]]]) -> None:
        """The same for several registers, in this order and in one piece: who is killed has sent all or nothing."""
        packets = b""
        for register, values in writes:
            data = {i: value.to_bytes(register.length, "little", signed=value < 0) for i, value in values.items()}
            packets += codec.sync_write(register.address, register.length, data)
        self._send(packets)

    def settle(self) -> None:
        """Throw away input until the line has been quiet for a while, bounded even on a babbling bus."""
        limit_ns = self._clock.now_ns() + QUIET_LIMIT_NS
        while self._clock.now_ns() < limit_ns:
            if not self.port.read_until(self._clock.now_ns() + QUIET_NS):
                return

    def _send(self, packet: bytes) -> None:
        wire_ns = len(packet) * 10_000_000_000 // self.port.baud
        self.port.write(packet, self._clock.now_ns() + wire_ns + REPLY_WAIT_NS)

    def _ask(self, packet: bytes, servo_id: int, length: int, what: str, attempts: int) -> Status:
        """Send until an intact reply of that servo with that many parameters comes, which is no older question's."""
        heard = Heard.NOTHING
        for attempt in range(attempts):
            if attempt:
                if self._patient_until_ns is not None and self._clock.now_ns() > self._patient_until_ns:
                    attempts = attempt
                    break
                self.counters.retries += 1
                self.settle()
            reply, came = self._attempt(packet, servo_id, length)
            if reply is None:
                heard = max(heard, came, key=lambda h: h.rank)
                continue
            self.counters.alerts += reply.alert
            if reply.error:
                raise RejectedError(servo_id, what, reply.error)
            return reply
        raise NoReplyError(servo_id, what, attempts=attempts, heard=heard)

    def _attempt(self, packet: bytes, servo_id: int, length: int) -> tuple[Status | None, Heard]:
        """One question, once no answer to an older one can come any more; pings are all answered alike."""
        if length != PING_BYTES and servo_id in self._owing:
            mark = next(self._marks)
            passed, heard = self._once(codec.read(servo_id, 0, mark), servo_id, mark)
            if passed is None:
                return None, heard
        return self._once(packet, servo_id, length)

    def _once(self, packet: bytes, servo_id: int, length: int) -> tuple[Status | None, Heard]:
        """Send, and wait for the reply; what came instead of one."""
        if length != PING_BYTES:
            self._owing.add(servo_id)
        self.port.discard_input()
        self._send(packet)
        scanner = StatusScanner()
        wire_ns = (len(packet) + length + 11) * 10_000_000_000 // self.port.baud
        deadline_ns = self._clock.now_ns() + wire_ns + REPLY_WAIT_NS
        reply, others = self._await(scanner, deadline_ns, servo_id, length)
        self.counters.corrupt += scanner.damaged
        if reply is None:
            self.counters.timeouts += 1
            return None, _heard(scanner, others)
        if length != PING_BYTES:
            self._owing.discard(servo_id)
        return reply, Heard.NOTHING

    def _await(self, scanner: StatusScanner, deadline_ns: int, servo_id: int, length: int) -> tuple[Status | None, int]:
        """The first reply of that servo that says no, or has that many parameters; and how many others came."""
        others = 0
        while True:
            scanner.feed(self.port.read_until(deadline_ns))
            final = self._clock.now_ns() >= deadline_ns
            while (reply := scanner.take(final=final)) is not None:
                if reply.servo_id == servo_id and (reply.error or len(reply.params) == length):
                    return reply, others
                others += 1
            if final:
                return None, others

    # --- the cycle ------------------------------------------------------------------------------------------------

    def exchange(self, group: GroupRead, deadline_ns: int) -> Exchange:
        """One group read: send, then wait until the answer is whole or the deadline has passed.

        The caller has thrown away older input.  Never raises for what the servos do; an incomplete reply says so.
        """
        self.port.write(group.request, deadline_ns)
        heard = b""
        while True:
            heard += self.port.read_until(deadline_ns)
            final = len(heard) > BABBLE_BYTES or self._clock.now_ns() >= deadline_ns
            if final or group.worth_parsing(heard):
                reply = group.parse(heard, final=final)
                if reply.finished:
                    return Exchange(reply, heard)


def _heard(scanner: StatusScanner, others: int) -> Heard:
    """What an exchange brought instead of its answer."""
    if scanner.damaged or scanner.cut:
        return Heard.DAMAGED
    if others:
        return Heard.OTHER
    if scanner.foreign:
        return Heard.ECHO
    return Heard.NOISE if scanner.garbage else Heard.NOTHING
