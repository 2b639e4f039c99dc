"""Rules of what a servo keeps in RAM beside its goals, from one program to the next, until its supply goes off."""

from __future__ import annotations

from drivers.dynamixel.servo.found import Consequence, Rule, Said, ServoFound
from drivers.dynamixel.servo.table import OPERATING_MODE, PWM_LIMIT, Register
from drivers.dynamixel.servo.wanted import RAM_THAT_IS_KEPT


def _rule(register: Register) -> Rule:
    """The register is as the arm needs it; in another mode than the arm's it says nothing, for the change sets it."""

    def check(servo: ServoFound) -> Said | None:
        found, right_mode = servo.value(register), servo.value(OPERATING_MODE) == servo.slot.joint.mode
        wanted = servo.ram.get(register, found) if right_mode else found
        return None if found == wanted else Said(str(found), str(wanted), "the agent sets it before torque comes on")

    return Rule(register.name, (register, PWM_LIMIT, OPERATING_MODE), Consequence.MENDED, check)


KEPT_RAM = tuple(map(_rule, RAM_THAT_IS_KEPT))
