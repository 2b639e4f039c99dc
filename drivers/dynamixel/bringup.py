"""From a limp arm to one that holds zero torque, and back, in an order that does not jerk.

EEPROM only where it differs; then goals, because a mode change sets them to their limits; then the pose; then the
watchdog, which is read back; then torque.  Whatever fails on the way ends with torque off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers.dynamixel.arm_map import ArmMap, JointRole, ServoSlot
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import DriverEvent, EventKind, EventSink
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.monitor import Page, status_bytes
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, OperatingMode
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.judge import HARDWARE, POSE, REST, TORQUE, broken
from drivers.dynamixel.servo.table import (
    BUS_WATCHDOG,
    GOAL_CURRENT,
    GOAL_POSITION,
    GOAL_PWM,
    HARDWARE_ERROR_STATUS,
    INDIRECT_ADDRESSES,
    LED,
    MAX_POSITION_LIMIT,
    MIN_POSITION_LIMIT,
    PRESENT_POSITION,
    TORQUE_ENABLE,
    Register,
)
from drivers.dynamixel.servo.units import watchdog_count
from drivers.interface import DriverError

_NOT_OBEYED = {
    TORQUE_ENABLE: FaultCause.REFUSED_TORQUE,
    GOAL_CURRENT: FaultCause.GOAL_IGNORED,
    GOAL_PWM: FaultCause.GOAL_IGNORED,
}


class PoseError(IdentityError):
    """The arm is not where the cell file says it starts."""


def effort_register(slot: ServoSlot) -> Register:
    """Goal register that carries this servo's torque, or bounds it where it is held."""
    return GOAL_CURRENT if slot.model.has_current_mode else GOAL_PWM


def goal_limits(servos: Sequence[ServoFound]) -> dict[int, int]:
    """Largest goal count of each servo by ID: of a pair the smaller limit, for both get the same goals."""
    own = {servo.slot.servo_id: servo.goal_limit for servo in servos}
    return {servo.slot.servo_id: min(own[i] for i in servo.slot.joint.ids) for servo in servos}


def efforts_at_rest(servos: Sequence[ServoFound]) -> dict[int, int]:
    """Goal count of each servo by ID before torque comes on: none if controlled, what it holds with if held."""
    limits = goal_limits(servos)
    return {servo.slot.servo_id: _effort_at_rest(servo.slot, limits[servo.slot.servo_id]) for servo in servos}


def _effort_at_rest(slot: ServoSlot, limit: int) -> int:
    if slot.joint.role is JointRole.CONTROLLED:
        return 0
    return min(limit, slot.model.share_count(effort_register(slot), slot.joint.hold_effort))


