"""What brings an arm back that lapsed: whether it can be, its port again, and the certainty that it is the same arm.

Nothing here writes to a servo; `DynamixelDriver.recover` arms the watchdogs again once this is done.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.line.port import Now, Port
from drivers.dynamixel.running import Running
from drivers.dynamixel.stale import stale

TORQUE_GONE = frozenset({FaultCause.HARDWARE_ERROR, FaultCause.TORQUE_LOST, FaultCause.REBOOTED})


def only_tripped(faults: Sequence[DxlServoFault]) -> bool:
    """True where watchdogs have fired and no servo has lost its torque otherwise."""
    causes = {fault.cause for fault in faults}
    return FaultCause.WATCHDOG_TRIPPED in causes and not causes & TORQUE_GONE


def limp(arm: ArmMap, faults: Sequence[DxlServoFault]) -> DxlServoFault | None:
    """What to say of an arm of which no servo has torque any more, None while one has: nothing can be held with it.

    Watchdogs that have fired count where a servo has lost its torque otherwise, for then the arm does not come back.
    """
    off = [fault for fault in faults if fault.cause in TORQUE_GONE]
    idle = {fault.servo_id for fault in faults if fault.cause is FaultCause.WATCHDOG_TRIPPED or fault in off}
    if not off or not {slot.servo_id for slot in arm.slots} <= idle:
        return None
    return off[0].that_is_of_all()


def without_trips(faults: Sequence[DxlServoFault]) -> list[DxlServoFault]:
    """What is wrong besides watchdogs that had fired."""
    return [fault for fault in faults if fault.cause is not FaultCause.WATCHDOG_TRIPPED]


def open_again(port: Port, running: Running) -> None:
    """Open a port that was lost and ask every servo who it is; the port is closed when this raises.

    Raises PortError, IdentityError.
    """
    port.close()
    with contextlib.ExitStack() as undo:
        undo.callback(port.close)
        port.open()
        running.recognise()
        undo.pop_all()


def make_sure(running: Running, arm: ArmMap, clock: Now) -> None:
    """See that every servo answers and is the one that was there before.

    Raises StaleJointsError, NoReplyError, IdentityError, PortLostError.
    """
    running.hear_health()
    cycle = running.reader.read()
    reading = running.interpret(cycle, clock.now_ns())
    if None in cycle.rows:
        raise stale(arm, cycle, reading)
    running.recognise()
