"""The bytes of one servo's control table and how addresses map onto registers.

Layout only: whether an instruction is allowed in the servo's present state is decided in rules.py.
"""

from __future__ import annotations

from functools import lru_cache

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import StatusError
from drivers.dynamixel.servo.models import SERVOS, ServoModel
from drivers.dynamixel.servo.table import Register

RAM_START = 64
SIZE = 662  # the last indirect data byte is 661

_DRIVE_MODE_FIRMWARE = 38


class Layout:
    """Where the registers of one model and firmware lie."""

    def __init__(self, model: ServoModel, firmware: int) -> None:
        absent = set()
        if firmware < _DRIVE_MODE_FIRMWARE:
            absent.add(table.DRIVE_MODE.name)
        if model.watchdog_min_firmware is None or firmware < model.watchdog_min_firmware:
            absent.add(table.BUS_WATCHDOG.name)
        absent |= {name for name, since in table.SINCE_FIRMWARE.items() if firmware < since}
        self.by_name = {name: register for name, register in model.registers.items() if name not in absent}
        self.at = {register.address: register for register in self.by_name.values()}
        self.defined = bytearray(SIZE)
        for register in self.by_name.values():
            self.defined[register.address : register.address + register.length] = b"\1" * register.length
        # indirect address register -> the indirect data byte it points away from its own place
        self.pointed = {
            pointer.address: data.address
            for data, pointer in zip(table.INDIRECT_DATA, table.INDIRECT_ADDRESSES, strict=True)
            if data.name in self.by_name
        }
        self._indirect = frozenset(self.pointed.values())

    @lru_cache(maxsize=256)  # noqa: B019  layouts live as long as the process, one per model and firmware
    def readable(self, address: int, length: int) -> bool:
        """True when every byte of the range is defined."""
        return length > 0 and address + length <= SIZE and 0 not in self.defined[address : address + length]

    @lru_cache(maxsize=256)  # noqa: B019
    def touches_indirect(self, address: int, length: int) -> bool:
        """True when the range holds an indirect data byte."""
        return any(a in self._indirect for a in range(address, address + length))


@lru_cache(maxsize=64)
def layout_of(model_name: str, firmware: int) -> Layout:
    """Return the shared layout of a model and firmware."""
    return Layout(SERVOS[model_name], firmware)


class Memory:
    """Control table bytes; `get` and `put` are the firmware's own access, without rules."""

    def __init__(self, model: ServoModel, firmware: int) -> None:
        self.layout = layout_of(model.name, firmware)
        self.bytes = bytearray(SIZE)
        self._target = list(range(SIZE))  # where an access to an address really goes: indirect data points elsewhere

    def has(self, generic: Register) -> bool:
        """True when this model and firmware have the register."""
        return generic.name in self.layout.by_name

    def version(self, generic: Register) -> Register:
        """This model's version of a register; KeyError when it has none."""
        return self.layout.by_name[generic.name]

    def get(self, register: Register) -> int:
        """Value of a register."""
        address = register.address
        return int.from_bytes(self.bytes[address : address + register.length], "little", signed=register.signed)

    def put(self, register: Register, value: int) -> None:
        """Set a register; OverflowError when the value does not fit its bytes."""
        address, length = register.address, register.length
        self.bytes[address : address + length] = value.to_bytes(length, "little", signed=value < 0)
        data_address = self.layout.pointed.get(address)
        if data_address is not None:
            self._target[data_address] = value

    def load_defaults(self, *, eeprom: bool) -> None:
        """Set all RAM registers to their defaults, and the EEPROM ones too if asked."""
        for register in self.layout.by_name.values():
            if eeprom or register.address >= RAM_START:
                self.put(register, register.default or 0)

    def read(self, address: int, length: int) -> bytes | StatusError:
        """Bytes of a range, indirect data followed once; an undefined byte anywhere in it is an access error."""
        if not self.layout.readable(address, length):
            return StatusError.ACCESS
        if not self.layout.touches_indirect(address, length):
            return bytes(self.bytes[address : address + length])
        memory = self.bytes
        return bytes([memory[target] for target in self._target[address : address + length]])

    def decode(self, address: int, data: bytes) -> list[tuple[Register, int]] | StatusError:
        """Split bytes to be written into whole registers with their values, indirect data followed once."""
        single = self.layout.at.get(address)
        if single is not None and single.length == len(data) and not self.layout.touches_indirect(address, 1):
            return [(single, int.from_bytes(data, "little", signed=single.signed))]
        if not self.layout.readable(address, len(data)):
            return StatusError.ACCESS
        targets = self._target[address : address + len(data)]
        found: list[tuple[Register, int]] = []
        at = 0
        while at < len(targets):
            start = targets[at]
            register = self.layout.at.get(start)
            if register is None:
                return StatusError.DATA_LENGTH if self.layout.defined[start] else StatusError.ACCESS
            end = at + register.length
            if targets[at:end] != list(range(start, start + register.length)):
                return StatusError.DATA_LENGTH
            found.append((register, int.from_bytes(data[at:end], "little", signed=register.signed)))
            at = end
        return found
