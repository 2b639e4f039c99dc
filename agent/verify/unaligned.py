"""Whether arms that do not align themselves hold as the motion begins, by what each sees the object off at the start.

While READY an arm without alignment holds the pose that it sees, and as the motion begins its reference jumps to where
the cell has the object: a blow to it, and to it alone (agent.verify.noticing), of the errors of `[tolerance]`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.config.cell import Cell, ConfigError
from agent.config.schema.driver import DriverKind
from agent.control.errors import HALF_ANGLE
from agent.control.inverse import SingularJacobian
from agent.control.models import ArmModel, Matrix
from agent.verify.disagreement import seen_off
from agent.verify.finding import Finding, Verdict, judged
from agent.verify.noticing import blow, blow_limits
from drivers.interface import Vector


def unaligned(cell: Cell, models: Sequence[ArmModel], q_start: Sequence[Vector]) -> list[Finding]:
    """One finding; nothing of arms that align themselves, that notice nothing, or that grip the object in a session.

    models, q_start (n,): one for each arm.  Arms of a session grip where each sees its grasp, so their errors are none
    before the motion; a simulated cell begins with the object in its grippers.
    """
    file = cell.file
    servos = file.driver is DriverKind.DYNAMIXEL
    if file.controller.alignment.enabled or not file.safety.noticing.enabled or (servos and file.session is not None):
        return []
    try:
        most_N, surely_N, most_Nm = blow_limits(cell)
        force, moment = blow_at_start(cell, models, q_start)
    except (SingularJacobian, ConfigError):  # other findings refuse the cell
        return []
    holds, perhaps = (force <= x and moment <= most_Nm for x in (most_N, surely_N))
    part = min(bound / size if size else math.inf for bound, size in ((most_N, force), (most_Nm, moment)))
    return [
        judged(
            "what the begin of the motion looks like at the stated tolerance", "cell",
            f"{force:.2g} N, {moment:.2g} N·m at once (quadratic sum)", f"≤ {most_N:g} N, {most_Nm:g} N·m",
            holds=holds, otherwise=Verdict.REFUSED if servos and not perhaps else Verdict.WARNING,
            remedy="arms that see the object elsewhere hold as the motion begins: let them align themselves "
            f"(controller.alignment.enabled), calibrate bases, grasps and zeros to {part:.1%} of what [tolerance] "
            "states and say so there, or switch off what they hold for (safety.noticing.enabled)",
        )
    ]  # fmt: skip


def blow_at_start(cell: Cell, models: Sequence[ArmModel], q_start: Sequence[Vector]) -> tuple[float, float]:
    """Force (N) and moment (N·m) to the arm that feels most of it, quadratic sum of all errors, each at its bound.

    Raises SingularJacobian.
    """
    sizes = []
    for arm, model, q in zip(cell.arms, models, q_start, strict=True):
        P = model.task_basis
        error: Matrix = np.array([HALF_ANGLE]).T * (P.T @ seen_off(cell, arm, model, q, P, np.zeros(len(P))))
        sizes.append(blow(cell, arm, model, q, np.zeros_like(error), error))
    force, moment = np.max(sizes, axis=0).tolist()
    return force, moment
