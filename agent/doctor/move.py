"""The first motion of an arm that somebody supports: does each joint do what its files say?  `coop doctor --move`.

Before torque the rest pose is compared with the arm file: a joint that is mounted the other way round or with its zero
elsewhere shows there, if it does not rest at zero.  Then each controlled joint gets a torque that rises slowly to a
bound, in one direction and back, until it has moved by MOVED_RAD; all others get none.  A joint that moves by more than
STOP_RAD, whichever it is, ends it all: torque goes off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.control.models import ArmModel
from agent.verify.finding import Finding, Verdict, from_refusal, refused, warning
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.servo.models import SERVOS
from drivers.interface import Clock, Driver, DriverError, JointState, StaleStateError, Vector

MOVED_RAD: Final = 0.012  # eight encoder steps
STOP_RAD: Final = 0.04  # of any joint
RISE_S: Final = 1.5  # of the torque, to its bound
BOUND_OF_STALL: Final = 0.15
SETTLE_S: Final = 0.3  # without torque, after a motion
REST_RAD: Final = 0.35  # from the rest pose
QUARTER_RAD: Final = 0.5 * math.pi
TELLING_RAD: Final = 0.5  # a joint that rests nearer to zero does not tell its direction there
STALE_MAX: Final = 3
FRICTION_TIMES: Final = 3.0
CURRENT_SHARE: Final = 0.3
DIRECTIONS: Final = (("forward", "backward"), ("to the left", "to the right"), ("up", "down"))
REACH_M: Final = 0.05  # less does not show
CLEAR_RAD: Final = 0.1  # of end stops
AT_REST: Final = (
    "Does the arm lie in its rest pose (rest_rad of the cell, else sleep_rad of its arm file), and is nobody's hand "
    "between its links?"
)
LIFTED: Final = (
    "Now hold the arm so that every joint can turn a little both ways and none would sink. Each will move by about "
    "0.01 rad. Is it supported, and is somebody ready to pull the plug?"
)

Ask = Callable[[str], bool]


@dataclass(frozen=True, slots=True)
class Joint:
    """What is expected of one controlled joint."""

    name: str
    ids: tuple[int, ...]
    bound_Nm: float
    friction_Nm: float
    seen: str | None  # what the gripper does when the angle grows; None: too little to be seen


@dataclass(frozen=True, slots=True)
class Motion:
    """What one torque did."""

    moved_rad: float  # with the sign of the angle
    torque_Nm: float  # at which it began to move, or the bound
    measured_Nm: float  # by the current at that moment; NaN where the servo cannot tell


class TooFarError(DriverError):
    """A joint moved farther than a first motion may."""


def map_of(cell: Cell, arm: Arm, port: str) -> ArmMap:
    """The arm's servos with small torques alone, wherever it stands."""
    servos = arm_map(cell, arm, port, np.array(arm.entry.q_near_rad))
    joints = tuple(
        replace(joint, start_rad=None, tau_max_Nm=min(joint.tau_max_Nm, bound_Nm(joint.servo, len(joint.ids))))
        for joint in servos.joints
    )
    return replace(servos, joints=joints)


def bound_Nm(servo: str, count: int) -> float:
    """Largest torque on a joint."""
    return BOUND_OF_STALL * SERVOS[servo].stall_torque_Nm * count


def joints_of(arm: Arm, model: ArmModel, q: Vector) -> list[Joint]:
    """The controlled joints at q (n,)."""
    k, R = model.evaluate(q, np.zeros(model.n)), arm.T_world_base.rotation

    found = []
    for j, servo in enumerate(arm.servos):
        column = k.Jt[j]
        gripper = R.T @ (column[:3] - np.cross(column[3:], np.array(k.p_ee_object)))
        friction = servo.coulomb_Nm.value + (servo.breakaway_Nm.value if servo.breakaway_Nm is not None else 0.0)
        found.append(
            Joint(servo.name, tuple(servo.ids), bound_Nm(servo.servo, len(servo.ids)), friction, _seen(gripper))
        )
    return found


def _seen(gripper: Vector) -> str | None:
    axis = int(np.argmax(np.abs(gripper)))
    if abs(gripper[axis]) < REACH_M:
        return None
    return DIRECTIONS[axis][0 if gripper[axis] > 0.0 else 1]


