"""Whether the estimates of an adaptive cell may adapt as fast as its file says, at its rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.config.cell import Cell
from agent.control.adaptation_bound import GainLimits, Point, ReferenceTwist, believed_inertia, gain_limits
from agent.control.models import ArmModel
from agent.control.stability import coupled_inertia, spectral_radius
from agent.verify.margin import sampled_loop
from agent.verify.path import start_error
from drivers.interface import Vector

MARGIN = 2.0  # between the largest gain that is computed to be stable and the one that is recommended


@dataclass(frozen=True)
class AdaptiveFindings:
    """Recommended largest gains, and the loop before anything has been learnt."""

    gamma_max: float
    gamma_object_max: float
    radius_at_start: float


def examine_adaptation(
    cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]], instants: Sequence[float]
) -> AdaptiveFindings:
    """Limits over the trajectory; along[k][i]: joint angles (n,) of arm i at instants[k] (s)."""
    agents = [cell.offline(a) for a in cell.arms]
    P, obj, trajectory = models[0].task_basis, cell.file.object, cell.trajectory()
    loop = sampled_loop(cell)
    inertia_object = np.array(obj.inertia_kg_m2.matrix())
    points = []
    for q, t in zip(along, instants, strict=True):
        desired = trajectory.at(t)
        R = models[0].object_pose(q[0]).rotation
        M = coupled_inertia(models, q, obj.mass_kg, R @ inertia_object @ R.T)
        points.append(Point(q, M, ReferenceTwist(np.array(desired.v), np.array(desired.a))))
    limits: GainLimits = gain_limits(models, agents, points, start_error(cell), loop)
    radius = max(spectral_radius(p.M, believed_inertia(models, agents, p.q), P, loop) for p in points)
    spec = cell.file.controller.adaptive
    return AdaptiveFindings(spec.gamma * limits.arm / MARGIN, spec.gamma_object * limits.object / MARGIN, radius)
