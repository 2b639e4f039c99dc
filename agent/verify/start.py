"""How often arms that align themselves are refused their start, for what they see the object off by at the tolerance.

Realities are drawn as `coop study` draws them; of each the place and the turn that every arm sees the object off by at
the start follow from base, grasp and zeros (the forms of agent.verify.disagreement.seen_off, to first order).  The
monitor `start` holds an arm whose shift is beyond `safety.start_error_max_m` or `start_error_max_rad`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Arm, Cell
from agent.config.reality import drawn_arms
from agent.config.schema.reality import ArmReality
from agent.control.models import ArmModel, Matrix
from agent.verify.finding import Finding, Verdict, judged
from drivers.interface import Vector

DRAWS: Final = 800  # of which 1 in 100 are eight
REFUSED_MOST: Final = 0.01  # of starts


def start(cell: Cell, models: Sequence[ArmModel], q: Sequence[Vector]) -> Finding:
    """Whether arms as far off as the cell states are let go from their start; q[i] (n,): angles of arm i there."""
    safety, off = cell.file.safety, start_off(cell, models, q).max(axis=1)
    most = np.array([safety.start_error_max_m, safety.start_error_max_rad])
    refused = float((off > most).any(axis=1).mean())
    usual_m, usual_rad = np.quantile(off, 1.0 - REFUSED_MOST, axis=0).tolist()
    return judged(
        "start at the stated tolerance", "cell",
        f"{usual_m * 1e3:.2g} mm, {usual_rad * 1e3:.2g} mrad in 99 of 100 realities; {refused:.1%} of starts refused",
        f"≤ {most[0] * 1e3:g} mm, {most[1] * 1e3:g} mrad; at most {REFUSED_MOST:.0%} refused",
        holds=refused <= REFUSED_MOST, otherwise=Verdict.WARNING,
        remedy="an arm may hold before the start; calibrate better and say so in [tolerance], or raise "
        "safety.start_error_max_m and start_error_max_rad",
    )  # fmt: skip


def start_off(cell: Cell, models: Sequence[ArmModel], q: Sequence[Vector]) -> NDArray[np.float64]:
    """(DRAWS, arms, 2) how far from its place each arm sees the object, m, rad; the same for the same cell."""
    each = zip(cell.arms, models, q, strict=True)
    seen = [_seen(arm, model, q_i, cell.T_world_object_start.rotation) for arm, model, q_i in each]
    found = np.empty((DRAWS, len(seen), 2))
    for k, reality in enumerate(drawn_arms(cell.tolerance, range(DRAWS), cell)):
        for i, (columns, real) in enumerate(zip(seen, reality, strict=True)):
            off = columns @ _errors(real)
            found[k, i] = np.linalg.norm(off[:3]), np.linalg.norm(off[3:])
    return found


def _errors(real: ArmReality) -> Vector:
    """(12 + n,) in the order of `_seen`."""
    return np.array([*real.base_m, *real.base_rad, *real.grasp_m, *real.grasp_rad, *real.zeros_rad])


def _seen(arm: Arm, model: ArmModel, q: Vector, R: Matrix) -> Matrix:
    """(6, 12 + n) how far off a unit of each error makes the object look, task rows alone; R: the object's attitude."""
    k, P = model.evaluate(q, np.zeros(model.n)), model.task_basis
    base = _turned(np.array(k.p_object) - arm.T_world_base.translation)
    grasp = _turned(np.array(k.p_ee_object))
    shift = np.eye(6)[:, :3]
    found: Matrix = P.T @ np.column_stack([P @ np.column_stack([-shift, -base, shift @ R, grasp @ R]), k.J])
    return found


def _turned(lever: Vector) -> Matrix:
    """(6, 3) twist of a point at the end of this lever, per turn about its other end."""
    x, y, z = lever
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0], *np.eye(3)])