def judge_rest(arm: str, rest: Mapping[str, float], q: Mapping[str, float]) -> list[Finding]:
    """Where an arm in its rest pose says it is, joint by joint, against its files; no torque is needed."""
    found = []
    for name, angle in q.items():
        if name not in rest:
            continue
        wanted, what = rest[name], f"joint {name}: rest pose"
        said, expected = f"{angle:.2f} rad", f"{wanted:.2f} ± {REST_RAD:g} rad"
        if abs(_turn(angle - wanted)) <= REST_RAD:
            found.append(Finding(what, arm, said, expected))
        elif abs(wanted) > TELLING_RAD and abs(_turn(angle + wanted)) <= REST_RAD:
            found.append(refused(what, arm, f"{said}, the other way round", expected, _reversed(name)))
        elif abs(abs(_turn(angle - wanted)) - QUARTER_RAD) <= REST_RAD:
            remedy = f"its horn sits a quarter turn off: mount it anew, or correct zero_tick of joint {name}"
            found.append(refused(what, arm, f"{said}, a quarter turn off", expected, remedy))
        else:
            remedy = f"lay the arm into its rest pose; if it is there, correct zero_tick of joint {name}"
            found.append(refused(what, arm, said, expected, remedy))
    return found


def _turn(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)


def _reversed(name: str) -> str:
    return f"correct `reverse` of joint {name} in the arm file, then `coop motors setup` on its servos one by one"


def judge(arm: str, joint: Joint, up: Motion, down: Motion, ask: Ask) -> list[Finding]:
    """What the motions with rising and falling angle say of a joint; ask: a person who looks at the gripper."""
    what = f"joint {joint.name}: motion"
    servos = "servo " + ", ".join(map(str, joint.ids))
    said = f"{up.moved_rad:+.3f} rad at {up.torque_Nm:+.2f} N·m, {down.moved_rad:+.3f} at {down.torque_Nm:+.2f}"
    wanted = "with the torque, both ways"
    if up.moved_rad <= -0.5 * MOVED_RAD or down.moved_rad >= 0.5 * MOVED_RAD:
        remedy = f"{servos}: encoder and motor disagree about the sign, which no key mends: exchange the servo"
        if len(joint.ids) > 1:
            remedy = f"{servos}: look at `reverse` of joint {joint.name}; if that is right, exchange the servo"
        return [refused(what, arm, said + ", against its torque", wanted, remedy)]
    if up.moved_rad < 0.5 * MOVED_RAD or down.moved_rad > -0.5 * MOVED_RAD:
        remedy = f"{servos}: is the joint free? Supply and cable; torque_constant_Nm_per_A of joint {joint.name}"
        if len(joint.ids) > 1:
            remedy = (
                f"{servos} work against each other: `reverse` and `ids` of joint {joint.name}, else one servo is bad"
            )
        return [refused(what, arm, said + ", no motion", wanted, remedy)]
    found = [Finding(what, arm, said, wanted)]
    if joint.seen is not None and not ask(f"Joint {joint.name}: did the gripper move {joint.seen} first?"):
        return [refused(what, arm, "the other way, by the person", f"{joint.seen} first", _reversed(joint.name))]
    return [*found, *_plausible(arm, joint, up, down)]


def _plausible(arm: str, joint: Joint, up: Motion, down: Motion) -> list[Finding]:
    breaking = 0.5 * (up.torque_Nm - down.torque_Nm)  # weight leaves the mean
    most = FRICTION_TIMES * joint.friction_Nm
    what, said, wanted = f"joint {joint.name}: friction", f"{breaking:.2f} N·m", f"at most {most:.2f} N·m"
    remedy = f"is the arm supported, the joint free? Else coulomb_Nm of joint {joint.name}: `coop identify`"
    found = [Finding(what, arm, said, wanted) if breaking <= most else warning(what, arm, said, wanted, remedy)]
    sent, felt = abs(up.torque_Nm) + abs(down.torque_Nm), abs(up.measured_Nm - down.measured_Nm)
    if math.isnan(felt):
        return found
    what, said, wanted = f"joint {joint.name}: current", f"{felt:.2f} N·m", f"{sent:.2f} N·m ± {CURRENT_SHARE:.0%}"
    remedy = (
        f"the current does not follow its goal: supply, cable, Current Limit; torque_constant_Nm_per_A of {joint.name}"
    )
    good = abs(felt - sent) <= CURRENT_SHARE * sent
    return [*found, Finding(what, arm, said, wanted) if good else warning(what, arm, said, wanted, remedy)]


def move(arm: str, joints: Sequence[Joint], driver: Driver, clock: Clock, period_ns: int, ask: Ask) -> list[Finding]:
    """Move each joint of a connected driver a little; torque is off at the end, whatever happens.

    The first joint that is wrong is the last that moves.
    """
    found: list[Finding] = []
    try:
        driver.enable()
        for j, joint in enumerate(joints):
            up, down = (_push(driver, clock, period_ns, j, sign * joint.bound_Nm, joint) for sign in (1.0, -1.0))
            driver.write(np.zeros(len(joints)))
            found += judge(arm, joint, up, down, _alive(ask, driver))
            if any(f.verdict is Verdict.REFUSED for f in found):
                break
            driver.enable()
    except DriverError as error:
        found.append(from_refusal(error, arm))
    finally:
        driver.disable()
    return found


