"""One tick of one arm as a function of its own state, the time, offline data and its memory, bit for bit.

`agent.runner` calls it once a cycle.  Nothing here opens anything, knows a clock, or learns from another agent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent import floats, phases
from agent.calm import BRAKE, JOINTS, LAW, brake_per_s, braking, felt, kept, slowed
from agent.control import adaptive, cause, joint_hold, known
from agent.control.adaptation import Estimate
from agent.control.alignment import NO_SHIFT, Alignment, Shift, shifted
from agent.control.brace import NOT_BRACED, Brace, braced_with
from agent.control.errors import Errors, attitude_angle
from agent.control.estimator import Observer
from agent.control.floating import Floating
from agent.control.friction_factor import FrictionFactor
from agent.control.inverse import SingularJacobian
from agent.control.law import Offline
from agent.control.memory import Memory, initial
from agent.control.models import ArmModel
from agent.control.quaternion import Quat, Vec3
from agent.control.residual import Residual, Sense, nothing_sensed
from agent.control.terms import CMD, DDQ_REF, Terms
from agent.control.trajectory import Desired, Trajectory, at_rest
from agent.missed import MANY, caught_up, in_time, periods
from agent.modes import FLOATING, Mode
from agent.safety import Flag, Limits, limit
from drivers.interface import JointState, Vector

SINGULAR_MARGIN = 1.5  # a stop for singularity holds where the law is not called again at once
RETURN_RAD = 0.04  # a hold that has braked goes back no farther, so that it does not become fast again
GENTLE_RAD_PER_S = 5.0  # how stiff it is until then; less where 30 periods are longer than a second
GENTLE_REACH_RAD = 0.1  # beyond it a gentle hold pulls no harder, which bounds how fast it comes back
_TRACK, _HOLD, _READY = Mode.TRACK, Mode.HOLD, Mode.READY  # looking them up in their class takes 0.1 µs each
_NOT_FINITE = int(Flag.NOT_FINITE)  # asking a flag for another one takes 0.5 µs
_ALIGNING = (_READY, _TRACK)  # the shift changes while the arm waits for the motion or follows it


@dataclass(frozen=True, slots=True)
class Agent:
    """Everything that determines one arm's torque, apart from its own state, the time and its memory.

    Raises ValueError when there are not as many limits as joints.
    """

    name: str
    model: ArmModel
    offline: Offline
    trajectory: Trajectory
    limits: Limits
    observer: Observer | None  # None: the servos' own values are used as they are
    sigma_min: float  # stop below this smallest singular value
    period_s: float
    error_max_m: float = math.inf  # while tracking: beyond it something outside this arm is wrong
    error_max_rad: float = math.inf
    hold_rate_rad_per_s: float = 10.0  # of a hold in joint space (agent.control.joint_hold)
    start: tuple[Vec3, Quat] | None = None  # where the cell says that the object is before the start
    alignment: Alignment | None = None  # None: READY holds what this arm sees, TRACK follows the common motion
    residual: Residual | None = None  # None: nothing is sensed through the object
    friction_factor: FrictionFactor | None = None  # None: friction is what the file says, or the adaptive law's
    brace: Brace | None = None  # None: a hold that is carried on does not pull back
    damp_above_rad_per_s: float = math.inf  # a joint faster than this in HOLD is braked
    session: phases.Session | None = None  # None: the arm begins with the object in its gripper
    floating: Floating | None = None  # None: nobody is to guide it by hand

    def __post_init__(self) -> None:
        n, counts = self.model.n, (len(self.limits.tau_max_Nm), len(self.limits.tau_step_max_Nm))
        if counts != (n, n):
            raise ValueError(f"arm {self.name}: {n} joints, but {counts[0]} torque and {counts[1]} torque step bounds")

    def near_singular(self, q: Vector) -> bool:
        """Whether the laws, which divide by the Jacobian, are not to hold the arm at q (n,)."""
        return joint_hold.sigma_min(self.model, q) < SINGULAR_MARGIN * self.sigma_min


class Outcome(NamedTuple):
    """Result of one tick."""

    q: Vector  # what the law used
    dq: Vector
    terms: Terms | None  # None when the law gave nothing
    tau: Vector  # after the limits
    flags: Flag
    memory: Memory
    sensed: tuple[float, ...] | None = None  # the unexpected wrench (6), sizes of its channels (4)


def step(agent: Agent, state: JointState, t: float, mode: Mode, memory: Memory) -> Outcome:
    """Torque of one tick: a function of the arm's own state, the time, offline data and memory, bit for bit.

    state: measured joints; t: time since the trajectory's zero, s; memory: as the last tick left it.
    """
    if mode is not _TRACK:  # which goes by t
        memory = (in_time if mode is _HOLD else caught_up)(agent.period_s, t, memory)
    if agent.observer is None:
        q, dq = state.q, state.dq
    else:
        q, dq = agent.observer.correct(memory, state.q, state.dq)
    if not math.isfinite(q.dot(dq)):  # also where one of two factors is zero
        return _without(agent, mode, q, dq, Flag.NOT_FINITE, memory)
    calm = LAW
    if mode is _HOLD:
        calm = kept(dq, state.dq, memory, agent.limits, agent.damp_above_rad_per_s)
    damped = calm == BRAKE
    if damped and memory.calm != BRAKE:  # a brake needs the speed that there is, not one that was asked for
        q, dq, memory = state.q, state.dq, memory._replace(ddq=0.0 * memory.ddq)
    speed = felt(dq, state.dq) if damped else dq
    if calm == JOINTS and memory.calm == BRAKE and memory.q_hold is not None:
        memory = memory._replace(q_hold=q + (memory.q_hold - q).clip(-RETURN_RAD, RETURN_RAD))
    if agent.floating is not None and mode is Mode.STAND:
        memory = floats.yielding(agent.floating, memory, q)
    try:
        terms, estimate, held = _law(agent, t, mode, memory, q, dq, calm)
    except SingularJacobian:
        return _without(agent, mode, q, dq, Flag.SINGULAR, memory)
    brake = brake_per_s(agent.period_s) if damped else 0.0
    wanted = braking(terms, speed, brake) if damped else terms.joints[CMD]
    session = agent.session
    alone = session if mode in phases.ALONE else None  # its session, of an arm that holds nothing yet or any more
    tau, flags = limit(wanted.tolist(), memory.tau.tolist(), agent.limits if alone is None else alone.limits)
    if calm:
        flags |= Flag.DAMPED if damped else Flag.GENTLE
    if terms.sigma_min < agent.sigma_min:
        flags |= Flag.SINGULAR
    if held:
        flags |= Flag.ADAPTATION_SATURATED
    if mode is _TRACK and _off_track(agent, terms.errors):
        flags |= Flag.OFF_TRACK
    if alone is not None and phases.off(alone.life, mode, memory, q) > alone.life.off_max_rad:
        flags |= Flag.OFF_TRACK
    limited = np.array(tau)
    if int(flags) & _NOT_FINITE:  # the memory keeps finite numbers only
        return Outcome(q, dq, terms, limited, flags, memory._replace(tau=limited, primed=False))
    sense, sensed, shift, settled = memory.sense, None, memory.shift, memory.settled
    if agent.residual is not None:
        since = periods(agent.period_s, t, memory) if mode is _TRACK else 1  # before the start, t jumps to it
        sense, sensed, unexpected = _sense(agent.residual, mode, memory, terms, dq, since)
        if unexpected:
            flags |= Flag.UNEXPECTED
    if agent.alignment is not None and memory.primed and mode in _ALIGNING:
        shift = agent.alignment.advance(shift, settled, terms.errors, agent.period_s, ready=mode is _READY)
    factor = memory.friction_factor
    if agent.friction_factor is not None and mode is _TRACK and sensed is not None:
        factor = agent.friction_factor.advance(factor, sense.residual, terms.tau_friction, dq, agent.period_s)
    if session is not None and mode is _TRACK:
        shift = phases.blended(shift, t, agent.period_s, session.start_blend_s)
    if mode in _ALIGNING:
        settled = shift if mode is _READY else _settled(agent, settled, shift, t)
    braced = NOT_BRACED
    if agent.brace is not None and mode is _HOLD and calm == LAW and terms.J_inv_P is not None:
        braced = agent.brace.advance(memory.braced, terms.errors.e_p)
    # what the torque asks for, as the observer must know
    ddq = slowed(speed, brake, wanted, limited) if damped else terms.joints[DDQ_REF]
    carried = Memory(
        q, dq, ddq, memory.ddq, limited, memory.tau, True, sense, shift, calm,
        memory.hold, t, estimate, memory.q_hold, memory.age + agent.period_s,
        memory.missed if mode is _HOLD else 0, braced, factor, settled,
    )  # fmt: skip
    return Outcome(q, dq, terms, limited, flags, carried, sensed)


def _settled(agent: Agent, settled: Shift, shift: Shift, t: float) -> Shift:
    """What the shift goes back to during the motion; nothing while a session takes away that of the start."""
    if agent.alignment is None:
        return settled
    if agent.session is None:
        return agent.alignment.settle(settled, shift, t)
    since_s = t - agent.session.start_blend_s
    return NO_SHIFT if since_s < 0.0 else agent.alignment.settle(settled, shift, since_s)


def _without(agent: Agent, mode: Mode, q: Vector, dq: Vector, flag: Flag, memory: Memory) -> Outcome:
    """A tick of which the law made nothing: once the last torque, from then on the weight's."""
    if memory.primed:
        return Outcome(q, dq, None, memory.tau, flag, memory._replace(primed=False))
    tau, flags = _weight(agent, mode, memory)
    return Outcome(q, dq, None, tau, flag | flags, memory._replace(tau=tau, tau_before=memory.tau))


