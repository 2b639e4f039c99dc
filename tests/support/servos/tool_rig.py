"""Emulated servos on virtual time for the tools, and proof of what a tool put on the line."""

from __future__ import annotations

from collections.abc import Iterable

from agent.doctor.doctor import Diagnosis, examine_line
from agent.faults.virtual import Line
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.line.bus import Bus, DxlCounters
from drivers.dynamixel.line.codec import HEADER
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import ID, TORQUE_ENABLE, Area
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring
from tests.support.servos.dxl_rig import WX200, Rig, VirtualClock, VirtualPort, driver_on

LOOKING = frozenset({Instruction.PING, Instruction.READ, Instruction.SYNC_READ, Instruction.FAST_SYNC_READ})
WRITING = frozenset({Instruction.WRITE, Instruction.REG_WRITE, Instruction.SYNC_WRITE, Instruction.BULK_WRITE})


class CuttablePort(VirtualPort):
    """A virtual port whose cable can be pulled after a number of packets."""

    _left: int | None = None

    def lose_after(self, packets: int | None) -> None:
        """None: never."""
        self._left = packets

    def write(self, data: bytes, deadline_ns: int) -> None:
        if self._left is not None:
            self.lost = self.lost or self._left == 0
            self._left -= 1
        super().write(data, deadline_ns)


def servo_rig(*servos: ServoWiring, timing: BusTiming | None = None) -> Rig:
    """Loose servos on one line, each holding a joint of its own; no driver, port open."""
    joints = tuple(JointWiring(f"joint {place}", (servo,)) for place, servo in enumerate(servos))
    rig = _rig(WX200, ArmWiring("left", joints), timing)
    rig.port.open()
    return rig


def arm_rig(arm: ArmMap, wiring: ArmWiring) -> Rig:
    """An arm wired otherwise than its map says, with a driver."""
    rig = _rig(arm, wiring, BusTiming())
    rig.driver = driver_on(rig, rig.port)
    return rig


def _rig(arm: ArmMap, wiring: ArmWiring, timing: BusTiming | None) -> Rig:
    emulation = EmulatedArm(wiring, timing=timing)
    cell = EmulatedCell([emulation], None, start_ns=10_000_000_000)
    injector = Injector(emulation, None, seed=1)
    line = Line(cell, 0, injector, VirtualClock(cell, injector))
    return Rig(arm, cell, injector, line.clock, None, CuttablePort(line, arm.baud), [], line)


def bus_of(rig: Rig) -> Bus:
    """The line as a tool has it."""
    if not rig.port.is_open:
        rig.port.open()
    return Bus(rig.port, rig.clock, DxlCounters())


def instructions(rig: Rig) -> list[bytes]:
    """Packets that were sent, without their headers: ID, LENGTH, INSTRUCTION, parameters, CRC."""
    for data in rig.port.writes:
        assert data.startswith(HEADER)
        assert data.count(HEADER) == 1
    return [data[len(HEADER) :] for data in rig.port.writes]


def codes(rig: Rig) -> set[int]:
    """Instructions that were sent."""
    return {packet[3] for packet in instructions(rig)}


def written_registers(rig: Rig) -> list[int]:
    """First addresses of all plain writes; every other kind of write fails."""
    packets = [packet for packet in instructions(rig) if packet[3] in WRITING]
    assert all(packet[3] == Instruction.WRITE for packet in packets)
    return [packet[4] | packet[5] << 8 for packet in packets]


def servos_of(rig: Rig):
    """Every emulated servo, those with the same ID too."""
    return rig.cell.arms[0].bus.servos


def torque_is_off(rig: Rig) -> bool:
    """By the control tables themselves."""
    return not any(servo.firmware.memory.get(TORQUE_ENABLE) for servo in servos_of(rig))


def settings(rig: Rig) -> list[dict[str, int]]:
    """Every register that can be written, of every servo."""
    return [
        {
            r.name: servo.firmware.memory.get(r)
            for r in servo.firmware.memory.layout.by_name.values()
            if r.minimum is not None
        }
        for servo in servos_of(rig)
    ]


def eeprom(rig: Rig) -> dict[int, dict[str, int]]:
    """EEPROM of every servo by ID."""
    return {
        servo.firmware.memory.get(ID): {
            r.name: servo.firmware.memory.get(r)
            for r in servo.firmware.memory.layout.by_name.values()
            if r.area is Area.EEPROM and r.minimum is not None
        }
        for servo in servos_of(rig)
    }


def examined(rig: Rig, started: ArmMap | None = None) -> Diagnosis:
    """What the doctor says of the rig's line; proves on every use that it only looked."""
    before, torque = settings(rig), torque_is_off(rig)
    rig.port.writes.clear()
    out = Diagnosis("cell", "0" * 64)
    examine_line(rig.arm, rig.port, rig.clock, out, started)
    assert codes(rig) <= LOOKING
    assert settings(rig) == before
    assert torque_is_off(rig) == torque
    assert not rig.port.is_open
    return out


def fresh(model: str, servo_id: int = 1, firmware: int = 46, **eeprom_values: int) -> ServoWiring:
    """A servo as it leaves the factory; eeprom_values: register names with _ for spaces."""
    known = {name.replace(" ", "_"): name for name in SERVOS[model].registers}
    return ServoWiring(servo_id, model, firmware=firmware, eeprom={known[k]: v for k, v in eeprom_values.items()})


def lines(diagnosis: Diagnosis, *, but_ok: bool = True) -> Iterable[str]:
    """The findings for a person."""
    return [f"{f.verdict}: {f.line}" for f in diagnosis.findings if not (but_ok and f.verdict == "ok")]
