"""Time of a control tick: the law alone against the rigid-body terms it cannot do without, and a whole tick."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

import configs
from agent.control import known
from agent.control.errors import Gains
from agent.control.friction import Friction, JointFriction
from agent.control.internal_force import agent_wrench
from agent.control.law import Offline
from agent.control.models import ArmModel
from agent.control.trajectory import Sinusoid
from agent.loop import Agent, initial_memory, step
from agent.modes import Mode
from agent.safety import Limits
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import BusCounters, JointState
from tests.bench.common import Figure, median_us

NAMES = ("control_step_known_planar", "control_step_known_6dof", "control_step_known_6dof_of_8", "tick_known_6dof")

# half a millisecond per round: far shorter than a time slice, so that most rounds are not interrupted
CALLS, BASELINE_CALLS, REPEATS = 15, 150, 201
PERIOD = 0.005
PLANAR = ("wx200", ("shoulder", "elbow", "wrist_angle"), {"waist": 0.0, "wrist_rotate": 0.0})
SIX = ("wx250s", ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"), {})


def bench() -> dict[str, Figure]:
    planar, six = make_agent(*PLANAR), make_agent(*SIX)
    return {
        "control_step_known_planar": law_figure(planar),
        "control_step_known_6dof": law_figure(six),
        "control_step_known_6dof_of_8": paired(law_of(one_of(six, 8)), law_of(one_of(six, 2)), CALLS),
        "tick_known_6dof": paired(tick_of(six), rigid_body_terms_of(six)),
    }


def make_agent(name: str, controlled: tuple[str, ...], locked: dict[str, float]) -> Agent:
    """One arm of a cell with every term of the law in use."""
    n, gravity = len(controlled), (0.0, 0.0, -9.81)
    model = ArmModel(
        (configs.ARMS_DIR / f"{name}.urdf").read_text(encoding="utf-8"),
        controlled,
        locked,
        pin.SE3.Identity(),
        "ee",
        pin.SE3(np.eye(3), np.array([-0.04, 0.01, 0.02])),
        np.full(n, 0.012),
        np.array(gravity),
    )
    k_p, k_eps = (150.0, 150.0, 150.0), (100.0, 100.0, 100.0)
    k = model.evaluate(joints(n), np.zeros(n))
    axis = (0.0, 1.0, 0.0)
    return Agent(
        name=name,
        model=model,
        offline=Offline(
            gains=Gains(k_p, k_eps, k_p, k_eps, (2.5,) * 6),
            load_share=0.5,
            object_mass_kg=0.062,
            object_inertia=(2e-5, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4),
            gravity=gravity,
            friction=Friction((JointFriction(0.08, 0.03),) * n, 0.05),
            internal_wrench=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        ),
        trajectory=Sinusoid(k.p_object, (0.0, 0.0, 0.05), k.quat_object, axis, 0.1, 15.0),
        limits=Limits((4.0,) * n, (2.0,) * n),
        observer=None,
        sigma_min=0.001,
        period_s=PERIOD,
    )


def one_of(agent: Agent, count: int) -> Agent:
    """The same arm in a cell of `count`: what it knows of the others is its share and its internal wrench."""
    grasps = [(0.1 * np.cos(a), 0.1 * np.sin(a), 0.0) for a in np.linspace(0.0, 2 * np.pi, count, endpoint=False)]
    squeeze = [(-10.0 * x, -10.0 * y, 0.0, 0.0, 0.0, 0.0) for x, y, _ in grasps]
    offline = replace(agent.offline, load_share=1.0 / count, internal_wrench=agent_wrench(0, grasps, squeeze))
    return replace(agent, offline=offline)


def law_of(agent: Agent) -> Callable[[], object]:
    """The law of one agent at one instant."""
    q, dq, desired = joints(agent.model.n), 0.1 * joints(agent.model.n), agent.trajectory.at(1.0)
    return lambda: known.torque(agent.model, agent.offline, q, dq, desired)


def joints(n: int) -> np.ndarray:
    return np.array([0.1, -0.4, 0.5, 0.2, 0.7, 0.3][:n])


def law_figure(agent: Agent) -> Figure:
    """The law at one instant; baseline: the pinocchio calls whose results it needs."""
    return paired(law_of(agent), rigid_body_terms_of(agent))


def rigid_body_terms_of(agent: Agent) -> Callable[[], None]:
    """The bare pinocchio calls of a control step, in the simplest form that gives all its terms."""
    model, data, frame = agent.model.model, agent.model.model.createData(), agent.model.object_id
    q, dq = joints(agent.model.n), 0.1 * joints(agent.model.n)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def rigid_body_terms() -> None:
        pin.computeJointJacobiansTimeVariation(model, data, q, dq)
        pin.getFrameJacobian(model, data, frame, axes)
        pin.getFrameJacobianTimeVariation(model, data, frame, axes)
        pin.crba(model, data, q)
        pin.computeGeneralizedGravity(model, data, q)
        pin.computeCoriolisMatrix(model, data, q, dq)

    return rigid_body_terms


def paired(value: Callable[[], object], baseline: Callable[[], object], baseline_calls: int = BASELINE_CALLS) -> Figure:
    """Medians of short rounds taken in turn, so that a busy machine slows both alike."""
    rounds = [(median_us(value, CALLS, 1), median_us(baseline, baseline_calls, 1)) for _ in range(REPEATS)]
    return Figure(
        statistics.median(a for a, _ in rounds),
        "µs",
        statistics.median(b for _, b in rounds),
        statistics.median(a / b for a, b in rounds),
    )


def tick_of(agent: Agent) -> Callable[[], None]:
    """From the joint state to the limited torque and the filled log row, as `agent.runner` has them."""
    n = agent.model.n
    row = AgentRow(np.zeros(1, dtype=AGENT_STATE.dtype), n, 0)
    state = JointState(200_000_000, joints(n), 0.1 * joints(n), np.zeros(n))
    memory, bus = initial_memory(agent), BusCounters()

    def tick() -> None:
        outcome = step(agent, state, 0.2, Mode.TRACK, memory)
        row.fill(1, 0.2, 1, Mode.TRACK, state, memory, outcome, outcome.tau)
        row.fill_timing(0.0, 0.0, 0.0, 0.0, bus)

    return tick
