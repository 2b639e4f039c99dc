"""The way to an arm that is connected, and what is told of one: its `ArmInfo`, and servos that answer one by one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.dynamixel.events import DriverEvent, EventKind, EventSink
from drivers.dynamixel.line.port import Port
from drivers.dynamixel.pace import ReadTimes
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.stale import joint_names
from drivers.interface import ArmInfo


@contextlib.contextmanager
def opened(port: Port, baud: int) -> Iterator[None]:
    """The port, at this speed.  Raises PortError, also where it is lost before the block is over."""
    port.baud = baud  # one that was lost while servos were looked for at others has another
    try:
        port.open()
        yield
    except (PortLostError, WriteTimeoutError) as error:
        raise PortError(error.what, found=error.found, expected=error.expected, remedy=error.remedy) from error


def all_fast(found: Sequence[ServoFound], on_event: EventSink) -> bool:
    """Whether all servos answer a fast sync read; those that do not are told."""
    slow = [f"{s.slot.servo_id} ({s.slot.joint.servo}, {s.firmware})" for s in found if not s.fast]
    if slow:
        text = f"servo {', '.join(slow)}: one status packet per servo instead"
        on_event(DriverEvent(EventKind.SLOW_SYNC_READ, text))
    return not slow


def arm_info(arm: ArmMap, found: Sequence[ServoFound], fast: bool, times: ReadTimes | None) -> ArmInfo:
    """What `connect` answers; times: of the read, where they are known yet."""
    tau_max = np.array([joint.tau_max_Nm for joint in arm.controlled])
    tau_max.flags.writeable = False
    return ArmInfo(arm.arm, joint_names(arm), tau_max, _description(arm, found, fast, times))


def _description(arm: ArmMap, found: Sequence[ServoFound], fast: bool, times: ReadTimes | None) -> str:
    firmware = sorted({servo.firmware for servo in found})
    read = f", read {times.median_s * 1e3:.2f} ms of {1e3 / arm.rate_hz:.2f} ms" if times else ""
    return (
        f"{arm.port} at {arm.baud} bit/s, {len(found)} servos, "
        f"firmware {'/'.join(map(str, firmware))}, {'fast' if fast else 'plain'} sync read{read}"
    )
