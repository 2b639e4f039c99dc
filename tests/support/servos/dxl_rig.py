"""The driver on emulated servos in virtual time: no terminal, no thread, no waiting; every run the same."""

from __future__ import annotations

import socket
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from agent.faults import virtual
from drivers.clock import MonotonicClock
from drivers.dynamixel.arm_map import ArmMap, JointMap, JointRole
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import PortError, PortLostError
from drivers.dynamixel.line import codec
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.dynamixel.servo.table import Register
from drivers.fingers import Fingers
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import Fault, FaultKind
from sim_backend.wire.injector import Injector
from sim_backend.wire.options import BusOptions, ServoOptions
from sim_backend.wire.serve import ServeOptions, serve
from sim_backend.wire.servo import Servo
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, servo_eeprom

XM, XL = "XM430-W350", "XL430-W250"
START = {"waist": 0.0, "shoulder": -0.6, "elbow": 0.7, "wrist_angle": 0.4, "wrist_rotate": 0.0, "gripper": 0.2}

WX200 = ArmMap(
    arm="left",
    port="virtual",
    baud=1_000_000,
    rate_hz=200.0,
    joints=(
        JointMap("waist", XM, (1,), (False,), role=JointRole.HELD, start_rad=0.0),
        JointMap("shoulder", XM, (2, 3), (False, True), 2048, (819, 3333), tau_max_Nm=4.0, start_rad=-0.6),
        JointMap("elbow", XM, (4,), (True,), 2048, (819, 3106), tau_max_Nm=2.0, start_rad=0.7),
        JointMap("wrist_angle", XM, (5,), (True,), 2048, (910, 3447), tau_max_Nm=2.0, start_rad=0.4),
        JointMap("wrist_rotate", XL, (6,), (False,), tau_max_Nm=0.5, start_rad=0.0),
        JointMap("gripper", XL, (7,), (False,), role=JointRole.GRIPPER),
    ),
)


FINGERS = Fingers(0.014, 0.024, (1802 - 2048) * TICK_RAD, (2875 - 2048) * TICK_RAD)


def with_gripper(**changes: object) -> ArmMap:
    """The same arm with fingers that can close on an object."""
    *others, gripper = WX200.joints
    return replace(WX200, joints=(*others, replace(gripper, **{"fingers": FINGERS, "grip_effort": 0.25, **changes})))  # type: ignore[arg-type]


def wiring(arm: ArmMap, firmware: int = 46, **eeprom: int) -> ArmWiring:
    """Emulated servos set up as the map says; eeprom: register names with _ for spaces, for all servos."""
    more = {name.replace("_", " "): value for name, value in eeprom.items()}
    joints = []
    for joint in arm.joints:
        servos = tuple(
            ServoWiring(
                servo_id, joint.servo, reverse, joint.zero_tick, firmware,
                {
                    **servo_eeprom(
                        baud=arm.baud, reverse=reverse, secondary_id=joint.ids[0] if place else 255,
                        position_limit_ticks=joint.position_limit_ticks, mark=arm.mark.own,
                    ),
                    **more,
                },
            )
            for place, (servo_id, reverse) in enumerate(zip(joint.ids, joint.reverse, strict=True))
        )  # fmt: skip
        joints.append(JointWiring(joint.name, servos, None, START.get(joint.name, 0.0)))
    return ArmWiring(arm.arm, tuple(joints), arm.baud)


