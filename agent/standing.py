"""Where an arm stands that follows nothing: what its memory keeps of a pose to hold, taken from what it sees; pure.

`agent.runner` calls these where the mode changes or time was lost, and `agent.replay.chain` for the same rows.
"""

from __future__ import annotations

import math

import numpy as np

from agent.calm import JOINTS
from agent.control.alignment import between
from agent.control.brace import NOT_BRACED, begun
from agent.control.errors import Errors, attitude_angle
from agent.control.memory import Memory
from agent.loop import Agent, Outcome
from agent.missed import GENTLE_TICKS
from agent.modes import Mode
from agent.safety import Flag
from drivers.interface import Vector

HOLD_DESIRED_MAX_M = 0.02  # a hold keeps the desired pose when the object is this near to it, else where the object is
HOLD_DESIRED_MAX_RAD = 0.1


def hold_here(agent: Agent, q: Vector, memory: Memory) -> Memory:
    """Memory with the object's present pose, and this arm's q (n,), as what to hold; nothing while q is no number."""
    if not np.isfinite(q).all():
        return memory._replace(hold=None, q_hold=None)
    k = agent.model.evaluate(q, np.zeros_like(q))
    return memory._replace(hold=(*k.p_object, *k.quat_object), q_hold=q)


def hold_after(agent: Agent, outcome: Outcome) -> Memory:
    """Memory after `outcome` with what to hold from then on.

    An arm that aligns itself with the others holds the pose that it was following, and goes on pulling as it did; it
    braces itself against being carried on along the motion, if its cell says so (agent.control.brace).  Any
    other holds the object where it is, and so does every arm where the object is far from that pose, where the arm
    nears a singular one, and where the law gave nothing.
    """
    terms = outcome.terms
    if agent.alignment is None or terms is None or Flag.SINGULAR in outcome.flags or _far(terms.errors):
        return hold_here(agent, outcome.q, outcome.memory)
    pose, braced = (*terms.desired.p, *terms.desired.quat), begun(terms.desired.v, terms.errors.e_p)
    return outcome.memory._replace(hold=pose, q_hold=outcome.q, braced=braced)


def _far(errors: Errors) -> bool:
    angle = attitude_angle(errors.e_eta, errors.e_eps)
    return not (math.hypot(*errors.e_p) <= HOLD_DESIRED_MAX_M and angle <= HOLD_DESIRED_MAX_RAD)


def wait_here(agent: Agent, q: Vector, memory: Memory, mode: Mode = Mode.READY) -> Memory:
    """Memory for standing at q (n,): in READY the object's pose that this arm sees there becomes its start pose."""
    memory = hold_here(agent, q, memory)
    if mode is not Mode.READY or agent.alignment is None or agent.start is None or memory.hold is None:
        return memory
    pose = memory.hold
    return memory._replace(shift=between(pose[:3], pose[3:], *agent.start))  # type: ignore[arg-type]


def afresh(memory: Memory, marks: Flag) -> Memory:
    """Memory of an arm that holds where it will be seen next: after a GAP; RESUMED: it has no torque, and is gentle."""
    if Flag.RESUMED in marks:
        zero = 0.0 * memory.tau
        memory = memory._replace(tau=zero, tau_before=zero, calm=JOINTS + GENTLE_TICKS + 1)
    return memory._replace(primed=False, hold=None, q_hold=None, braced=NOT_BRACED) if marks else memory
