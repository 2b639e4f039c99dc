"""Set up one new servo: find it alone on its line, show what will change, write, read back.  Never switches torque on.

Scanning is `find.survey`, saving and restoring EEPROM is in `dump`; why none of it uses the official SDK: see `line`.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.motors import eeprom
from agent.motors.eeprom import Difference
from agent.motors.find import ALL_BAUDS, Tell, search
from agent.motors.wanted import eeprom_of
from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.table import SERVOS_BY_NUMBER, ServoModel
from drivers.interface import DriverError

FIRMWARE_MIN = 38  # the bus watchdog exists from here on


class SetupError(DriverError):
    """The servo on the line is not one that can be set up as asked; nothing was written."""


@dataclass(frozen=True, slots=True)
class SetupPlan:
    """What will be written to the one servo on the line."""

    slot: ServoSlot
    servo_id: int  # as it is now
    baud: int
    firmware: int
    changes: tuple[Difference, ...]

    @property
    def title(self) -> str:
        """Which servo becomes what."""
        role = f"{self.slot.joint.name}{' shadow' if self.slot.shadow else ''}"
        return (
            f"{self.slot.joint.servo} with ID {self.servo_id} at {self.baud} bit/s, firmware {self.firmware} "
            f"→ {role}, ID {self.slot.servo_id}"
        )


def plan_setup(bus: Bus, slot: ServoSlot, arm_baud: int, tell: Tell) -> SetupPlan:
    """Find the one servo on the line and compare it with what it shall become.  Writes nothing.

    Raises SetupError (none, several, another model, old firmware), EepromError (torque is on), NoReplyError.
    """
    baud, ping = _single(bus, tell)
    bus.port.set_baud(baud)
    model = _right_model(slot, ping)
    eeprom.require_torque_off(bus, ping.servo_id)
    found = eeprom.read(bus, ping.servo_id, eeprom.writable(model))
    changes = eeprom.differences(ping.servo_id, model, found, eeprom_of(slot, arm_baud))
    return SetupPlan(slot, ping.servo_id, baud, ping.firmware, tuple(changes))


def apply_setup(bus: Bus, plan: SetupPlan, arm_baud: int) -> None:
    """Write the plan, then find the servo where it must be now and compare everything again.

    Raises EepromError, NoReplyError, RejectedError.
    """
    bus.port.set_baud(plan.baud)
    eeprom.write(bus, plan.changes)
    bus.port.set_baud(arm_baud)
    bus.settle()
    servo_id, model = plan.slot.servo_id, plan.slot.model
    bus.ping(servo_id)
    eeprom.require_torque_off(bus, servo_id)
    found = eeprom.read(bus, servo_id, eeprom.writable(model))
    left = eeprom.differences(servo_id, model, found, eeprom_of(plan.slot, arm_baud))
    if left:
        raise eeprom.EepromError(
            f"servo {servo_id}: {left[0].register.name}", found=left[0].found, expected=left[0].wanted,
            remedy="set it up again; if it persists the servo is defective",
        )  # fmt: skip


def _single(bus: Bus, tell: Tell) -> tuple[int, Ping]:
    """The one servo on the line; every speed is searched before it is believed to be alone."""
    heard: list[tuple[int, Ping]] = []
    for answers in search(bus, ALL_BAUDS, tell):
        if answers.damaged:
            raise SetupError(
                "servos on the line", found=f"replies that destroy each other at {answers.baud} bit/s",
                expected="exactly one servo", remedy="two servos share an ID: connect only the one to be set up",
            )  # fmt: skip
        heard += [(answers.baud, ping) for ping in answers.pings]
        if len(heard) > 1:
            break
    if not heard:
        raise SetupError(
            "servos on the line", found="none that answers, at any speed", expected="exactly one servo",
            remedy="switch on its 12 V supply and check its cable; a servo with Protocol 1.0 firmware does not answer",
        )  # fmt: skip
    if len(heard) > 1:
        names = ", ".join(f"ID {ping.servo_id} at {baud} bit/s" for baud, ping in heard)
        raise SetupError(
            "servos on the line", found=names, expected="exactly one servo",
            remedy="connect only the one to be set up: a wrong ID on the wrong servo moves the wrong joint",
        )  # fmt: skip
    return heard[0]


def _right_model(slot: ServoSlot, ping: Ping) -> ServoModel:
    model = SERVOS_BY_NUMBER.get(ping.model_number)
    if model is None or model.name != slot.joint.servo:
        raise SetupError(
            f"servo {ping.servo_id}: model",
            found=model.name if model is not None else f"model number {ping.model_number}",
            expected=f"{slot.joint.servo} for joint {slot.joint.name}",
            remedy="take the right servo, or name the right joint",
        )
    if ping.firmware < FIRMWARE_MIN:
        raise SetupError(
            f"servo {ping.servo_id}: firmware", found=ping.firmware, expected=f"{FIRMWARE_MIN} or newer (bus watchdog)",
            remedy="update it with DYNAMIXEL Wizard 2.0",
        )  # fmt: skip
    return model