def blind(agent: Agent, mode: Mode, memory: Memory) -> Outcome:
    """A tick without a state for too long: weight, and load share where it has one, at the last pose, step by step."""
    nothing = np.full(agent.model.n, np.nan)
    tau, flags = _weight(agent, mode, memory)
    carried = memory._replace(tau=tau, tau_before=memory.tau, primed=False)
    return Outcome(nothing, nothing, None, tau, Flag.STALE | Flag.BLIND | flags, carried)


def _weight(agent: Agent, mode: Mode, memory: Memory) -> tuple[Vector, Flag]:
    """What holds the arm at the last pose it was seen in; one that was never seen has had no torque and gets none."""
    if not memory.q.any() and not memory.tau.any():
        return memory.tau, Flag.NONE
    wanted = joint_hold.weight(agent.model, agent.offline, memory.q, carries=mode not in phases.ALONE)
    tau, flags = limit(wanted.tolist(), memory.tau.tolist(), agent.limits)
    return np.array(tau), flags


def _sense(
    residual: Residual, mode: Mode, memory: Memory, terms: Terms, dq: Vector, since: int
) -> tuple[Sense, tuple[float, ...] | None, bool]:
    """State of the residual after this tick, what the row says of it, and whether it asks for a hold."""
    if terms.J_inv_P is None:
        return nothing_sensed(len(dq)), None, False
    sense = memory.sense if memory.primed else nothing_sensed(len(dq))
    sent = (memory.tau, memory.tau_before)
    if since == MANY and sense.ticks:
        sense = residual.over_a_gap(sense, terms, dq)
    else:
        factor, ready = memory.friction_factor, mode is _READY
        sense = residual.advance(sense, terms, terms.J_inv_P, dq, sent, factor, ready=ready, periods=since)
    wrench = terms.J_inv_P.T.dot(sense.residual)
    found = residual.channels(sense, wrench)
    unexpected = mode is _TRACK and (residual.tripped(found, sense, wrench) or residual.pulled(sense))
    return sense, (*wrench.tolist(), *found), unexpected


