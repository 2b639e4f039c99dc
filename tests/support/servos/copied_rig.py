"""Copies of an emulated arm with its driver: to bring one up is most of a short test in virtual time."""

from __future__ import annotations

import copy
import copyreg
import functools
import struct
from types import MappingProxyType

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import REGISTERS
from tests.support.servos.dxl_rig import WX200, Rig, enabled

copyreg.pickle(struct.Struct, lambda made: (struct.Struct, (made.format,)))
copyreg.pickle(MappingProxyType, lambda made: (MappingProxyType, (dict(made),)))


def copied(rig: Rig) -> Rig:
    """The same arm, driver and instant, of which nothing that changes is shared; its events are its own, too."""
    events = list(rig.events)
    layouts = (servo.firmware.memory.layout for servo in rig.bus.servos)
    constants = (rig.arm, *SERVOS.values(), *REGISTERS, *layouts, *rig.driver.faults)
    kept = {id(constant): constant for constant in constants}
    found: Rig = copy.deepcopy(rig, {**kept, id(rig.events): events, id(rig.driver._on_event): events.append})
    return found


def brought_up(arm: ArmMap = WX200) -> Rig:
    """An arm ready for the cycle, as `enabled` makes it."""
    return copied(_brought_up(arm))


@functools.cache
def _brought_up(arm: ArmMap) -> Rig:
    return enabled(arm)
