"""The way of each arm between its rest and its grasp, and what its gripper holds the object with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.config.cell import Arm, Cell, ConfigError
from agent.config.session import build_life, fingers, grip_plan, rest_joints
from agent.control import joint_track
from agent.control.life import Life
from agent.verify.finding import Finding, Verdict, judged, warning
from drivers.dynamixel.servo.models import OVERLOAD_SHARE, SERVOS

SAMPLES = 60  # along the path
GRIP_MARGIN = 2.0  # of what friction needs at the least
SHARE_WHILE_GOING = 0.5  # of stall torque
REST_OFF_MAX_RAD = 0.15  # of a joint that is not controlled, between how it rests and where it is locked


def lives(cell: Cell) -> list[Life]:
    """The way of each arm; none for a cell without a session.  Raises ConfigError."""
    return [] if cell.file.session is None else [build_life(cell, arm) for arm in cell.arms]


def not_gripped(cell: Cell) -> list[Finding]:
    """Warnings of the grippers with which the cell would be refused if it had a session."""
    found = []
    for arm in cell.arms:
        try:
            grip_plan(cell, arm)
        except ConfigError as error:
            remedy = f"as it is for simulation alone; for real arms {error.remedy}"
            found.append(warning(error.what, arm.name, str(error.found), str(error.expected), remedy))
    return found


def session(cell: Cell, of_arms: Sequence[Life]) -> list[Finding]:
    """Findings on the session of each arm; of_arms: its `lives`.  Raises ConfigError."""
    each = zip(cell.arms, of_arms, strict=False)  # a cell without a session has none
    return [finding for arm, life in each for finding in _of_arm(cell, arm, life)]


def _of_arm(cell: Cell, arm: Arm, life: Life) -> list[Finding]:
    width_m = grip_plan(cell, arm).width_m
    return [*_along(cell, arm, life), *_locked(arm), _grip(cell, arm, width_m), *_grip_lasts(arm)]


def _along(cell: Cell, arm: Arm, life: Life) -> list[Finding]:
    """Joint limits and torque along the path."""
    model, offline = cell.model(arm), cell.offline(arm)
    lower, upper = model.model.lowerPositionLimit, model.model.upperPositionLimit
    room, load = math.inf, np.zeros(arm.n)
    for s in np.linspace(0.0, life.path.seconds, SAMPLES).tolist():
        wanted = life.path.at(s)
        room = min(room, float(np.minimum(wanted.q - lower, upper - wanted.q).min()))
        terms = joint_track.torque(
            model, offline, wanted.q, wanted.dq, wanted, life.rate_rad_per_s, life.soft_rad
        )  # fmt: skip
        load = np.maximum(load, np.abs(terms.tau_cmd))
    share = load / arm.tau_stall_Nm
    worst = int(share.argmax())
    return [
        judged(
            "distance to joint limits between rest and grasp", arm.name, f"{room:.3f} rad", "≥ 0", holds=room >= 0.0,
            remedy="correct rest_rad, or sleep_rad of the arm file, or take the other elbow solution (q_near_rad)",
        ),
        judged(
            f"torque between rest and grasp, {arm.entry.controlled[worst]}", arm.name,
            f"{load[worst]:.3f} N·m, {share[worst]:.0%} of stall", f"≤ {SHARE_WHILE_GOING:.0%}",
            holds=float(share[worst]) <= SHARE_WHILE_GOING, remedy="lower session.speed_max_rad_per_s",
        ),
        Finding("time between rest and grasp", arm.name, f"{life.path.seconds:.1f} s", ""),
    ]  # fmt: skip


def _locked(arm: Arm) -> list[Finding]:
    """Joints that nobody moves must rest where they are locked."""
    rest_joints(arm)
    rest = arm.rest_rad
    off = {joint: abs(rest[joint] - angle) for joint, angle in arm.entry.locked_rad.items() if joint in rest}
    return [
        judged(
            f"{joint} at rest", arm.name, f"{by:.2f} rad from where it is locked", f"≤ {REST_OFF_MAX_RAD:g} rad",
            holds=by <= REST_OFF_MAX_RAD, remedy="nobody moves this joint: say with rest_rad how the arm rests then",
        )
        for joint, by in off.items()
    ]  # fmt: skip


def _grip(cell: Cell, arm: Arm, width_m: float) -> Finding:
    """What friction holds against this arm's share of the weight."""
    gripper, hand = arm.file.gripper, fingers(arm)
    effort = gripper.grip_effort.value if gripper.grip_effort is not None else 0.0
    finger = effort * SERVOS[gripper.servo].stall_torque_Nm / abs(hand.lever(hand.angle(width_m)))
    weight = arm.entry.load_share * cell.file.object.mass_kg * float(np.linalg.norm(cell.gravity))
    if gripper.pad_friction is None:
        return Finding("grip", arm.name, f"{finger:.1f} N of each finger", "", Verdict.OK)
    holds = 2.0 * gripper.pad_friction.value * finger
    return judged(
        "grip", arm.name, f"{finger:.1f} N of each finger hold {holds:.1f} N by friction",
        f"≥ {GRIP_MARGIN:g} × {weight:.2f} N of load share", holds=holds >= GRIP_MARGIN * weight,
        remedy="raise grip_effort of the arm file as far as its servo bears it, or carry less",
        otherwise=Verdict.WARNING,
    )  # fmt: skip


def _grip_lasts(arm: Arm) -> list[Finding]:
    """A gripper that presses so hard that its servo lets go after seconds."""
    gripper = arm.file.gripper
    effort = 0.0 if gripper is None or gripper.grip_effort is None else gripper.grip_effort.value
    if effort < OVERLOAD_SHARE:
        return []
    remedy = "lower grip_effort of the arm file: the servo calls it an overload after seconds, and lets the object go"
    return [warning("grip for long", arm.name, f"{effort:.0%} of stall", f"below {OVERLOAD_SHARE:.0%}", remedy)]
