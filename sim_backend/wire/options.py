"""What the manual leaves open about a servo or a bus, as switches."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sim_backend.wire.drive import Stop
from sim_backend.wire.motor import AMBIENT_C
from sim_backend.wire.overload import REPORTED, OverloadOptions
from sim_backend.wire.packet import UnstuffedHeader


class WatchdogFeed(Enum):
    """Which instruction packets restart the bus watchdog; the manual says any, hardware is unconfirmed."""

    ANY_PACKET = "any"
    OWN_PACKET = "own"


class GoalAtTorqueOn(Enum):
    """What Goal Position holds when torque comes on in a position mode."""

    PRESENT = "present"
    KEPT = "kept"  # a goal written earlier is pursued at once


class SilentPredecessor(Enum):
    """What the later servos of a sync or bulk read do when one before them does not answer."""

    WAITED_OUT = "waited_out"  # they answer after the time its reply would have taken
    ENDS_REPLY = "ends_reply"  # they stay silent too; fast reads always end


@dataclass(frozen=True, slots=True)
class ServoOptions:
    """Open questions and constants of one servo's emulation."""

    watchdog_stop: Stop = Stop.LIMP  # velocity and position modes always stop and hold
    watchdog_feed: WatchdogFeed = WatchdogFeed.ANY_PACKET
    goal_at_torque_on: GoalAtTorqueOn = GoalAtTorqueOn.PRESENT
    overload: OverloadOptions = REPORTED
    boot_ns: int = 300_000_000
    coulomb_Nm: float = 0.0  # gearbox friction, where the plant has none
    ambient_C: float = AMBIENT_C


@dataclass(frozen=True, slots=True)
class BusOptions:
    """Open questions of one bus's emulation."""

    silent_predecessor: SilentPredecessor = SilentPredecessor.WAITED_OUT
    unstuffed_header: UnstuffedHeader = UnstuffedHeader.RESTARTS
    answers_damaged: bool = True  # a packet with a wrong CRC is answered by CRC error
