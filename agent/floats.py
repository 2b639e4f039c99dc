"""What an arm that a hand guides does by mode: floats, stands where it was stopped, sinks; pure.

An arm that moves while others float works by the law until it is stopped, and from then on does as they do.
"""

from __future__ import annotations

from agent.control import floating
from agent.control.floating import Floating
from agent.control.law import Offline
from agent.control.memory import Memory
from agent.control.models import ArmModel
from agent.control.terms import Terms
from agent.modes import Event, Mode, next_mode
from drivers.interface import Vector


def torque(
    model: ArmModel, offline: Offline, own: Floating, mode: Mode, memory: Memory, q: Vector, dq: Vector
) -> Terms:
    """One tick at this arm's (q, dq), each (n,), in a mode of `agent.modes.FLOATING`."""
    if mode is Mode.FLOAT:
        return floating.afloat(model, offline, own, memory.age, memory.q_hold, q, dq)
    if mode is Mode.SINK:
        return floating.sinking(model, offline, own, memory.age, q, dq)
    return floating.standing(model, offline, own, memory.q_hold, q, dq)


def following(mode: Mode, happened: Event) -> Mode:
    """Mode of the next tick of an arm that floats, or moves while others do: where others hold, it stands."""
    found = next_mode(mode, happened)
    return Mode.STAND if found is Mode.HOLD else found


def yielding(own: Floating, memory: Memory, q: Vector) -> Memory:
    """Memory of an arm that stands, at q (n,): pushed beyond its reach, it stays where the hand leaves it."""
    if memory.q_hold is None:
        return memory
    reach = own.stand_reach_rad
    return memory._replace(q_hold=q + (memory.q_hold - q).clip(-reach, reach))


def entered(own: Floating, mode: Mode, memory: Memory, seen: tuple[Vector, Vector] | None) -> Memory:
    """Memory with which a mode begins; seen: (q, dq) of the tick before, None without a fresh state."""
    memory = memory._replace(age=0.0)
    if seen is None:
        return memory._replace(hold=None, q_hold=None)  # it stands where it is seen next
    if mode is Mode.STAND and memory.hold is not None:
        return memory._replace(q_hold=own.came_to_rest(*seen))
    return memory