def explained(agent: Agent, outcome: Outcome) -> str:
    """What may be behind an unexpected wrench, for a person; nothing where there is none."""
    residual, sensed, terms = agent.residual, outcome.sensed, outcome.terms
    if residual is None or sensed is None or terms is None or Flag.UNEXPECTED not in outcome.flags:
        return ""
    memory = outcome.memory
    return cause.told(residual, memory.sense, sensed, terms, agent.offline.gravity, memory.t)


def _off_track(agent: Agent, errors: Errors) -> bool:
    """Whether the object is so far off that a neighbour, a grasp or somebody in the way must be the reason."""
    angle = attitude_angle(errors.e_eta, errors.e_eps)
    return math.hypot(*errors.e_p) > agent.error_max_m or angle > agent.error_max_rad


def _law(
    agent: Agent, t: float, mode: Mode, memory: Memory, q: Vector, dq: Vector, calm: int
) -> tuple[Terms, Estimate | None, bool]:
    """Terms of this tick's law, the estimate it leaves, and whether a bound held the estimate back."""
    adaptation, estimate, q_hold = agent.offline.adaptation, memory.estimate, memory.q_hold
    if agent.floating is not None and mode in FLOATING:
        return floats.torque(agent.model, agent.offline, agent.floating, mode, memory, q, dq), estimate, False
    life = None if agent.session is None else agent.session.life
    if life is not None and mode in phases.ALONE:
        return phases.alone(agent.model, agent.offline, life, mode, memory, q, dq), estimate, False
    if calm > JOINTS and q_hold is not None:
        rate = min(GENTLE_RAD_PER_S, 1.0 / (30.0 * agent.period_s))
        return joint_hold.torque(agent.model, agent.offline, q, dq, q_hold, rate, GENTLE_REACH_RAD), estimate, False
    if (
        mode is not _TRACK
        and q_hold is not None
        and (calm == JOINTS or agent.near_singular(q_hold) or agent.near_singular(q))
    ):
        return joint_hold.torque(agent.model, agent.offline, q, dq, q_hold, agent.hold_rate_rad_per_s), estimate, False
    part = 1.0 if life is None else phases.handing_over(life, mode, memory)
    if life is not None and part < 1.0:
        law = _of_object(agent, memory, q, dq, _desired(agent, t, mode, memory)) if part > 0.0 else None
        return phases.handed_over(agent.model, agent.offline, life, memory, part, law, q, dq), estimate, False
    desired, offline = _desired(agent, t, mode, memory), agent.offline
    if mode is _HOLD and memory.braced.force_N:
        offline = braced_with(offline, memory.braced, desired.quat)
    if adaptation is None:
        return known.torque(agent.model, offline, q, dq, desired, memory.friction_factor), None, False
    if estimate is None:
        raise TypeError("the adaptive law needs the estimate that its memory began with (initial_memory)")
    terms, gradient = adaptive.torque(agent.model, offline, adaptation, estimate, q, dq, desired)
    if not memory.primed or (mode is not _TRACK and mode is not _READY):
        return terms, estimate, False
    advanced, held = adaptation.advance(estimate, gradient, t - memory.t)
    return terms, advanced, held


def _of_object(agent: Agent, memory: Memory, q: Vector, dq: Vector, desired: Desired) -> Terms:
    """The law of the object, learning nothing."""
    adaptation, estimate = agent.offline.adaptation, memory.estimate
    if adaptation is None or estimate is None:
        return known.torque(agent.model, agent.offline, q, dq, desired, memory.friction_factor)
    return adaptive.torque(agent.model, agent.offline, adaptation, estimate, q, dq, desired)[0]


def initial_memory(agent: Agent) -> Memory:
    """Memory before the agent's first tick."""
    adaptation = agent.offline.adaptation
    return initial(agent.model.n, None if adaptation is None else adaptation.start)


def _desired(agent: Agent, t: float, mode: Mode, memory: Memory) -> Desired:
    if mode is _READY and agent.alignment is not None and agent.start is not None:
        return shifted(at_rest(*agent.start), memory.shift)
    if mode is Mode.LOWER and agent.session is not None:
        life = agent.session.life
        return phases.lowering(life, memory, shifted(at_rest(*life.place), memory.shift))
    if mode is _TRACK or memory.hold is None:
        return shifted(agent.trajectory.at(t), memory.shift)
    return at_rest(memory.hold[:3], memory.hold[3:])  # type: ignore[arg-type]
