"""Carries out fault commands on emulated arms and their ports; faults.py says when."""

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
        self._schedule = FaultSchedule()
        self._babble_ns: int | None = None
        self._from: dict[int, list[float]] = {}  # ramps: value of each servo when the fault began

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
        for entry in self._schedule.clear():
            self._switch(entry, on=False, now_ns=now_ns)
        self._refresh()

    def tick(self, now_ns: int) -> None:
        """Begin, end and continue what is due."""
        begin, end = self._schedule.poll(now_ns)
        for entry in end:
            self._switch(entry, on=False, now_ns=now_ns)
        for entry in begin:
            self._switch(entry, on=True, now_ns=now_ns)
        if begin or end:
            self._refresh()
        for entry in self._schedule.running():
            if entry.fault.kind in (FaultKind.OVERHEAT, FaultKind.VOLTAGE):
                self._ramp(entry, now_ns)
        if self._babble_ns is not None:
            count = (now_ns - self._babble_ns) * BABBLE_BYTES_PER_MS // 1_000_000
            if count > 0:
                self._babble_ns = now_ns
                self.arm.bus.inject(self.tamper.noise(min(count, 4096)), now_ns)

    def _refresh(self) -> None:
        """What the line and the way to the host have of the faults that run now."""
        running = [entry.fault for entry in self._schedule.running()]
        self.tamper.active = [fault for fault in running if fault.kind in REPLY_FAULTS]
        self.arm.bus.tamper = self.tamper if self.tamper.active else None
        self.arm.bus.talked_over = any(f.kind is FaultKind.BABBLE and f.servo is not None for f in running)

    def _servos(self, fault: Fault) -> list[Servo]:
        return [servo for servo in self.arm.bus.servos if fault.servo in (None, servo.id)]

    def _switch(self, entry: Scheduled, *, on: bool, now_ns: int) -> None:
        """Begin or end one fault."""
        fault = entry.fault
        log.info("fault %s on arm %s servo %s %s", fault.kind.value, fault.arm, fault.servo, "on" if on else "off")
        match fault.kind:
            case FaultKind.BABBLE:
                self._babble_ns = now_ns if on else None
            case FaultKind.STALL:
                self.stalled = on
            case FaultKind.PORT_LOSS:
                self._switch_port(on)
            case FaultKind.OVERHEAT | FaultKind.VOLTAGE:
                self._begin_ramp(entry, on)
            case _:
                for servo in self._servos(fault):
                    _switch_servo(servo, fault, on, now_ns)

    def _switch_port(self, lost: bool) -> None:
        if self._port is None:
            return
        if lost:
            self._port.vanish()
            self.arm.bus.clear()
        else:
            self._port.appear()

    def _begin_ramp(self, entry: Scheduled, on: bool) -> None:
        servos = self._servos(entry.fault)
        if on:
            self._from[id(entry)] = [_ramped(servo, entry.fault.kind) for servo in servos]
            return
        start = self._from.pop(id(entry))
        if entry.fault.kind is FaultKind.VOLTAGE:  # heat leaves by itself, the supply comes back at once
            for servo, value in zip(servos, start, strict=True):
                servo.firmware.body.horn.supply_V = value

    def _ramp(self, entry: Scheduled, now_ns: int) -> None:
        fault = entry.fault
        share = 1.0 if fault.ramp_s <= 0.0 else min(1.0, (now_ns - entry.start_ns) * 1e-9 / fault.ramp_s)
        for servo, start in zip(self._servos(fault), self._from[id(entry)], strict=True):
            body = servo.firmware.body
            if fault.kind is FaultKind.OVERHEAT:
                body.motor.temperature_C = start + share * (fault.temperature_C - start)
            else:
                body.horn.supply_V = start + share * (fault.voltage_V - start)


def _ramped(servo: Servo, kind: FaultKind) -> float:
    body = servo.firmware.body
    return body.motor.temperature_C if kind is FaultKind.OVERHEAT else body.horn.supply_V


def _switch_servo(servo: Servo, fault: Fault, on: bool, now_ns: int) -> None:
    """Begin or end a fault of one servo."""
    firmware = servo.firmware
    match fault.kind:
        case FaultKind.SILENT:
            servo.deaf = on
        case FaultKind.MUTE:
            servo.muted = on
        case FaultKind.POWER_LOSS:
            firmware.power(not on, now_ns)
        case FaultKind.ENCODER_STUCK:
            firmware.body.freeze_encoder(on)
        case FaultKind.ENCODER_OFFSET:
            firmware.body.encoder_offset_ticks = fault.offset_ticks if on else 0
        case FaultKind.OVERLOAD if on:
            firmware.raise_error(HardwareError.OVERLOAD)
        case FaultKind.ELECTRICAL_SHOCK if on:
            firmware.raise_error(HardwareError.ELECTRICAL_SHOCK)
        case FaultKind.REBOOT if on:
            servo.reboot(now_ns)


def by_arm(injectors: Mapping[str, Injector], faults: Sequence[Fault], now_ns: int) -> None:
    """Hand faults to the arms they name.  Raises FaultError for an unknown arm or servo; then none is planned."""
    require_known(faults, {name: injector.servo_ids for name, injector in injectors.items()})
    for name, injector in injectors.items():
        injector.add([fault for fault in faults if fault.arm == name], now_ns)
