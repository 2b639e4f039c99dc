"""The mark of an arm: a number in every one of its servos, by which it is told from others of its make.

It stands in Moving Threshold, an EEPROM register that only says from which speed on a servo sets its bit Moving, which
nothing here reads.  Torque stays off.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.motors import eeprom
from agent.motors.find import listen_s
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.identify import survey
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.servo.found import RegisterChange, ServoFound
from drivers.dynamixel.servo.table import LED, MOVING_THRESHOLD
from drivers.dynamixel.servo.wanted import setup_values
from drivers.interface import DriverError, Refusal


class NoMarkError(Refusal):
    """The cell gives this arm no mark."""


class MarkError(DriverError):
    """The arm on the line cannot be given its mark, or not all of its servos have it."""


def marked(cell: Cell, arm: Arm, ports: Path | None) -> ArmMap:
    """The arm's servos and the mark that they are to have; ports: folder of ports, None: the cell's.

    Raises NoMarkError, MapError.
    """
    spec = arm.entry.dynamixel
    if spec is None or spec.mark is None:
        raise NoMarkError(
            f"arm {arm.name}: mark", found="none in the cell", expected="a number beside its port",
            remedy='write it there: dynamixel = { port = "…", mark = 1 }',
        )  # fmt: skip
    port = spec.port if ports is None else str(ports / arm.name)
    return arm_map(cell, arm, port, np.array(arm.entry.q_near_rad))


def plan_mark(bus: Bus, arm: ArmMap, *, replace: bool = False) -> list[RegisterChange]:
    """What must be written so that all servos of a `marked` arm have its mark.  Writes nothing.

    replace: also where all of them have that of another arm, which a person has seen not to be the one on this port.
    Raises IdentityError (not the servos of the arm); EepromError (torque is on); MarkError (all of them have the mark
    of another arm); NoReplyError.
    """
    line = survey(bus, arm, listen_s(arm.baud))
    if line.problems:
        raise line.problems[0]
    for servo in line.servos:
        eeprom.require_torque_off(bus, servo.slot.servo_id)
    if not replace:
        _refuse_another(arm, line.servos)
    changes = []
    for servo in line.servos:
        found = {MOVING_THRESHOLD.name: servo.value(MOVING_THRESHOLD)}
        wanted = {MOVING_THRESHOLD.name: setup_values(servo.slot)[MOVING_THRESHOLD]}
        changes += eeprom.differences(servo.slot.servo_id, servo.slot.model, found, wanted)
    return changes


def apply_mark(bus: Bus, arm: ArmMap, changes: Sequence[RegisterChange]) -> None:
    """Write the mark into one servo after the other and read each back.

    Raises MarkError that says which servos have it by then; writing it again is safe.
    """
    for place, change in enumerate(changes):
        try:
            eeprom.write(bus, [change])
        except DriverError as error:
            left = {one.servo_id for one in changes[place:]}
            have = [slot.servo_id for slot in arm.slots if slot.servo_id not in left]
            raise MarkError(
                error.what, found=error.found, expected=error.expected,
                remedy=f"{error.remedy}; mark {change.wanted} is in servos {_ids(have)}, not known of {_ids(left)}: "
                "give the same command again",
            ) from error  # fmt: skip


@contextmanager
def lit(bus: Bus, arm: ArmMap) -> Iterator[None]:
    """The LEDs of all its servos, so that a person sees which arm it is; off again at the end."""
    ids = [slot.servo_id for slot in arm.slots]
    bus.write_blind(LED, dict.fromkeys(ids, 1))
    try:
        yield
    finally:
        with suppress(DriverError):  # a cable that is gone: what went wrong before is what is told
            bus.write_blind(LED, dict.fromkeys(ids, 0))


def _refuse_another(arm: ArmMap, servos: Sequence[ServoFound]) -> None:
    owners = [arm.mark.owner(servo.value(MOVING_THRESHOLD)) for servo in servos]
    owner = owners[0]
    if owner is not None and owners.count(owner) == len(owners):
        raise MarkError(
            f"mark on {arm.port}", found=f"{servos[0].value(MOVING_THRESHOLD)}, arm {owner}'s",
            expected=f"that of no other arm, or {arm.mark.own}",
            remedy=f"the cables of {arm.arm} and {owner} are swapped; if not, --force replaces the mark, after asking "
            "with the LEDs of the arm on this port lit",
        )  # fmt: skip


def _ids(ids: Sequence[int] | set[int]) -> str:
    return ", ".join(map(str, sorted(ids))) or "none"
