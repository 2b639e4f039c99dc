"""Set up one new servo: find it alone on its line, show what will change, write, read back.

Torque stays off.  Scanning is `find.survey`, saving and restoring EEPROM is in `dump`; why none of it uses the official
SDK: see `line`.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.config.schema.arm import ArmFile
from agent.config.servo_map import GRIPPER, resting_joints
from agent.motors import eeprom
from agent.motors.find import ALL_BAUDS, Tell, search
from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.found import Consequence, RegisterChange, ServoFound
from drivers.dynamixel.servo.judge import judge
from drivers.dynamixel.servo.wanted import line_values, setup_values
from drivers.interface import DriverError, Refusal


class JointError(Refusal):
    """The arm file has no such servo."""


class SetupError(DriverError):
    """The servo on the line is not one that can be set up as asked; nothing was written."""


def servo_of(file: ArmFile, joint: str, *, shadow: bool) -> ServoSlot:
    """The servo of a joint, or its shadow.  Raises JointError naming what there is."""
    joints = {j.name: j for j in resting_joints(file)}
    servos = {j.name: j.servo for j in file.joints} | {GRIPPER: file.gripper.servo}
    if joint in servos and joint not in joints:
        raise JointError(
            f"joint {joint} of {file.model}", found=f"servo {servos[joint]} of Protocol 1.0, which cannot be driven",
            expected=" or ".join(joints), remedy="name one of these; there is no Protocol 2.0 firmware for it",
        )  # fmt: skip
    if joint not in joints:
        raise JointError(
            f"joint of {file.model}", found=repr(joint), expected=" or ".join(joints), remedy="name one of its joints"
        )
    found = joints[joint]
    if shadow and len(found.ids) == 1:
        pairs = [j.name for j in joints.values() if len(j.ids) > 1]
        raise JointError(
            f"joint {joint} of {file.model}", found="a single servo",
            expected="one with a shadow: " + (" or ".join(pairs) or "none on this arm"), remedy="leave --shadow out",
        )  # fmt: skip
    place = int(shadow)
    return ServoSlot(found.ids[place], found, shadow, found.reverse[place])


@dataclass(frozen=True, slots=True)
class SetupPlan:
    """What will be written to the one servo on the line."""

    slot: ServoSlot
    servo_id: int  # as it is now
    baud: int
    firmware: int
    changes: tuple[RegisterChange, ...]

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
    _refuse_other_kind(slot, ping)
    eeprom.require_torque_off(bus, ping.servo_id)
    changes = _differences(bus, slot, arm_baud, ping.servo_id)
    return SetupPlan(slot, ping.servo_id, baud, ping.firmware, tuple(changes))


def apply_setup(bus: Bus, plan: SetupPlan, arm_baud: int) -> None:
    """Write the plan, then find the servo where it must be now and compare everything again.

    Raises EepromError, NoReplyError, RejectedError.
    """
    bus.port.set_baud(plan.baud)
    eeprom.write(bus, plan.changes)
    bus.port.set_baud(arm_baud)
    bus.settle()
    servo_id = plan.slot.servo_id
    bus.ping(servo_id)
    eeprom.require_torque_off(bus, servo_id)
    left = _differences(bus, plan.slot, arm_baud, servo_id)
    if left:
        raise eeprom.EepromError(
            f"servo {servo_id}: {left[0].register.name}", found=left[0].found, expected=left[0].wanted,
            remedy="set it up again; if it persists the servo is defective",
        )  # fmt: skip


def _differences(bus: Bus, slot: ServoSlot, arm_baud: int, servo_id: int) -> list[RegisterChange]:
    """What must be written to the servo that is `servo_id` now."""
    wanted = {r.name: value for r, value in {**line_values(slot, arm_baud), **setup_values(slot)}.items()}
    found = eeprom.read(bus, servo_id, eeprom.writable(slot.model))
    return eeprom.differences(servo_id, slot.model, found, wanted)


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


def _refuse_other_kind(slot: ServoSlot, ping: Ping) -> None:
    """Raise SetupError for a servo that the driver would refuse for what it is, whatever its EEPROM says."""
    for misfit in judge(ServoFound(slot, ping.model_number, ping.firmware, {})):
        if misfit.rule.consequence is Consequence.NO_CONNECTION:
            said = misfit.said
            raise SetupError(
                f"servo {ping.servo_id} as {slot.joint.name}: {misfit.rule.name}", found=said.found,
                expected=said.expected, remedy=said.remedy,
            )  # fmt: skip
