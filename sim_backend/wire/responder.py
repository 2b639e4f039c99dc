"""Which servos of a line execute an instruction and what each one answers, in order.

When bytes travel is decided in bus.py.
Source: ROBOTIS e-manual, Protocol 2.0 and Secondary ID; open questions are switches in options.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from drivers.dynamixel.servo.codes import Instruction, StatusError
from sim_backend.wire.options import BusOptions, SilentPredecessor
from sim_backend.wire.packet import BROADCAST_ID, MAX_LENGTH, Command, Damaged, FastBlock, fast_status, status_packet
from sim_backend.wire.servo import Servo

STATUS_OVERHEAD = 11  # bytes of a status packet without parameters
FAST_OVERHEAD = 4  # bytes around the data of one servo in a merged reply

Item = tuple[int, int, int]  # ID, address, length


class Turn(NamedTuple):
    """One slot on the line: a servo's bytes, or the time that the next one waits for a servo that stays silent."""

    servo: Servo | None
    data: bytes = b""
    silent_bytes: int = 0
    merged: bool = False  # continues the merged reply of the servo before it


class Responder:
    """The servos of one line as a whole."""

    def __init__(self, options: BusOptions) -> None:
        self.options = options
        self.malformed = 0  # instructions whose parameters make no sense

    def respond(self, command: Command, listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        """Execute an instruction on the servos that hear it; return what they put on the line."""
        target, parameters = command.servo_id, command.parameters
        match command.instruction:
            case Instruction.STATUS:
                return []
            case Instruction.SYNC_READ:
                return self._read_each(self._sync_items(parameters), listeners, now_ns)
            case Instruction.FAST_SYNC_READ:
                return self._read_merged(self._sync_items(parameters), listeners, now_ns)
            case Instruction.BULK_READ:
                return self._read_each(self._bulk_items(parameters), listeners, now_ns)
            case Instruction.FAST_BULK_READ:
                return self._read_merged(self._bulk_items(parameters), listeners, now_ns)
            case Instruction.SYNC_WRITE:
                return self._sync_write(parameters, listeners)
            case Instruction.BULK_WRITE:
                return self._bulk_write(parameters, listeners)
        if target == BROADCAST_ID:
            return self._broadcast(command, listeners, now_ns)
        return self._unicast(command, listeners, now_ns)

    def complain(self, packet: Damaged, listeners: Sequence[Servo]) -> list[Turn]:
        """Answer a packet whose CRC is wrong, if servos do that."""
        if not self.options.answers_damaged:
            return []
        addressed = [s for s in listeners if s.id == packet.servo_id and s.status_return_level == 2]
        return _overlaid([_status(s, s.id, StatusError.CRC) for s in addressed])

    # --- one servo ------------------------------------------------------------------------------------------------

    def _unicast(self, command: Command, listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        turns = []
        target, instruction = command.servo_id, command.instruction
        for servo in listeners:
            if servo.id == target:
                level = servo.status_return_level
                alerted = servo.error_byte(StatusError.NONE)  # a reboot clears it after the answer
                error, data = _execute(servo, command, now_ns)
                needed = 0 if instruction == Instruction.PING else 1 if instruction == Instruction.READ else 2
                if level >= needed:
                    turns.append(_status(servo, target, error, data, alerted))
            elif servo.secondary_id == target:
                _execute_as_shadow(servo, command)
        return _overlaid(turns)

    def _broadcast(self, command: Command, listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        in_order = sorted(listeners, key=lambda servo: servo.id)
        if command.instruction == Instruction.PING:
            turns = []
            for servo_id in dict.fromkeys(servo.id for servo in in_order):
                same = [_status(s, servo_id, StatusError.NONE, s.ping()) for s in in_order if s.id == servo_id]
                turns += _overlaid(same)
            return turns
        if command.instruction != Instruction.READ:
            for servo in in_order:
                _execute(servo, command, now_ns, broadcast=True)
        return []

    # --- groups ---------------------------------------------------------------------------------------------------

    def _sync_items(self, parameters: bytes) -> list[Item]:
        if len(parameters) < 5:
            self.malformed += 1
            return []
        address, length = _word(parameters, 0), _word(parameters, 2)
        return [(servo_id, address, length) for servo_id in parameters[4:]]

    def _bulk_items(self, parameters: bytes) -> list[Item]:
        if not parameters or len(parameters) % 5:
            self.malformed += 1
            return []
        starts = range(0, len(parameters), 5)
        return [(parameters[at], _word(parameters, at + 1), _word(parameters, at + 3)) for at in starts]

    def _read_each(self, items: list[Item], listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        """Status packets one after the other, each servo waiting for the one before it."""
        turns = []
        for servo_id, address, length in items:
            same = [s for s in listeners if s.id == servo_id and s.status_return_level >= 1 and not s.muted]
            if same:
                turns += _overlaid([_status(s, servo_id, *_found(s.read(address, length, now_ns))) for s in same])
            elif self.options.silent_predecessor is SilentPredecessor.ENDS_REPLY:
                break
            else:
                turns.append(Turn(None, silent_bytes=STATUS_OVERHEAD + length))
        return turns

    def _read_merged(self, items: list[Item], listeners: Sequence[Servo], now_ns: int) -> list[Turn]:
        """One merged status packet; a servo that does not take part ends it."""
        announced = sum(length + FAST_OVERHEAD for _, _, length in items)
        if announced >= MAX_LENGTH:
            self.malformed += 1
            return []
        blocks, senders = [], []
        by_id = {servo.id: servo for servo in listeners}
        for servo_id, address, length in items:
            servo = by_id.get(servo_id)
            if servo is None or servo.muted or not servo.fast_reads or servo.status_return_level < 1:
                break
            error, data = _found(servo.read(address, length, now_ns))
            blocks.append(FastBlock(servo_id, servo.error_byte(error), data or bytes(length)))
            senders.append(servo)
        pieces = fast_status(blocks, announced)
        return [Turn(s, piece, merged=i > 0) for i, (s, piece) in enumerate(zip(senders, pieces, strict=True))]

    def _sync_write(self, parameters: bytes, listeners: Sequence[Servo]) -> list[Turn]:
        length = _word(parameters, 2) if len(parameters) >= 4 else 0
        if length == 0 or (len(parameters) - 4) % (length + 1):
            self.malformed += 1
            return []
        address = _word(parameters, 0)
        starts = range(4, len(parameters), length + 1)
        _write_each({parameters[at]: (address, parameters[at + 1 : at + 1 + length]) for at in starts}, listeners)
        return []

    def _bulk_write(self, parameters: bytes, listeners: Sequence[Servo]) -> list[Turn]:
        writes = {}
        at = 0
        while at + 5 < len(parameters):
            end = at + 5 + _word(parameters, at + 3)
            writes[parameters[at]] = (_word(parameters, at + 1), parameters[at + 5 : end])
            at = end
        if at != len(parameters) or not writes or not all(data for _, data in writes.values()):
            self.malformed += 1
            return []
        _write_each(writes, listeners)
        return []


def _word(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8


def _found(result: bytes | StatusError) -> tuple[StatusError, bytes]:
    return (result, b"") if isinstance(result, StatusError) else (StatusError.NONE, result)


def _status(servo: Servo, servo_id: int, error: StatusError, data: bytes = b"", alerted: int = 0) -> Turn:
    return Turn(servo, status_packet(servo_id, servo.error_byte(error) | alerted, data))


def _execute(servo: Servo, command: Command, now_ns: int, *, broadcast: bool = False) -> tuple[StatusError, bytes]:
    """Execute an instruction for a single servo; return its error and reply data."""
    parameters = command.parameters
    match command.instruction:
        case Instruction.PING:
            return StatusError.NONE, servo.ping()
        case Instruction.READ if len(parameters) == 4:
            return _found(servo.read(_word(parameters, 0), _word(parameters, 2), now_ns))
        case Instruction.WRITE if len(parameters) > 2:
            return servo.write(_word(parameters, 0), parameters[2:]), b""
        case Instruction.REG_WRITE if len(parameters) > 2:
            return servo.reg_write(_word(parameters, 0), parameters[2:]), b""
        case Instruction.READ | Instruction.WRITE | Instruction.REG_WRITE:
            return StatusError.DATA_LENGTH, b""
        case Instruction.ACTION:
            return servo.action(), b""
        case Instruction.FACTORY_RESET:
            return servo.factory_reset(parameters, now_ns, broadcast=broadcast), b""
        case Instruction.REBOOT:
            return servo.reboot(now_ns), b""
        case Instruction.CLEAR:
            return servo.clear(parameters), b""
        case Instruction.CONTROL_TABLE_BACKUP:
            return servo.back_up(parameters, now_ns), b""
    return StatusError.INSTRUCTION, b""


def _execute_as_shadow(servo: Servo, command: Command) -> None:
    """Execute a write that reached the servo through its Secondary ID: RAM only, and never an answer."""
    parameters = command.parameters
    match command.instruction:
        case Instruction.ACTION:
            servo.action()
        case Instruction.WRITE if len(parameters) > 2:
            servo.write(_word(parameters, 0), parameters[2:], secondary=True)
        case Instruction.REG_WRITE if len(parameters) > 2:
            servo.reg_write(_word(parameters, 0), parameters[2:], secondary=True)


def _write_each(writes: dict[int, tuple[int, bytes]], listeners: Sequence[Servo]) -> None:
    """Own ID before Secondary ID; nobody answers, so a refused write is lost in silence."""
    for servo in listeners:
        own = writes.get(servo.id)
        if own is not None:
            servo.write(*own)
            continue
        shadow = writes.get(servo.secondary_id)
        if shadow is not None:
            servo.write(*shadow, secondary=True)


def _overlaid(turns: list[Turn]) -> list[Turn]:
    """Servos that share an ID answer at the same time: zeros win on the wire, and they are never quite in step."""
    speaking = [turn for turn in turns if turn.servo is not None and not turn.servo.muted]
    if len(speaking) < 2:
        return speaking
    mixed = speaking[0].data
    for turn in speaking[1:]:
        mixed = bytes(a & b for a, b in zip(mixed, b"\xff" + turn.data, strict=False))
    return [speaking[0]._replace(data=mixed)]
