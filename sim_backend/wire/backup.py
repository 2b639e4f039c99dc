"""The backup area of a servo: what Control Table Backup keeps, and what a restore or a boot brings back.

Source: ROBOTIS e-manual, Protocol 2.0, Control Table Backup; DYNAMIXEL Wizard 2.0, Backup and Restore.  A restore
brings back the EEPROM and reboots; the RAM part comes back at a boot whose Startup Configuration asks for it.
"""

from __future__ import annotations

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.table import Access, Area
from sim_backend.wire.memory import Memory

GAINS = (
    table.VELOCITY_I_GAIN,
    table.VELOCITY_P_GAIN,
    table.POSITION_D_GAIN,
    table.POSITION_I_GAIN,
    table.POSITION_P_GAIN,
    table.FEEDFORWARD_2ND_GAIN,
    table.FEEDFORWARD_1ST_GAIN,
)
RAM_KEPT = (*GAINS, table.PROFILE_ACCELERATION, table.PROFILE_VELOCITY, *table.INDIRECT_ADDRESSES)


class Backup:
    """The values kept, by register name; it outlives boots and losses of power."""

    def __init__(self) -> None:
        self._values: dict[str, int] = {}

    @property
    def ready(self) -> bool:
        """Backup Ready: something is kept."""
        return bool(self._values)

    def store(self, memory: Memory) -> None:
        """Keep what the control table holds now; an earlier backup is lost."""
        kept = {r.name for r in RAM_KEPT}
        self._values = {
            name: memory.get(register)
            for name, register in memory.layout.by_name.items()
            if name in kept or (register.area is Area.EEPROM and register.access is Access.READ_WRITE)
        }

    def restore(self, memory: Memory, area: Area) -> None:
        """Bring back the registers of one area."""
        for name, value in self._values.items():
            register = memory.layout.by_name[name]
            if register.area is area:
                memory.put(register, value)
