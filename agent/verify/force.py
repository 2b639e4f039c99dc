"""What the grasps of a cell must carry beside the load: within the grip, and in the plane of a planar cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.config.cell import Cell
from agent.config.trajectory import sample_times
from agent.control.internal_force import internal_wrenches
from agent.control.models import ArmModel
from agent.control.quaternion import to_matrix
from agent.verify.finding import Finding, Verdict, judged

OUT_OF_TASK: Final = 1e-9  # part of a wrench
STEPS: Final = 48  # along the motion
MEAN_PLANAR_N, MEAN_SPATIAL_N = 1.0, 4.0  # of the internal force of a run, what a cell should live with


def mean_bound_N(cell: Cell) -> float:
    """Internal force that no run should exceed in its mean."""
    return MEAN_PLANAR_N if cell.planar else MEAN_SPATIAL_N


def carried_N(cell: Cell) -> list[float]:
    """The largest force of each grasp along the motion, N: its share of the object and the internal one, as asked."""
    motion, file = cell.trajectory(), cell.file
    found = [0.0] * len(cell.arms)
    asked = [np.array(wrench[:3]) for wrench in internal_wrenches(*cell.internal_wrenches_desired())]
    for t in sample_times(file, motion, STEPS):
        desired = motion.at(t)
        R = np.reshape(to_matrix(desired.quat), (3, 3))
        weight = file.object.mass_kg * (np.array(desired.a[:3]) - cell.gravity)
        each = zip(cell.arms, asked, found, strict=True)
        found = [max(most, float(np.linalg.norm(a.entry.load_share * weight + R @ f))) for a, f, most in each]
    return found


def spare_N(cell: Cell, most_N: float) -> list[float]:
    """What every grip may bear beside what it carries, N: at most so much, and all of it where no grip is stated."""
    grips = (arm.entry.grip_force_max_N for arm in cell.arms)
    each = zip(grips, carried_N(cell), strict=True)
    return [most_N if grip is None else min(most_N, max(0.0, grip - carried)) for grip, carried in each]


def internal_force(cell: Cell, models: Sequence[ArmModel]) -> list[Finding]:
    """Findings on the configured internal wrenches, and on what a grasp carries whose grip is stated."""
    findings = []
    wanted, carried = internal_wrenches(*cell.internal_wrenches_desired()), carried_N(cell)
    for arm, model, wrench, most_N in zip(cell.arms, models, wanted, carried, strict=True):
        grip = arm.entry.grip_force_max_N
        if grip is not None:
            findings.append(
                judged(
                    "force on the grasp, object and internal", arm.name, f"{most_N:.3g} N", f"≤ {grip:g} N",
                    holds=most_N <= grip,
                    remedy="a lighter object or a smaller load_share, a smaller internal_wrench_N_Nm, or grip harder",
                )
            )  # fmt: skip
        if not any(wrench):
            continue
        force, moment = math.hypot(*wrench[:3]), math.hypot(*wrench[3:])
        limit = "" if grip is not None else "grip_force_max_N not given"
        findings.append(Finding("internal wrench on the grasp", arm.name, f"{force:.3g} N, {moment:.3g} N·m", limit))
        R = cell.T_world_object_start.rotation
        world = np.concatenate([R @ wrench[:3], R @ wrench[3:]])
        lost = float(np.linalg.norm(world - model.task_basis.T @ (model.task_basis @ world)))
        if lost > OUT_OF_TASK * float(np.linalg.norm(world)):
            findings.append(
                Finding(
                    "internal wrench out of the plane", arm.name, f"{lost:.3g} N and N·m", "0", Verdict.WARNING,
                    "the joints of a planar arm cannot give it; it is not applied",
                )
            )  # fmt: skip
    return findings
