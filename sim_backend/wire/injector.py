"""Carries out fault commands on emulated arms and their ports; faults.py says when.

What lasts follows from all faults that run, so that those of one kind may overlap: on a servo the one that began last
counts, and once that has ended the one before it; of replies each has its turn.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Protocol

from drivers.dynamixel.servo.codes import HardwareError
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.faults import (
    REPLY_FAULTS,
    Fault,
    FaultKind,
    FaultSchedule,
    ReplyTamper,
    Scheduled,
    require_known,
)
from sim_backend.wire.servo import Servo

log = logging.getLogger(__name__)

BABBLE_BYTES_PER_MS = 100  # 1 Mbit/s without a pause
RAMPS = (FaultKind.OVERHEAT, FaultKind.VOLTAGE)


class Pluggable(Protocol):
    """A port that can be lost."""

    def vanish(self) -> None:
        """Be unplugged."""
        ...

    def appear(self) -> None:
        """Be plugged in again."""
        ...


class Injector:
    """Faults of one arm.  `port` is None where servos are driven without one that could be lost."""

    def __init__(self, arm: EmulatedArm, port: Pluggable | None, seed: int) -> None:
        self.arm = arm
        self.stalled = False
        self.tamper = ReplyTamper(seed)
        self._port = port
        self._port_lost = False
        self._schedule = FaultSchedule()
        self._babble_ns: int | None = None
        self._acting: dict[int, dict[FaultKind, Fault]] = {}  # on each servo: of every kind the one that counts
        self._from: dict[int, list[float]] = {}  # ramps: value of each servo when the fault began
        self._supply_V: dict[int, float] = {}  # of each servo whose supply a fault has, without it

    @property
    def servo_ids(self) -> frozenset[int]:
        """IDs of the arm's servos."""
        return frozenset(servo.id for servo in self.arm.bus.servos)

    def add(self, faults: Sequence[Fault], now_ns: int) -> None:
        """Plan faults of this arm.  Raises FaultError for a servo it does not have; then none is planned."""
        require_known(faults, {self.arm.name: self.servo_ids})
        self._schedule.add(faults, now_ns)

    def clear(self, now_ns: int) -> None:
        """End all faults and forget those to come."""
        self._end(self._schedule.clear())
        self._refresh(now_ns)

    def tick(self, now_ns: int) -> None:
        """Begin, end and continue what is due."""
        if self._schedule.is_empty:  # then nothing babbles, either
            return
        begin, end = self._schedule.poll(now_ns)
        self._end(end)
        self._begin(begin)
        if begin or end:
            self._refresh(now_ns)
        for entry in begin:
            for servo in self._servos(entry.fault):
                _strike(servo, entry.fault.kind, now_ns)
        for entry in self._running():
            if entry.fault.kind in RAMPS:
                self._ramp(entry, now_ns)
        if self._babble_ns is not None:
            count = (now_ns - self._babble_ns) * BABBLE_BYTES_PER_MS // 1_000_000
            if count > 0:
                self._babble_ns = now_ns
                self.arm.bus.inject(self.tamper.noise(min(count, 4096)), now_ns)

    def _running(self) -> list[Scheduled]:
        """Faults that are on, the newest last."""
        return sorted(self._schedule.running(), key=lambda entry: entry.start_ns)

    def _begin(self, begun: Sequence[Scheduled]) -> None:
        for entry in begun:
            _say(entry.fault, "on")
            if entry.fault.kind in RAMPS:
                self._from[id(entry)] = [_ramped(servo, entry.fault.kind) for servo in self._servos(entry.fault)]

    def _end(self, ended: Sequence[Scheduled]) -> None:
        for entry in ended:
            _say(entry.fault, "off")
            self._from.pop(id(entry), None)

    def _refresh(self, now_ns: int) -> None:
        """What line, port and servos have of the faults that run now."""
        running = [entry.fault for entry in self._running()]
        kinds = {fault.kind for fault in running}
        self.tamper.active = [fault for fault in running if fault.kind in REPLY_FAULTS]
        self.arm.bus.tamper = self.tamper if self.tamper.active else None
        self.arm.bus.talked_over = any(f.kind is FaultKind.BABBLE and f.servo is not None for f in running)
        self.stalled = FaultKind.STALL in kinds
        if FaultKind.BABBLE not in kinds:
            self._babble_ns = None
        elif self._babble_ns is None:
            self._babble_ns = now_ns
        if self._port_lost != (FaultKind.PORT_LOSS in kinds):
            self._switch_port(not self._port_lost)
        for servo in self.arm.bus.servos:
            self._refresh_servo(servo, {f.kind: f for f in running if f.servo in (None, servo.id)}, now_ns)

    def _refresh_servo(self, servo: Servo, acting: dict[FaultKind, Fault], now_ns: int) -> None:
        before, self._acting[servo.id] = self._acting.get(servo.id, {}), acting
        for kind in [*before, *(kind for kind in acting if kind not in before)]:
            old, new = before.get(kind), acting.get(kind)
            if kind is FaultKind.ENCODER_OFFSET:
                servo.firmware.body.encoder_offset_ticks = 0 if new is None else new.offset_ticks
            elif (old is None) != (new is None):
                self._switch(servo, kind, new is not None, now_ns)

    def _switch(self, servo: Servo, kind: FaultKind, on: bool, now_ns: int) -> None:
        """Begin or end what all faults of one kind do to a servo."""
        firmware = servo.firmware
        match kind:
            case FaultKind.SILENT:
                servo.deaf = on
            case FaultKind.MUTE:
                servo.muted = on
            case FaultKind.POWER_LOSS:
                firmware.power(not on, now_ns)
            case FaultKind.ENCODER_STUCK:
                firmware.body.freeze_encoder(on)
            case FaultKind.VOLTAGE if on:
                self._supply_V[servo.id] = firmware.body.horn.supply_V
            case FaultKind.VOLTAGE:  # heat leaves by itself, the supply comes back at once
                firmware.body.horn.supply_V = self._supply_V.pop(servo.id)

    def _servos(self, fault: Fault) -> list[Servo]:
        return [servo for servo in self.arm.bus.servos if fault.servo in (None, servo.id)]

    def _switch_port(self, lost: bool) -> None:
        self._port_lost = lost
        if self._port is None:
            return
        if lost:
            self._port.vanish()
            self.arm.bus.clear()
        else:
            self._port.appear()

    def _ramp(self, entry: Scheduled, now_ns: int) -> None:
        fault = entry.fault
        share = 1.0 if fault.ramp_s <= 0.0 else min(1.0, (now_ns - entry.start_ns) * 1e-9 / fault.ramp_s)
        for servo, start in zip(self._servos(fault), self._from[id(entry)], strict=True):
            body = servo.firmware.body
            if fault.kind is FaultKind.OVERHEAT:
                body.motor.temperature_C = start + share * (fault.temperature_C - start)
            else:
                body.horn.supply_V = start + share * (fault.voltage_V - start)


def _say(fault: Fault, what: str) -> None:
    log.info("fault %s on arm %s servo %s %s", fault.kind.value, fault.arm, fault.servo, what)


def _ramped(servo: Servo, kind: FaultKind) -> float:
    body = servo.firmware.body
    return body.motor.temperature_C if kind is FaultKind.OVERHEAT else body.horn.supply_V


def _strike(servo: Servo, kind: FaultKind, now_ns: int) -> None:
    """Do what a fault does once, as it begins."""
    match kind:
        case FaultKind.OVERLOAD:
            servo.firmware.raise_error(HardwareError.OVERLOAD)
        case FaultKind.ELECTRICAL_SHOCK:
            servo.firmware.raise_error(HardwareError.ELECTRICAL_SHOCK)
        case FaultKind.REBOOT:
            servo.reboot(now_ns)


def by_arm(injectors: Mapping[str, Injector], faults: Sequence[Fault], now_ns: int) -> None:
    """Hand faults to the arms they name.  Raises FaultError for an unknown arm or servo; then none is planned."""
    require_known(faults, {name: injector.servo_ids for name, injector in injectors.items()})
    for name, injector in injectors.items():
        injector.add([fault for fault in faults if fault.arm == name], now_ns)
