"""What the grasps of a cell must carry beside the load: within the grip, and in the plane of a planar cell."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.config.cell import Cell
from agent.control.internal_force import internal_wrenches
from agent.control.models import ArmModel
from agent.verify.finding import Finding, Verdict, judged

OUT_OF_TASK = 1e-9  # part of a wrench


def internal_force(cell: Cell, models: Sequence[ArmModel]) -> list[Finding]:
    """Findings on the configured internal wrenches; none where none is wanted."""
    findings = []
    for arm, model, wrench in zip(cell.arms, models, internal_wrenches(*cell.internal_wrenches_desired()), strict=True):
        if not any(wrench):
            continue
        force, grip = math.hypot(*wrench[:3]), arm.entry.grip_force_max_N
        findings.append(
            judged(
                "internal force on the grasp", arm.name, f"{force:.3g} N",
                f"≤ {grip:g} N" if grip is not None else "grip_force_max_N not given",
                holds=grip is None or force <= grip, remedy="ask for a smaller internal_wrench_N_Nm, or grip harder",
            )
        )  # fmt: skip
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