class BringUp:
    """Brings one identified arm up and down."""

    def __init__(self, bus: Bus, arm: ArmMap, servos: Sequence[ServoFound], tell: EventSink) -> None:
        self._bus = bus
        self._arm = arm
        self._servos = tuple(servos)
        self._commanded = tuple(servo for servo in self._servos if not servo.slot.shadow)
        self._rest = efforts_at_rest(self._servos)
        self._tell = tell

    def configure(self) -> None:
        """Write EEPROM where it differs, and read it back.

        Raises IdentityError while a servo holds torque, and where one has had to switch itself off since it was found.
        """
        for servo in self._servos:
            for rule, register in ((TORQUE, TORQUE_ENABLE), (HARDWARE, HARDWARE_ERROR_STATUS)):
                misfit = broken(rule, self._again(servo, register))
                if misfit is not None:
                    raise IdentityError.of(misfit)
        for servo in self._servos:
            servo_id = servo.slot.servo_id
            for change in servo.changes:
                if self._bus.read(servo_id, change.register) == change.wanted:
                    continue  # written by an earlier `enable`
                self._bus.write(servo_id, change.register, change.wanted)
                self._verify(servo, change.register, change.wanted)
                text = f"{change.register.name} {change.found} → {change.wanted}"
                self._tell(DriverEvent(EventKind.EEPROM_WRITTEN, text, servo_id, servo.slot.joint.name))

    def zero_goals(self) -> None:
        """Goals that move nothing: zero effort, or the present place with limited effort.  Shadows follow."""
        for servo in self._servos:
            servo_id = servo.slot.servo_id
            self._bus.write(servo_id, BUS_WATCHDOG, 0)  # a tripped one would refuse the goals
            for indirect, address in zip(INDIRECT_ADDRESSES, status_bytes(effort_register(servo.slot)), strict=False):
                self._bus.write(servo_id, indirect, address)
            self._bus.write(servo_id, LED, 1)
        self._write_ram()
        for servo in self._commanded:
            self._bus.write(servo.slot.servo_id, effort_register(servo.slot), self._rest[servo.slot.servo_id])
            if servo.slot.joint.role is not JointRole.CONTROLLED:
                self._bus.write(servo.slot.servo_id, GOAL_POSITION, self._here(servo))
        for servo in self._servos:
            self._verify(servo, effort_register(servo.slot), self._rest[servo.slot.servo_id])

    def _write_ram(self) -> None:
        """What another program may have left in RAM, written where it differs and read back; a shadow's own last."""
        for servo in self._servos:
            servo_id = servo.slot.servo_id
            for register, wanted in servo.ram.items():
                found = self._bus.read(servo_id, register)
                if found == wanted:
                    continue
                self._bus.write(servo_id, register, wanted)
                self._verify(servo, register, wanted)
                text = f"{register.name} {found} → {wanted}"
                self._tell(DriverEvent(EventKind.RAM_WRITTEN, text, servo_id, servo.slot.joint.name))

    def _again(self, servo: ServoFound, register: Register) -> ServoFound:
        """The servo with one register as it is now."""
        value = self._bus.read(servo.slot.servo_id, register)
        return replace(servo, values={**servo.values, register.name: value})

    def _here(self, servo: ServoFound) -> int:
        """Position goal at which a servo that is held stays where it is."""
        servo_id = servo.slot.servo_id
        here = self._bus.read(servo_id, PRESENT_POSITION)
        if servo.slot.joint.mode is OperatingMode.POSITION:  # this mode refuses goals outside the servo's limits
            low, high = (self._bus.read(servo_id, r) for r in (MIN_POSITION_LIMIT, MAX_POSITION_LIMIT))
            here = max(low, min(high, here))
        return here

    def check_pose(self) -> None:
        """Every joint within its limits and near its start, or its rest.  Raises PoseError."""
        for servo in self._commanded:
            now = self._again(servo, PRESENT_POSITION)
            misfit = broken(POSE, now) or broken(REST, now)
            if misfit is not None:
                raise PoseError.of(misfit)

    def torque_on(self) -> None:
        """Watchdog and proof that every servo has it, then torque and proof of both.

        Raises DxlServoFault, and IdentityError of a servo that has had to switch itself off.
        """
        watchdog = watchdog_count(self._arm.watchdog_s)
        for servo in self._commanded:
            self._bus.write(servo.slot.servo_id, BUS_WATCHDOG, watchdog)
        for servo in self._servos:  # a shadow answers no write: that it has missed one is seen here alone
            self._verify(servo, BUS_WATCHDOG, watchdog)
        try:
            self._bus.write_blind(TORQUE_ENABLE, {servo.slot.servo_id: 1 for servo in self._commanded})
            for servo in self._servos:
                self._obeys(servo)
                self._verify(servo, BUS_WATCHDOG, watchdog)
        except DriverError:
            torque_off(self._bus, self._arm)
            raise

    def _obeys(self, servo: ServoFound) -> None:
        """It has the torque that it was told to have; where it has a reason not to, that is what is told."""
        try:
            self._verify(servo, TORQUE_ENABLE, 1)
        except DxlServoFault as fault:
            misfit = broken(HARDWARE, self._again(servo, HARDWARE_ERROR_STATUS))
            if misfit is None:
                raise
            raise IdentityError.of(misfit) from fault

    def has_stopped(self, *, half_armed: bool = False) -> bool:
        """Whether the arm needs `rearm`: a bus watchdog has fired and every servo has its torque; writes nothing.

        half_armed: a `rearm` failed, so that the arm needs another whatever its watchdogs say: some goals may be those
        of before.  An arm with a servo without torque is never armed again: it holds with those that still obey.
        Raises DxlServoFault where none does.
        """
        stopped = (WATCHDOG_TRIPPED, 0) if half_armed else (WATCHDOG_TRIPPED,)
        on = [bool(self._bus.read(servo.slot.servo_id, TORQUE_ENABLE)) for servo in self._servos]
        ids = [servo.slot.servo_id for servo, has in zip(self._servos, on, strict=True) if has]
        fired = [self._bus.read(servo_id, BUS_WATCHDOG) in stopped for servo_id in ids]
        if all(on):
            return half_armed or any(fired)
        if all(fired):
            first = self._servos[on.index(False)].slot
            fault = DxlServoFault.of(FaultCause.TORQUE_LOST, first, found="Torque Enable 0", expected="1")
            raise fault.that_is_of_all()
        return False

    def rearm(self) -> None:
        """After bus watchdogs have fired: no effort, the present place, armed again.  Torque stays on.

        Goals cannot be written while a watchdog is tripped, and the old ones count again once it is cleared; so the
        zeros follow.  All goes out in one piece: without watchdogs nobody would stop servos whose process is killed in
        between.  No servo answers a sync write; so that what arms them goes thrice, and reaches them with two lost.
        Raises DxlServoFault when a servo does not obey.
        """
        held = [servo for servo in self._commanded if servo.slot.joint.role is not JointRole.CONTROLLED]
        here = {servo.slot.servo_id: self._here(servo) for servo in held}
        slots = [servo.slot for servo in self._commanded]
        efforts = [
            {slot.servo_id: self._rest[slot.servo_id] for slot in slots if effort_register(slot) is register}
            for register in (GOAL_CURRENT, GOAL_PWM)
        ]
        goals = zip((GOAL_CURRENT, GOAL_PWM, GOAL_POSITION), (*efforts, here), strict=True)
        watchdog = watchdog_count(self._arm.watchdog_s)
        cleared, armed = ((BUS_WATCHDOG, dict.fromkeys((slot.servo_id for slot in slots), n)) for n in (0, watchdog))
        goals_of_rest = [(register, values) for register, values in goals if values]
        self._bus.write_all_blind([cleared, armed, *goals_of_rest, armed, armed])
        for servo in self._servos:
            self._verify(servo, BUS_WATCHDOG, watchdog)
            self._verify(servo, effort_register(servo.slot), self._rest[servo.slot.servo_id])
        for servo in held:
            self._verify(servo, GOAL_POSITION, here[servo.slot.servo_id])

    def _verify(self, servo: ServoFound, register: Register, wanted: int) -> None:
        value = self._bus.read(servo.slot.servo_id, register)
        if value != wanted:
            raise DxlServoFault(
                _NOT_OBEYED.get(register, FaultCause.NOT_KEPT),
                servo_id=servo.slot.servo_id,
                joint=servo.slot.joint.name,
                found=f"{register.name} {value}",
                expected=str(wanted),
            )


def torque_off(bus: Bus, arm: ArmMap) -> None:
    """Torque off everywhere, blind and twice; then the watchdogs of joints that say so, and the rest once more.

    A servo that has not said so keeps its watchdog, which stops it; so does one that it follows, or that follows it.
    Raises DriverError when the port is gone.
    """
    ids = [slot.servo_id for slot in arm.slots if not slot.shadow]
    bus.write_blind(TORQUE_ENABLE, dict.fromkeys(ids, 0))
    bus.settle()  # the first may have met an answer on the wire, and nobody answers a sync write
    bus.write_blind(TORQUE_ENABLE, dict.fromkeys(ids, 0))
    rows = bus.read_all(*Page.STATUS.value, [slot.servo_id for slot in arm.slots])
    said = {servo_id for servo_id, (torque, *_) in rows.items() if torque == 0}
    if off := [joint.ids[0] for joint in arm.joints if said.issuperset(joint.ids)]:
        bus.write_blind(BUS_WATCHDOG, dict.fromkeys(off, 0))
        bus.write_blind(LED, dict.fromkeys(off, 0))
    if rest := [servo_id for servo_id in ids if servo_id not in off]:
        bus.write_blind(TORQUE_ENABLE, dict.fromkeys(rest, 0))
