"""The largest wrench by which adaptive arms can press against each other through what their bounds let them believe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.config.cell import Cell
from agent.control.adaptation_bound import ReferenceTwist, estimated_wrench
from agent.control.internal_force import beside_equal_shares
from agent.control.law import Offline
from agent.control.models import ArmModel, Matrix
from drivers.interface import Vector

DIRECTIONS: Final = 64  # from which the largest vector is looked for
STEPS: Final = 4


def largest_internal_wrench(
    cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]], instants: Sequence[float]
) -> tuple[float, float]:
    """Largest internal force (N) and moment about the object's centre (N·m) of any arm, over the trajectory.

    along[k][i]: joint angles (n,) of arm i at instants[k] (s).  Every estimate of every arm lies anywhere in its box,
    the truth is what is configured, and the reference is the desired motion.  The internal wrench of an arm is its own
    less its load share of the sum of all; what is physical, and the limits of torque, are not counted.
    """
    agents = [cell.offline(a) for a in cell.arms]
    P, trajectory = models[0].task_basis, cell.trajectory()
    shares = [1.0 / len(agents) + beside for beside in beside_equal_shares([a.load_share for a in agents])]
    force = moment = 0.0
    for q, t in zip(along, instants, strict=True):
        desired = trajectory.at(t)
        reference = ReferenceTwist(np.array(desired.v), np.array(desired.a))
        parts = [_part(model, agent, q_i, reference, P) for model, agent, q_i in zip(models, agents, q, strict=True)]
        for i in range(len(parts)):
            counts = [(i == j) - shares[i] for j in range(len(parts))]
            columns = np.hstack([c * A for c, (A, _) in zip(counts, parts, strict=True)])
            low, high = np.hstack([box for _, box in parts])
            force = max(force, largest_norm(columns[:3], low, high))
            moment = max(moment, largest_norm(columns[3:], low, high))
    return force, moment


def largest_norm(columns: Matrix, low: Vector, high: Vector) -> float:
    """Largest ‖columns @ x‖ with low ≤ x ≤ high; columns (3, p).

    A corner of the box that is farthest along a direction is the next direction, which never shortens it; from many
    directions one finds the farthest of all.
    """
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    directions: Matrix = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    for _ in range(STEPS):
        corners = np.where(directions @ columns > 0.0, high, low)
        directions = corners @ columns.T
    return float(np.linalg.norm(directions, axis=1).max())


def _part(model: ArmModel, agent: Offline, q: Vector, reference: ReferenceTwist, P: Matrix) -> tuple[Matrix, Matrix]:
    """Wrench (6, 16 n + 10) of the errors of one arm's estimates, and their box (2, 16 n + 10)."""
    data = agent.adaptation
    if data is None:
        raise TypeError("only an adaptive agent has estimates")
    nominal, *bounds = (np.concatenate(x) for x in (data.nominal, data.lower, data.upper))
    return P.T @ np.hstack(estimated_wrench(model, agent, q, reference, P)), np.stack(bounds) - nominal
