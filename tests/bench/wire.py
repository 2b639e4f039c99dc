"""What emulated servos cost the machine that also runs the agents: time per exchange and per substep, no I/O."""

from __future__ import annotations

from drivers.dynamixel.servo.codes import Instruction, OperatingMode
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, servo_eeprom
from tests.bench.common import Figure, median_us
from tests.support.servos.wire_bench import build, word

NAMES = ("wire_fast_read_9", "wire_sync_read_9", "wire_sync_write_7", "wire_substep_18_servos")
BAUD = 1_000_000
PERIOD_NS = 5_000_000
SUBSTEP_NS = 1_000_000


def bench() -> dict[str, Figure]:
    """Median µs on the emulator's side; the baseline of the reads is their time on the wire."""
    nine = bytes(range(1, 10))
    block = word(126) + word(10)
    goals = word(102) + word(2) + b"".join(bytes((i, 5, 0)) for i in range(1, 8))
    fast, each = build(0xFE, Instruction.FAST_SYNC_READ, block + nine), build(0xFE, Instruction.SYNC_READ, block + nine)
    return {
        "wire_fast_read_9": Figure(_exchange_us(fast), "µs", 1570.0),
        "wire_sync_read_9": Figure(_exchange_us(each), "µs", 2120.0),
        "wire_sync_write_7": Figure(_exchange_us(build(0xFE, Instruction.SYNC_WRITE, goals)), "µs"),
        "wire_substep_18_servos": Figure(_substep_us(), "µs", SUBSTEP_NS / 1e3),
    }


def _arm(name: str) -> EmulatedArm:
    """Nine servos as on a wx250s, in current and PWM mode with torque on."""
    eeprom = servo_eeprom(baud=BAUD)
    joints = tuple(
        JointWiring(f"joint{i}", (ServoWiring(i, "XM430-W350" if i < 8 else "XL430-W250", eeprom=eeprom),))
        for i in range(1, 10)
    )
    arm = EmulatedArm(ArmWiring(name, joints, BAUD), timing=BusTiming())
    for servo in arm.bus.servos:
        mode = OperatingMode.CURRENT if servo.firmware.model.has_current_mode else OperatingMode.PWM
        servo.write(11, bytes((mode,)))
        servo.write(100, b"\x05\x00")
        servo.write(64, b"\x01")
    return arm


def _exchange_us(packet: bytes) -> float:
    bus = _arm("left").bus
    now_ns = 0

    def exchange() -> None:
        nonlocal now_ns
        now_ns += PERIOD_NS
        bus.receive(packet, now_ns, BAUD)
        bus.take(now_ns + PERIOD_NS - 1)

    return median_us(exchange, 100, 15)


def _substep_us() -> float:
    cell = EmulatedCell([_arm("left"), _arm("right")], None)

    def substep() -> None:
        cell.catch_up(cell.time_ns + SUBSTEP_NS)

    return median_us(substep, 100, 15)
