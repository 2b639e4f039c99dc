"""Which servos an emulated arm has and how they sit on its joints, as data; built from what an arm file says.

Entries are recognised by their shape, because the simulator does not import the agent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import BAUD_RATES, NO_SECONDARY_ID
from drivers.dynamixel.servo.counts import TICK_CENTRE
from drivers.dynamixel.servo.models import SERVOS
from drivers.fingers import Fingers
from sim_backend.wire.servo import DEFAULT_FIRMWARE

# Gearbox friction of a servo per N·m of its stall torque: an XM430's 0.1 N·m and 0.05 N·m s/rad, scaled (docs/arms.md)
COULOMB_PER_STALL = 0.1 / 4.1
VISCOUS_S_PER_RAD = 0.05 / 4.1


class JointEntry(Protocol):
    """One joint of an arm file."""

    @property
    def name(self) -> str:
        """Joint name."""
        ...

    @property
    def servo(self) -> str:
        """Servo model name."""
        ...

    @property
    def ids(self) -> Sequence[int]:
        """IDs of its servos; the later ones are shadows of the first."""
        ...

    @property
    def reverse(self) -> Sequence[bool]:
        """Drive Mode reverse of each servo."""
        ...

    @property
    def zero_tick(self) -> int:
        """Reported tick at 0 rad."""
        ...

    @property
    def position_limit_ticks(self) -> tuple[int, int]:
        """Min and Max Position Limit."""
        ...


@dataclass(frozen=True, slots=True)
class ServoWiring:
    """One servo as it was set up: what its EEPROM holds beyond the factory values."""

    servo_id: int
    model: str
    reversed_mount: bool = False  # the horn turns against the joint; Drive Mode makes up for it
    zero_tick: int = TICK_CENTRE
    firmware: int = DEFAULT_FIRMWARE
    eeprom: Mapping[str, int] = field(default_factory=dict)  # e-manual register name -> value


@dataclass(frozen=True, slots=True)
class JointWiring:
    """One joint and its servos.  `index` is the joint's place in the plant's arm; None: it is in no plant."""

    name: str
    servos: tuple[ServoWiring, ...]
    index: int | None = None
    start_rad: float = 0.0  # of a joint in no plant
    inertia_kg_m2: float = 0.01
    fingers: Fingers | None = None  # of a gripper

    @property
    def stall_torque_Nm(self) -> float:
        """Of all its servos together."""
        return sum(SERVOS[wired.model].stall_torque_Nm for wired in self.servos)

    @property
    def coulomb_Nm(self) -> float:
        """Dry friction of its servos' gearboxes."""
        return COULOMB_PER_STALL * self.stall_torque_Nm

    @property
    def viscous_Nm_s_per_rad(self) -> float:
        """Viscous friction of its servos' gearboxes."""
        return VISCOUS_S_PER_RAD * self.stall_torque_Nm


@dataclass(frozen=True, slots=True)
class ArmWiring:
    """All joints of one arm on one bus."""

    name: str
    joints: tuple[JointWiring, ...]
    baud: int = 1_000_000
    plant_arm: int | None = None  # the arm's place in the plant


def baud_code(baud: int) -> int:
    """Value of the Baud Rate register.  Raises ValueError for a speed no servo knows."""
    for code, known in BAUD_RATES.items():
        if known == baud:
            return code
    raise ValueError(f"baud {baud}: servos know {sorted(BAUD_RATES.values())}")


def servo_eeprom(
    *,
    baud: int,
    reverse: bool = False,
    secondary_id: int = NO_SECONDARY_ID,
    position_limit_ticks: tuple[int, int] = (0, 4095),
    mark: int | None = None,
) -> Mapping[str, int]:
    """EEPROM of a servo as Interbotix ships it: return delay 0, its direction, shadow and limits set; and its mark."""
    low, high = position_limit_ticks
    marked = {} if mark is None else {table.MOVING_THRESHOLD.name: mark}
    return MappingProxyType(
        {
            **marked,
            table.BAUD_RATE.name: baud_code(baud),
            table.RETURN_DELAY_TIME.name: 0,
            table.DRIVE_MODE.name: int(reverse),
            table.SECONDARY_ID.name: secondary_id,
            table.MIN_POSITION_LIMIT.name: low,
            table.MAX_POSITION_LIMIT.name: high,
        }
    )


def wire_joint(
    entry: JointEntry, baud: int, *, index: int | None, start_rad: float = 0.0, mark: int | None = None
) -> JointWiring:
    """Return the servos of one joint of an arm file, the first one leading, the others its shadows."""
    leader = entry.ids[0]
    servos = []
    for servo_id, reverse in zip(entry.ids, entry.reverse, strict=True):
        eeprom = servo_eeprom(
            baud=baud,
            reverse=reverse,
            secondary_id=NO_SECONDARY_ID if servo_id == leader else leader,
            position_limit_ticks=entry.position_limit_ticks,
            mark=mark,
        )
        servos.append(ServoWiring(servo_id, entry.servo, reverse, entry.zero_tick, eeprom=eeprom))
    return JointWiring(entry.name, tuple(servos), index, start_rad)


def wire_arm(
    name: str,
    joints: Sequence[JointEntry],
    controlled: Sequence[str],
    *,
    baud: int,
    plant_arm: int | None,
    start_rad: Mapping[str, float] = MappingProxyType({}),
    mark: int | None = None,
) -> ArmWiring:
    """Return an arm whose `controlled` joints are the plant's, in that order; the others move by themselves.

    Give the gripper as one more entry of `joints`.  `start_rad` places joints of no plant, `mark` is in all servos.
    """
    places = {joint: index for index, joint in enumerate(controlled)} if plant_arm is not None else {}
    wired = (
        wire_joint(entry, baud, index=places.get(entry.name), start_rad=start_rad.get(entry.name, 0.0), mark=mark)
        for entry in joints
    )
    return ArmWiring(name, tuple(wired), baud, plant_arm)
