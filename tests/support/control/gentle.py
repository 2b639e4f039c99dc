"""Random cells nearly at rest, with gains and a motion that an integrator of modest steps follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.control.errors import Gains
from agent.control.quaternion import from_axis_angle, multiply
from agent.control.trajectory import Sinusoid, Trajectory
from tests.support.control import coupled_motion
from tests.support.control.strategies import RandomCell, make_cell, quaternion_of

FASTEST_MODE = 250.0  # 1/s at the start, what Runge–Kutta 4 follows well at 5 ms


def gentle_cell(seed: int, planar: bool, arm_count: int, sign: float = 1.0) -> tuple[RandomCell, Trajectory]:
    return gentle(make_cell(seed, planar, arm_count, scalar_gains=True, sigma_min=0.08), sign)


def gentle(cell: RandomCell, sign: float) -> tuple[RandomCell, Trajectory]:
    """The cell at rest nearly, with gains that the integrator can follow, and a motion within its reach.

    sign: −1 for a desired quaternion that begins at e_η < 0.
    """
    P, T = cell.P, cell.T_world_object
    light = [replace(a, dq=0.1 * a.dq) for a in cell.arms]
    for a in light:
        a.model.model.armature = np.full(a.model.n, 0.003)
    cell = replace(cell, arms=tuple(light), v_object=0.1 * cell.v_object)
    now = coupled_motion.observe(cell, 0.0, coupled_motion.start(cell)).terms
    shape = np.array([1.0, 1.0, 1.0, 0.03, 0.03, 0.03])
    rates = np.linalg.eigvals(np.linalg.solve(now.M, P @ np.diag(shape) @ P.T)).real
    k_v = tuple((FASTEST_MODE / rates.max() / len(light) * shape).tolist())
    k, k_eps = (8.0, 8.0, 8.0), (16.0, 16.0, 16.0)  # e = −e_η e_ε is half the angle: the same speed
    arms = tuple(replace(a, offline=replace(a.offline, gains=Gains(k, k_eps, k, k_eps, k_v))) for a in light)
    axis = tuple((P[2, 3:] if len(P) == 3 else np.array([0.36, 0.48, 0.8])).tolist())
    offset = 0.01 * (P.T @ np.ones(len(P)))[:3]
    quat = multiply(from_axis_angle(axis, 0.3), quaternion_of(T))
    centre = tuple(sign * x for x in quat)
    trajectory = Sinusoid(
        tuple((T.translation + offset).tolist()), tuple((0.5 * offset).tolist()), centre, axis, 0.1, 3.0
    )
    return replace(cell, arms=arms), trajectory
