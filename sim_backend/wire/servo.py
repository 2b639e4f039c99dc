"""One emulated servo as the bus sees it: each instruction with its rules and error code.

Instructions come in decoded; time comes in with every call.
Source: ROBOTIS e-manual, Protocol 2.0.
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import ALERT_BIT, BAUD_RATES, StatusError
from drivers.dynamixel.servo.models import ServoModel
from drivers.dynamixel.servo.table import Area
from sim_backend.wire import rules
from sim_backend.wire.firmware import Firmware
from sim_backend.wire.options import ServoOptions

DEFAULT_FIRMWARE = 46
CLEAR_FIRMWARE = 42
BROADCAST_RESET_FIRMWARE = 42  # from here on a broadcast "reset all" is ignored
CLEAR_POSITION = b"\x01\x44\x58\x4c\x22"
BACKUP_KEY = b"\x43\x54\x52\x4c"
RETURN_DELAY_UNIT_NS = 2_000
FACTORY = ServoOptions()
_PRESENT_END = table.PRESENT_TEMPERATURE.address + 1
_FIRST_INDIRECT_DATA = table.INDIRECT_DATA[0].address
_KEPT_BY_RESET = {0xFF: (), 0x01: (table.ID,), 0x02: (table.ID, table.BAUD_RATE)}


class Servo:
    """State machine of one servo.  Created with power on and booted."""

    def __init__(
        self,
        model: ServoModel,
        servo_id: int,
        *,
        firmware: int = DEFAULT_FIRMWARE,
        eeprom: Mapping[str, int] | None = None,
        options: ServoOptions = FACTORY,
    ) -> None:
        """`eeprom` maps e-manual register names to values that differ from the factory's."""
        self.firmware = Firmware(model, firmware, options)
        self.muted = False  # fault: hears, never answers
        self.deaf = False  # fault: neither hears nor answers
        self._memory = self.firmware.memory
        self._registered: tuple[int, bytes, bool] | None = None
        self._memory.put(table.ID, servo_id)
        for name, value in (eeprom or {}).items():
            self._memory.put(self._memory.layout.by_name[name], value)
        self.firmware.start(0, 0)

    # --- identity -------------------------------------------------------------------------------------------------

    @property
    def id(self) -> int:
        """ID register."""
        return self._memory.bytes[table.ID.address]

    @property
    def secondary_id(self) -> int:
        """Secondary (shadow) ID; 253 and above mean none."""
        return self._memory.bytes[table.SECONDARY_ID.address]

    @property
    def baud(self) -> int:
        """Speed this servo talks at, bit/s."""
        return BAUD_RATES[self._memory.bytes[table.BAUD_RATE.address]]

    @property
    def return_delay_ns(self) -> int:
        """Return Delay Time."""
        return self._memory.bytes[table.RETURN_DELAY_TIME.address] * RETURN_DELAY_UNIT_NS

    @property
    def status_return_level(self) -> int:
        """0: answers ping only; 1: reads too; 2: everything."""
        return self._memory.bytes[table.STATUS_RETURN_LEVEL.address]

    @property
    def fast_reads(self) -> bool:
        """True when this model and firmware answer fast sync and fast bulk reads."""
        return self.firmware.model.answers_fast(self.firmware.version)

    def hears(self, now_ns: int) -> bool:
        """True when instructions reach the firmware."""
        return not self.deaf and self.firmware.alive(now_ns)

    def error_byte(self, error: StatusError) -> int:
        """Error field of a status packet: the code, and the alert bit while a hardware error stands."""
        return error | ALERT_BIT if self.firmware.hardware_error else int(error)

    # --- instructions ---------------------------------------------------------------------------------------------

    def ping(self) -> bytes:
        """Model number and firmware version."""
        return bytes(self._memory.bytes[0:2]) + bytes((self.firmware.version,))

    def read(self, address: int, length: int, now_ns: int) -> bytes | StatusError:
        """Bytes of the control table as they are now."""
        end = address + length
        if (address < _PRESENT_END and end > table.REALTIME_TICK.address) or end > _FIRST_INDIRECT_DATA:
            self.firmware.refresh(now_ns)
        return self._memory.read(address, length)

    def write(self, address: int, data: bytes, *, secondary: bool = False) -> StatusError:
        """Write whole registers: all of them, or none and the first error."""
        firmware = self.firmware
        plan = self._memory.decode(address, data)
        if isinstance(plan, StatusError):
            return plan
        for register, value in plan:
            error = rules.refusal(firmware.model, firmware.version, self._memory, register, value, secondary=secondary)
            if error:
                return error
        for register, value in plan:
            firmware.accept(register, value)
        return StatusError.NONE

    def reg_write(self, address: int, data: bytes, *, secondary: bool = False) -> StatusError:
        """Keep a write for ACTION; what it may do is checked then."""
        plan = self._memory.decode(address, data)
        if isinstance(plan, StatusError):
            return plan
        self._registered = (address, data, secondary)
        self._memory.put(table.REGISTERED_INSTRUCTION, 1)
        return StatusError.NONE

    def action(self) -> StatusError:
        """Do the kept write; an instruction error when there is none."""
        if self._registered is None:
            return StatusError.INSTRUCTION
        address, data, secondary = self._registered
        self._registered = None
        self._memory.put(table.REGISTERED_INSTRUCTION, 0)
        return self.write(address, data, secondary=secondary)

    def reboot(self, now_ns: int) -> StatusError:
        """Restart; RAM is lost."""
        self._registered = None
        self.firmware.boot(now_ns)
        return StatusError.NONE

    def factory_reset(self, parameters: bytes, now_ns: int, *, broadcast: bool) -> StatusError:
        """Reset the EEPROM, keeping the ID (option 1) or ID and baud rate (option 2), then boot."""
        if len(parameters) != 1 or parameters[0] not in _KEPT_BY_RESET:
            return StatusError.DATA_RANGE
        option = parameters[0]
        if broadcast and option == 0xFF and self.firmware.version >= BROADCAST_RESET_FIRMWARE:
            return StatusError.NONE
        values = [(register, self._memory.get(register)) for register in _KEPT_BY_RESET[option]]
        self._memory.load_defaults(eeprom=True)
        for register, value in values:
            self._memory.put(register, value)
        return self.reboot(now_ns)

    def clear(self, parameters: bytes) -> StatusError:
        """Bring a multi-turn position back into one turn; only while standing still."""
        if self.firmware.version < CLEAR_FIRMWARE:
            return StatusError.INSTRUCTION
        if parameters != CLEAR_POSITION:
            return StatusError.DATA_RANGE
        if self.firmware.moving():
            return StatusError.RESULT_FAIL
        self.firmware.body.reset_turns()
        self.firmware.stand()
        return StatusError.NONE

    def back_up(self, parameters: bytes, now_ns: int) -> StatusError:
        """Store the control table (1), or restore its EEPROM and restart (2); with torque off."""
        firmware = self.firmware
        if not self._memory.has(table.BACKUP_READY):
            return StatusError.INSTRUCTION
        if parameters[1:] != BACKUP_KEY or parameters[0] not in (1, 2):
            return StatusError.DATA_RANGE
        restoring = parameters[0] == 2
        if firmware.body.drive.torque_on or (restoring and not firmware.backup.ready):
            return StatusError.RESULT_FAIL
        if restoring:
            firmware.backup.restore(self._memory, Area.EEPROM)
            return self.reboot(now_ns)
        firmware.backup.store(self._memory)
        self._memory.put(table.BACKUP_READY, 1)
        return StatusError.NONE
