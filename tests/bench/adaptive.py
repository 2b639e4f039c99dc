"""Time of an adaptive tick: law, adaptation and projection; and of the trajectory that costs most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agent.control import adaptive, known
from agent.control.adaptation import Adaptation, Estimate
from agent.control.quaternion import from_axis_angle
from agent.control.regressor import arm_parameters, object_parameters
from agent.control.trajectory_spline import PoseSpline
from agent.loop import Agent
from tests.bench.common import Figure, median_us
from tests.bench.control import CALLS, PERIOD, PLANAR, REPEATS, SIX, joints, make_agent, paired

NAMES = (
    "control_step_adaptive_planar",
    "control_step_adaptive_6dof",
    "control_step_adaptive_6dof_unphysical",
    "trajectory_spline_at",
)


def bench() -> dict[str, Figure]:
    planar, six = adaptive_agent(*PLANAR), adaptive_agent(*SIX)
    return {
        "control_step_adaptive_planar": step_figure(planar),
        "control_step_adaptive_6dof": step_figure(six),
        "control_step_adaptive_6dof_unphysical": step_figure(unphysical(six)),
        "trajectory_spline_at": Figure(median_us(lambda: SPLINE.at(3.3), 10 * CALLS, REPEATS), "µs"),
    }


SPLINE = PoseSpline(
    [0.0, 2.0, 5.0, 9.0],
    [(0.0, 0.0, 0.2), (0.03, 0.02, 0.22), (0.0, 0.03, 0.24), (0.0, 0.0, 0.2)],
    [from_axis_angle((0.0, 0.6, 0.8), angle) for angle in (0.0, 0.1, -0.1, 0.0)],
)


def adaptive_agent(name: str, controlled: tuple[str, ...], locked: dict[str, float]) -> Agent:
    """The arm of the other control benchmarks with every column of the regressor in use and every bound checked."""
    agent = make_agent(name, controlled, locked)
    n, inertia = agent.model.n, np.array(agent.offline.object_inertia).reshape(3, 3)
    joint_parameters = [np.full(n, 0.012), np.full(n, 0.03), np.full(n, 0.08), np.zeros(3 * n)]
    nominal = Estimate(
        np.concatenate([arm_parameters(agent.model), *joint_parameters]),
        object_parameters(agent.offline.object_mass_kg, inertia),
    )
    far = Estimate(np.full(16 * n, 10.0), np.full(10, 10.0))
    adaptation = Adaptation(
        start=Estimate(0.9 * nominal.arm, 0.9 * nominal.object),
        nominal=nominal,
        lower=Estimate(-far.arm, -far.object),
        upper=far,
        gain=Estimate(np.full(16 * n, 1e-6), np.full(10, 1e-6)),
        smooth_rad_per_s=0.05,
        friction=True,
        physical=True,
        period_s=PERIOD,
    )
    return replace(agent, offline=replace(agent.offline, adaptation=adaptation))


def unphysical(agent: Agent) -> Agent:
    """Every body's inertia has to be projected on every tick: the longest way through."""
    adaptation = agent.offline.adaptation
    assert adaptation is not None
    start = Estimate(adaptation.start.arm.copy(), adaptation.start.object.copy())
    for first in range(0, 10 * agent.model.n, 10):
        start.arm[first + 4] = -1.0
    start.object[4] = -1.0
    return replace(agent, offline=replace(agent.offline, adaptation=replace(adaptation, start=start)))


def step_figure(agent: Agent) -> Figure:
    """Law and adaptation at one instant; baseline: the non-adaptive law of the same arm at the same instant."""
    q, dq = joints(agent.model.n), 0.1 * joints(agent.model.n)
    desired, offline, adaptation = agent.trajectory.at(1.0), agent.offline, agent.offline.adaptation
    assert adaptation is not None
    estimate = adaptation.start

    def step() -> None:
        _, gradient = adaptive.torque(agent.model, offline, adaptation, estimate, q, dq, desired)
        adaptation.advance(estimate, gradient, PERIOD)

    without: Callable[[], None] = lambda: known.torque(agent.model, offline, q, dq, desired)  # noqa: E731
    return paired(step, without, CALLS)