class VirtualClock:
    """`Clock` whose time passes only when somebody waits; the emulated cell lives along."""

    utc_offset_ns = 0

    def __init__(self, cell: EmulatedCell, injector: Injector) -> None:
        self._ns = cell.time_ns
        self._cell = cell
        self._injector = injector

    def now_ns(self) -> int:
        """Virtual now; asking takes a little time, as everything does."""
        self._ns += 200
        return self._ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Let time pass in steps that watchdogs and faults can follow."""
        while self._ns < deadline_ns:
            self._ns = min(deadline_ns, self._ns + 1_000_000)
            self._injector.tick(self._ns)
            self._cell.advance_to(self._ns)
            self._cell.arms[0].bus.tick(self._ns)


class VirtualPort(virtual.VirtualPort):
    """The virtual port of the product, which also keeps what is written and can be lost."""

    def __init__(self, line: virtual.Line, baud: int) -> None:
        super().__init__(line, baud)
        self.lost = False  # whoever opens it again
        self.gone = False  # until it is plugged in again
        self.writes: list[bytes] = []

    def open(self) -> None:
        if self.gone:
            raise PortError("port virtual", found="no such device", expected="a port", remedy="plug it in")
        super().open()

    def write(self, data: bytes, deadline_ns: int) -> None:
        super().write(data, deadline_ns)
        self.writes.append(data)

    def _need(self) -> None:
        if self.lost or self.gone:
            raise PortLostError("port virtual", found="closed", expected="open", remedy="none")
        super()._need()


def packets_of(data: bytes) -> list[bytes]:
    """The packets of one write."""
    packets = []
    while data:
        size = 7 + int.from_bytes(data[5:7], "little")
        packets.append(data[:size])
        data = data[size:]
    return packets


def loses(rig: Rig, register: Register, *heard: int, value: int | None = None, count: int = 1) -> None:
    """The next sync writes of this register, and value, to these and others get lost on their way, but to these."""
    really, left = rig.port.write, count
    size = 1 + register.length

    def fares(packet: bytes) -> bytes:
        nonlocal left
        if packet[7:9] != bytes((Instruction.SYNC_WRITE, register.address)) or not left:
            return packet
        entries = {packet[k]: packet[k + 1 : k + size] for k in range(12, len(packet) - 2, size)}
        first = int.from_bytes(packet[13 : 12 + size], "little", signed=register.signed)
        if not set(heard) <= set(entries) or value not in (None, first):
            return packet
        left -= 1
        if not left:
            rig.port.write = really  # type: ignore[method-assign]
        kept = {i: entries[i] for i in heard}
        return codec.sync_write(register.address, register.length, kept) if kept else b""

    def write(data: bytes, deadline_ns: int) -> None:
        if left := b"".join(map(fares, packets_of(data))):
            really(left, deadline_ns)

    rig.port.write = write  # type: ignore[method-assign]


@dataclass
class Rig:
    """One driver, one emulated arm, one virtual clock."""

    arm: ArmMap
    cell: EmulatedCell
    injector: Injector
    clock: VirtualClock
    driver: DynamixelDriver
    port: VirtualPort
    events: list
    line: virtual.Line

    @property
    def bus(self):
        """The emulated line."""
        return self.cell.arms[0].bus

    def servo(self, servo_id: int) -> Servo:
        """Emulated servo."""
        return self.cell.arms[0].servo(servo_id)

    def get(self, servo_id: int, register: Register) -> int:
        """Register of an emulated servo, past the bus."""
        return self.servo(servo_id).firmware.memory.get(register)

    def put(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register past the bus and its rules."""
        self.servo(servo_id).firmware.memory.put(register, value)

    def fault(self, kind: FaultKind, servo: int | None = None, **more) -> None:
        """Begin a fault now."""
        now_ns = self.clock.now_ns()
        self.injector.add([Fault(kind=kind, arm=self.arm.arm, servo=servo, **more)], now_ns)
        self.injector.tick(now_ns)

    def kinds(self) -> list[str]:
        """Names of the events so far."""
        return [event.kind.name for event in self.events]


def build(
    arm: ArmMap = WX200,
    *,
    firmware: int = 46,
    timing: BusTiming | None = None,
    servo_options: ServoOptions | None = None,
    bus_options: BusOptions | None = None,
    eeprom: dict[str, int] | None = None,
    emulated: ArmMap | None = None,
) -> Rig:
    """A rig, not connected yet.  emulated: the arm that is really there, if it is not the map's."""
    emulation = EmulatedArm(
        wiring(emulated or arm, firmware, **(eeprom or {})),
        timing=timing,
        servo_options=servo_options or ServoOptions(),
        bus_options=bus_options or BusOptions(),
    )
    cell = EmulatedCell([emulation], None, start_ns=10_000_000_000)
    injector = Injector(emulation, None, seed=1)
    clock = VirtualClock(cell, injector)
    events: list = []
    line = virtual.Line(cell, 0, injector, clock)
    rig = Rig(arm, cell, injector, clock, None, VirtualPort(line, arm.baud), events, line)
    rig.driver = driver_on(rig, rig.port)
    return rig


def driver_on(rig: Rig, port: VirtualPort | None = None) -> DynamixelDriver:
    """Another driver for the same arm."""
    port = port or VirtualPort(rig.line, rig.arm.baud)
    return DynamixelDriver(rig.arm, rig.clock, on_event=rig.events.append, scan_s=0.02, port=port)


def enabled(arm: ArmMap = WX200, **more) -> Rig:
    """A rig ready for the cycle."""
    rig = build(arm, **more)
    rig.driver.connect()
    rig.driver.enable()
    return rig


def at(arm: ArmMap, **more) -> ArmMap:
    """The map with other rate, baud, …"""
    return replace(arm, **more)


# A planar arm at a rate so low that a stalled host is never late: what the driver contract runs on.
PLANAR = at(
    WX200,
    rate_hz=3.0,
    watchdog_s=2.54,
    joints=tuple(replace(j, role=JointRole.HELD) if j.name == "wrist_rotate" else j for j in WX200.joints),
)


class ServedArm:
    """Emulated servos behind a real pseudo terminal, served by a thread; for drivers with a real port and clock."""

    def __init__(self, directory: Path, arm: ArmMap = PLANAR, timing: BusTiming | None = None) -> None:
        self.arm = replace(arm, port=str(directory / "port"))
        self.control = directory / "faults"
        self._cell = EmulatedCell([EmulatedArm(wiring(arm), timing=timing)], None)
        self._options = ServeOptions({arm.arm: directory / "port"}, control_socket=self.control)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=serve, args=(self._cell, self._options, self._stop.is_set))

    def __enter__(self) -> ServedArm:
        self._thread.start()
        while not (Path(self.arm.port).exists() and self.control.exists()):
            time.sleep(0.002)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def driver(self) -> DynamixelDriver:
        """A driver for this arm, not connected."""
        return DynamixelDriver(self.arm, MonotonicClock(), scan_s=0.02)

    def fault(self, text: str) -> None:
        """Carry out a fault command, and wait until it is in force."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.bind(f"{self.control}.reply")
            sender.sendto(text.encode(), str(self.control))
            answer = sender.recv(1000)
        Path(f"{self.control}.reply").unlink()
        assert answer == b"ok", answer
