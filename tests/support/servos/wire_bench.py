"""A host for emulated servos in tests: sends instructions, parses what comes back with a parser of its own."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import Register
from sim_backend.wire.bus import DEFAULTS, Bus
from sim_backend.wire.options import BusOptions
from sim_backend.wire.packet import crc16
from sim_backend.wire.servo import FACTORY, Servo, ServoOptions
from sim_backend.wire.timing import BusTiming

BAUD = 57_600  # as servos leave the factory
MS = 1_000_000


@dataclass(frozen=True)
class Answer:
    servo_id: int
    error: int
    data: bytes

    @property
    def value(self) -> int:
        return int.from_bytes(self.data, "little", signed=True)


def build(servo_id: int, code: int, parameters: bytes = b"") -> bytes:
    """Instruction packet; the stuffing is done byte by byte, unlike in what is tested."""
    body = bytearray()
    for byte in bytes((code,)) + parameters:
        body.append(byte)
        if body[-3:] == b"\xff\xff\xfd":
            body.append(0xFD)
    packet = b"\xff\xff\xfd\x00" + bytes((servo_id,)) + (len(body) + 2).to_bytes(2, "little") + bytes(body)
    return packet + crc16(packet).to_bytes(2, "little")


def answers(stream: bytes) -> list[Answer]:
    """Status packets back to back; anything else fails."""
    found = []
    while stream:
        assert stream[:4] == b"\xff\xff\xfd\x00"
        size = 7 + int.from_bytes(stream[5:7], "little")
        packet, stream = stream[:size], stream[size:]
        assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        assert packet[7] == 0x55
        body = bytearray()
        skip = False
        for byte in packet[8:-2]:
            if skip:
                assert byte == 0xFD
                skip = False
                continue
            body.append(byte)
            skip = body[-3:] == b"\xff\xff\xfd"
        found.append(Answer(packet[4], body[0], bytes(body[1:])))
    return found


def word(value: int) -> bytes:
    return value.to_bytes(2, "little")


class Bench:
    """Servos on a bus without timing, and a clock that the test moves."""

    def __init__(self, *servos: Servo, timing: BusTiming | None = None, options: BusOptions = DEFAULTS) -> None:
        self.bus = Bus(servos, timing, options)
        self.now_ns = 1_000 * MS
        self.baud = BAUD

    def raw(self, packet: bytes) -> bytes:
        self.bus.receive(packet, self.now_ns, self.baud)
        return self.bus.take(self.now_ns)

    def send(self, servo_id: int, code: int, parameters: bytes = b"") -> list[Answer]:
        return answers(self.raw(build(servo_id, code, parameters)))

    def one(self, servo_id: int, code: int, parameters: bytes = b"") -> Answer:
        (answer,) = self.send(servo_id, code, parameters)
        assert answer.servo_id == servo_id
        return answer

    def write(self, servo_id: int, register: Register, value: int) -> int:
        """Write one register; return the error byte."""
        data = value.to_bytes(register.length, "little", signed=value < 0)
        return self.one(servo_id, Instruction.WRITE, word(register.address) + data).error

    def read(self, servo_id: int, register: Register) -> int:
        answer = self.one(servo_id, Instruction.READ, word(register.address) + word(register.length))
        assert answer.error & 0x7F == 0
        return int.from_bytes(answer.data, "little", signed=register.signed)

    def sync_write(self, register: Register, values: dict[int, int]) -> None:
        entries = b"".join(
            bytes((i,)) + value.to_bytes(register.length, "little", signed=value < 0) for i, value in values.items()
        )
        assert self.send(0xFE, Instruction.SYNC_WRITE, word(register.address) + word(register.length) + entries) == []

    def pass_time(self, duration_ms: float, step_ms: float = 1.0) -> None:
        """Let time pass with physics and watchdogs, the horns held by the test."""
        end_ns = self.now_ns + round(duration_ms * MS)
        while self.now_ns < end_ns:
            self.now_ns += round(step_ms * MS)
            for servo in self.bus.servos:
                alive = servo.firmware.alive(self.now_ns)
                servo.firmware.body.step(step_ms * 1e-3, alive=alive)
                if alive:
                    servo.firmware.supervise(step_ms * 1e-3)
            self.bus.tick(self.now_ns)


def xm430(servo_id: int = 1, firmware: int = 46, options: ServoOptions = FACTORY, **eeprom: int) -> Servo:
    return Servo(SERVOS["XM430-W350"], servo_id, firmware=firmware, eeprom=names(eeprom), options=options)


def xl430(servo_id: int = 1, firmware: int = 46, options: ServoOptions = FACTORY, **eeprom: int) -> Servo:
    return Servo(SERVOS["XL430-W250"], servo_id, firmware=firmware, eeprom=names(eeprom), options=options)


def names(eeprom: dict[str, int]) -> dict[str, int]:
    """Keyword spelling to e-manual names: drive_mode -> Drive Mode."""
    known = {
        register.lower().replace(" ", "_").replace("(shadow)", ""): register
        for register in SERVOS["XM430-W350"].registers
    }
    return {known[key]: value for key, value in eeprom.items()}