def _alive(ask: Ask, driver: Driver) -> Ask:
    """Ask with torque off: a person takes time, and servos that hear nothing stop by themselves."""

    def asked(text: str) -> bool:
        driver.disable()
        return ask(text)

    return asked


def _push(driver: Driver, clock: Clock, period_ns: int, j: int, bound: float, joint: Joint) -> Motion:
    """Raise the torque on joint j until it moves or the bound is reached, then let it come to rest."""
    first = _read(driver)
    tau, begin_ns, due_ns = np.zeros(len(first.q)), clock.now_ns(), clock.now_ns()
    reached, measured = bound, math.nan
    while clock.now_ns() - begin_ns < 1e9 * RISE_S:
        due_ns = _wait(clock, due_ns, period_ns)
        state = _read(driver)
        _refuse_far(first, state, joint)
        if abs(state.q[j] - first.q[j]) >= MOVED_RAD:
            break
        tau[j] = bound * min(1.0, (clock.now_ns() - begin_ns) * 1e-9 / RISE_S)
        tau[j] = reached = float(driver.write(tau)[j])
        measured = float(state.tau[j])
    end = _read(driver)
    moved, begin_ns = float(end.q[j] - first.q[j]), clock.now_ns()
    while clock.now_ns() - begin_ns < 1e9 * SETTLE_S:
        driver.write(0.0 * tau)
        due_ns = _wait(clock, due_ns, period_ns)
        _refuse_far(first, _read(driver), joint)
    return Motion(moved, reached, measured)


def _wait(clock: Clock, due_ns: int, period_ns: int) -> int:
    due_ns = max(due_ns + period_ns, clock.now_ns())
    clock.sleep_until(due_ns)
    return due_ns


def _read(driver: Driver) -> JointState:
    """A fresh state; a few that are missing are waited for.  Raises DriverError."""
    for _ in range(STALE_MAX):
        try:
            return driver.read()
        except StaleStateError:
            continue
    return driver.read()


def _refuse_far(first: JointState, state: JointState, joint: Joint) -> None:
    away = float(np.abs(state.q - first.q).max())
    if away > STOP_RAD:
        raise TooFarError(
            f"motion while joint {joint.name} was tried", found=f"{away:.3f} rad of a joint",
            expected=f"at most {STOP_RAD:g} rad", remedy="support the arm so that no joint sinks, and try again",
        )  # fmt: skip


def first_motion(cell: Cell, arm: Arm, driver: Driver, clock: Clock, ask: Ask) -> list[Finding]:
    """Connect, judge the rest pose, and move each joint when a person has lifted the arm; the driver is then closed."""
    try:
        driver.connect()
        if not ask(AT_REST):
            return [_not_tried(arm.name)]
        q = _read(driver).q
        found = judge_rest(arm.name, arm.rest_rad, dict(zip(arm.entry.controlled, q.tolist(), strict=True)))
        if any(f.verdict is Verdict.REFUSED for f in found):
            return found
        if not ask(LIFTED):
            return [*found, _not_tried(arm.name)]
        q, model = _read(driver).q, cell.model(arm)
        found += judge_clear(arm, model, q)
        if any(f.verdict is Verdict.REFUSED for f in found):
            return found
        return found + move(arm.name, joints_of(arm, model, q), driver, clock, cell.period_ns, ask)
    except DriverError as error:
        return [from_refusal(error, arm.name)]
    finally:
        driver.close()


def judge_clear(arm: Arm, model: ArmModel, q: Vector) -> list[Finding]:
    """Joints at q (n,) that have no room to both sides."""
    low, high = model.model.lowerPositionLimit, model.model.upperPositionLimit
    return [
        refused(
            f"joint {name}: room", arm.name, f"{angle:.2f} rad", f"{a + CLEAR_RAD:.2f} to {b - CLEAR_RAD:.2f} rad",
            "hold the arm so that it is farther from its end stops",
        )
        for name, angle, a, b in zip(arm.entry.controlled, q.tolist(), low.tolist(), high.tolist(), strict=True)
        if not a + CLEAR_RAD <= angle <= b - CLEAR_RAD
    ]  # fmt: skip


def _not_tried(arm: str) -> Finding:
    return warning("first motion", arm, "not tried", "a person's yes", "when the arm can be held, try again")
