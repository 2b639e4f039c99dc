"""The loop of the criterion against the running laws, the plant's pads, the coupled map, and steps in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from agent.config.cell import Cell
from agent.control import ik, known
from agent.control.estimator import Observer
from agent.control.models import Matrix
from agent.control.stability import SampledLoop, coupled_inertia, spectral_radius
from agent.control.trajectory import Desired
from agent.process.simulated import plant_spec
from agent.verify.check import start_configurations
from agent.verify.criterion import bodies
from agent.verify.criterion.bodies import Motion, Pose, Springs, Truth
from agent.verify.criterion.cases import Aligning, Case, Demand, Loop
from agent.verify.criterion.examine import rank
from agent.verify.criterion.judge import Judge
from agent.verify.criterion.loop import Laws, Shifting, laws, one_period, radii
from drivers import pads
from drivers.interface import Vector
from sim_backend.physics.free_arm import FreeArms
from tests.support.control.criterion_cells import cell_of, first, gentle, loop_of, ranges_of, start_pose
from tests.support.few import long

CELLS = ("paper", "two_models", "three_wx250s")
REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_WEIGHT = ("world.gravity_m_per_s2=[0.0, 0.0, 0.0]",)
NO_FEED = ("controller.friction_feedforward=false",)


def spectral_radii(motion: Motion, law: Laws, observer: Observer | None) -> Vector:
    return radii(one_period(motion, law, observer))


def truth(inertia: float = 1.0, load: float = 1.0, friction: float = 0.6) -> Truth:
    return Truth(np.array(inertia), np.array(load), friction)


def wrench_of_law(cell: Cell, arm: int, step: float = 1e-6) -> tuple[Matrix, Matrix]:
    """−∂u/∂x and −∂u/∂w (m, m) of the running law at rest, by differences: wrenches at the object of its torques."""
    a = cell.arms[arm]
    model, offline, obj = cell.model(a), cell.offline(a), cell.file.object
    desired = Desired(obj.p_start_m, obj.quat_start, REST, REST)
    q = ik.solve(model, cell.T_world_object_start, np.array(a.entry.q_near_rad), tolerance=1e-13)
    P, base = cell.model(cell.arms[0]).task_basis, model.jacobian(q)
    J = P @ model.task_basis.T @ base

    def u(q_now: Vector, dq: Vector) -> Vector:
        tau = known.torque(model, offline, q_now, dq, desired).tau_cmd
        return np.linalg.solve(J.T, tau)

    zero, found = np.zeros(model.n), []
    for turn in np.linalg.inv(J).T:
        pose_part = (u(q + step * turn, zero) - u(q - step * turn, zero)) / (2.0 * step)
        rate_part = (u(q, step * turn) - u(q, -step * turn)) / (2.0 * step)
        found.append((-pose_part, -rate_part))
    return np.array([f[0] for f in found]).T, np.array([f[1] for f in found]).T


@pytest.mark.parametrize("name", CELLS)
def test_the_laws_are_those_that_run(name: str) -> None:
    cell = cell_of(name, *NO_WEIGHT, *NO_FEED, "controller.k_p_rate_per_s=33.0", "controller.k_eps_rate_rad_per_s=21.0")
    found = laws(start_pose(cell), loop_of(cell).gains)
    for i in range(len(cell.arms)):
        S, D = wrench_of_law(cell, i)
        assert found.S[i] == pytest.approx(S, rel=1e-5, abs=1e-4 * np.abs(S).max())
        assert found.D[i] == pytest.approx(D, rel=1e-5, abs=1e-4 * np.abs(D).max())


def test_viscous_feed_forward_is_part_of_the_stiffness() -> None:
    """Without the Coulomb part, whose smooth sign is no linear friction."""
    cell = first("paper")
    own = [replace(cell.offline(a), friction=None) for a in cell.arms]
    at = start_pose(cell)
    fed, plain = laws(at, [o.gains for o in own]).S, laws(unfed(at), [o.gains for o in own]).S
    K, H = np.diag([150.0, 150.0, 100.0]), np.diag([1.0, 1.0, 0.5])
    for g, with_it, without in zip(at.grips, fed, plain, strict=True):
        assert g.feeds_friction
        assert with_it - without == pytest.approx(g.viscous @ K @ H)


def unfed(at: Pose) -> Pose:
    return replace(at, grips=tuple(replace(g, feeds_friction=False) for g in at.grips))


@pytest.mark.parametrize("name", CELLS)
def test_an_arm_swings_on_its_pad_as_in_the_plant(name: str) -> None:
    cell = cell_of(name)
    spec = plant_spec(cell, start_configurations(cell, [cell.model(a) for a in cell.arms]))
    of_plant = FreeArms(spec).swinging(np.concatenate([arm.q_start for arm in spec.arms]))
    for grip, inertia in zip(start_pose(cell).grips, of_plant, strict=True):
        assert grip.swinging == pytest.approx(inertia, rel=1e-6)


def test_pads_are_damped_by_the_ratio_of_the_arm_that_swings() -> None:
    mobility = np.diag([0.5, 0.25, 0.25, 0.0, 0.0, 40.0])
    inertia = pads.swinging_inertia(mobility)
    assert inertia == pytest.approx([3.0, 3.0, 3.0, 1 / 40.0, 1 / 40.0, 1 / 40.0])
    k = np.array([1200.0] * 3 + [10.0] * 3)
    c = pads.damping(k, inertia, 0.25)
    assert c == pytest.approx([0.25 * 2.0 * 60.0] * 3 + [0.25 * 2.0 * 0.5] * 3)


def test_the_wrench_of_a_pad_is_that_at_its_grasp() -> None:
    """Turning the object about its centre stretches the pad by the lever, across it."""
    grip = start_pose(cell_of("paper")).grips[0]  # grasp 40 mm from the centre
    K = grip.springs(np.array(1000.0), np.array(0.0))
    assert K[2, 2] == pytest.approx(1000.0 * 0.04**2)
    assert np.linalg.norm(K[:2, 2]) == pytest.approx(1000.0 * 0.04)
    assert grip.springs(np.array(0.0), np.array(7.0))[2, 2] == pytest.approx(7.0)


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 1.25, 2.0, 2.6])
@pytest.mark.parametrize("velocity", ["servo", "observer"])
def test_the_rigid_cell_is_the_coupled_map(delay: float, velocity: str) -> None:
    cell = cell_of("paper", *NO_FEED, f'controller.velocity="{velocity}"')
    models = [cell.model(a) for a in cell.arms]
    q, obj, loop = start_configurations(cell, models), cell.file.object, loop_of(cell)
    R = models[0].object_pose(q[0]).rotation
    inertia = R @ np.array(obj.inertia_kg_m2.matrix()) @ R.T
    believed, light = (coupled_inertia(models, q, obj.mass_kg, inertia, s) for s in (1.0, 0.7))
    coupled = SampledLoop(loop.period_s, delay, loop.gains, loop.observer)
    expected = spectral_radius(light, believed, models[0].task_basis, coupled)
    at = start_pose(cell)
    motion = bodies.rigid(at, truth(0.7, friction=0.0)).motion(loop.period_s, delay)
    found = spectral_radii(motion, laws(at, loop.gains).together(), loop.observer)
    assert float(found) == pytest.approx(expected, rel=1e-9)


class StepByStep:
    """The same cell written down and stepped with nothing of the criterion but its matrices at the grasps."""

    def __init__(self, at: Pose, loop: Loop, law: Laws, case: Case, ratio: float) -> None:
        self.loop, self.law, self.delay = loop, law, case.delay_periods
        m, N = len(at.P), len(at.grips)
        self.m, self.N = m, N
        M, K, D = [np.zeros(((N + 1) * m, (N + 1) * m)) for _ in range(3)]
        last = slice(N * m, None)
        M[last, last] = case.load * at.object_inertia
        for i, g in enumerate(at.grips):
            own = slice(i * m, i * m + m)
            M[own, own], D[own, own] = case.inertia * g.inertia, 0.6 * g.viscous
            for matrix, per_axis in ((K, [case.k_t] * 3 + [case.k_r] * 3), (D, None)):
                stiffness = np.array([case.k_t] * 3 + [case.k_r] * 3)
                diagonal = (
                    per_axis if per_axis is not None else 2 * ratio * np.sqrt(stiffness * case.inertia * g.swinging)
                )
                G = np.zeros((6, len(M)))
                G[:, own], G[:, last] = g.lever, -g.lever
                matrix[:] += G.T @ np.diag(diagonal) @ G
        self.M_inv, self.K, self.D = np.linalg.inv(M), K, D

    def growth(self, ticks: int) -> float:
        """Mean factor per tick by which a disturbance grows."""
        m, N, T, law = self.m, self.N, self.loop.period_s, self.law
        n, rows = (N + 1) * m, N * m
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-self.M_inv @ self.K, -self.M_inv @ self.D]])
        B = np.vstack([np.zeros((n, rows)), self.M_inv[:, :rows]])
        parts = 20  # of a period; every delay of the tests is a whole number of them
        small = expm(np.block([[A, B], [np.zeros((rows, 2 * n + rows))]]) * (T / parts))
        F, G = small[: 2 * n, : 2 * n], small[: 2 * n, 2 * n :]
        y = np.random.default_rng(0).normal(size=2 * n)
        x = w = a = a_before = np.zeros(rows)
        coming: list[tuple[int, Vector]] = []
        acting, sizes = np.zeros(rows), []
        for tick in range(ticks):
            x_now, w_now = y[:rows], y[n : n + rows]
            observer = self.loop.observer
            if observer is None or tick == 0:
                x, w = x_now, w_now
            else:
                x, w = observer.follow(x, w, a_before, a, x_now, w_now)
            a_before = a
            a = np.concatenate([-law.R @ w[m * i : m * i + m] for i in range(N)])
            u = [-law.S[i] @ x[m * i : m * i + m] - law.D[i] @ w[m * i : m * i + m] for i in range(N)]
            coming.append((tick * parts + round(self.delay * parts), np.concatenate(u)))
            for part in range(tick * parts, (tick + 1) * parts):
                while coming and coming[0][0] <= part:
                    acting = coming.pop(0)[1]
                y = F @ y + G @ acting
            sizes.append(float(np.linalg.norm(y)))
        half = ticks // 2
        late = (
            np.maximum.accumulate(np.array(sizes)[::-1])[::-1] if sizes[-1] < sizes[0] else np.maximum.accumulate(sizes)
        )
        return float(np.exp(np.polyfit(np.arange(half, ticks), np.log(late[half:]), 1)[0]))


STEPPED = [
    ("paper", Case(Demand.SOFT, 0, 1.0, 0.7, 1.2, None, 1e4, 10.0)),
    ("paper", Case(Demand.SOFT, 0, 1.25, 1.3, 0.8, None, 3e4, 100.0)),
    ("two_wx200", Case(Demand.SOFT, 0, 1.25, 0.7, 0.8, None, 1e6, 1.0)),
    ("two_models", Case(Demand.SOFT, 0, 0.8, 0.7, 1.2, None, 1e3, 1.0)),
]


@pytest.mark.parametrize(("name", "case"), STEPPED)
@pytest.mark.parametrize(
    ("soft_gains", "velocity"),
    [(False, "observer"), (True, "servo"), long((False, "servo")), long((True, "observer"))],
)
def test_a_disturbance_grows_or_dies_by_the_radius(name: str, case: Case, velocity: str, soft_gains: bool) -> None:
    cell = (gentle if soft_gains else first)(name, f'controller.velocity="{velocity}"')
    at, loop = start_pose(cell), loop_of(cell)
    predicted = rank(Judge([at], loop), ranges_of(cell), [case])[0].radius
    stepped = StepByStep(at, loop, laws(at, loop.gains), case, 0.25).growth(300 if predicted > 1.0 else 1500)
    assert stepped == pytest.approx(predicted, abs=0.003)


@pytest.mark.parametrize("name", ["paper", "three_wx250s"])
def test_grasps_that_hardly_give_are_rigid_ones_and_grasps_that_are_nothing_bare_arms(name: str) -> None:
    cell = cell_of(name, 'controller.velocity="servo"')
    at, loop = start_pose(cell), loop_of(cell)
    law = laws(at, loop.gains)

    def soft(k_t: float, k_r: float) -> float:
        grasps = Springs(np.array(k_t), np.array(k_r), 0.25)
        return float(spectral_radii(bodies.soft(at, truth(0.7), grasps).motion(loop.period_s, 1.25), law, None))

    one = bodies.rigid(at, truth(0.7)).motion(loop.period_s, 1.25)
    assert soft(1e8, 1e6) == pytest.approx(float(spectral_radii(one, law.together(), None)), abs=2e-3)
    alone = [
        float(spectral_radii(bodies.bare(at, i, truth(0.7)).motion(loop.period_s, 1.25), law.of([i]), None))
        for i in range(len(at.grips))
    ]
    assert soft(1e-6, 1e-6) == pytest.approx(max(*alone, 1.0), abs=1e-4)  # the free object alone has a radius of 1


def test_a_delay_that_is_nearly_whole_is_the_whole_one() -> None:
    cell = cell_of("paper")
    at, loop = start_pose(cell), loop_of(cell)
    grasps = Springs(np.array(1e4), np.array(10.0), 0.25)

    def radius(delay: float) -> float:
        motion = bodies.soft(at, truth(), grasps).motion(loop.period_s, delay)
        return float(spectral_radii(motion, laws(at, loop.gains), loop.observer))

    for whole in (0.0, 1.0, 2.0):
        assert radius(whole + 1e-7) == pytest.approx(radius(whole), rel=1e-5)
    assert radius(0.999999) == pytest.approx(radius(1.0), rel=1e-5)


def test_an_arm_that_aligns_itself_creeps_to_the_anchor_at_its_share_of_the_stiffness() -> None:
    """ḋ = α (x − d), with x between d and the anchor's target as stiffness says: the slowest mode."""
    cell = gentle("paper", *NO_FEED)
    at, loop, alpha = start_pose(cell), replace(loop_of(cell), aligning=Aligning(0, 0.01)), 0.01
    radius = rank(Judge([at], loop), ranges_of(cell), [Case(Demand.ALIGNING, 0, 1.0, 1.0, 1.0)])[0].radius
    assert -np.log(radius) / loop.period_s == pytest.approx(0.5 * alpha, rel=0.02)
    backwards = replace(loop, aligning=Aligning(0, -alpha))
    assert rank(Judge([at], backwards), ranges_of(cell), [Case(Demand.ALIGNING, 0, 1.0, 1.0, 1.0)])[0].radius > 1.0


@pytest.mark.parametrize("anchor", [0, 1, 2])
def test_followers_on_rigid_grasps_are_followers_on_stiff_pads(anchor: int) -> None:
    cell = gentle("three_wx250s")
    loop = replace(loop_of(cell), aligning=Aligning(anchor, 2.0))
    judge, ranges = Judge([start_pose(cell)], loop), ranges_of(cell)
    rigid = rank(judge, ranges, [Case(Demand.ALIGNING, 0, 1.0, 1.0, 1.0)])[0].radius
    stiff = rank(judge, ranges, [Case(Demand.ALIGNING, 0, 1.0, 1.0, 1.0, None, 1e7, 1e5)])[0].radius
    assert stiff == pytest.approx(rigid, abs=1e-5)
    assert 1.0 - rigid == pytest.approx(1.0 - stiff, rel=0.05)


def test_without_a_rate_the_shift_changes_nothing() -> None:
    cell = gentle("two_wx200")
    at, loop = start_pose(cell), loop_of(cell)
    law = laws(at, loop.gains)
    motion = bodies.rigid(at, truth()).seen_by(2).motion(loop.period_s, 1.0)
    shifted = one_period(motion, law, loop.observer, Shifting(slice(3, None), 0.0))
    plain = one_period(motion, law, loop.observer)
    assert shifted[: len(plain), : len(plain)] == pytest.approx(plain)
    assert shifted[len(plain) :, len(plain) :] == pytest.approx(np.eye(3))


def test_an_observer_that_takes_everything_is_no_observer() -> None:
    cell = cell_of("paper")
    at, loop = start_pose(cell), loop_of(cell)
    everything = Observer(loop.period_s, 1.0, 0.0, 1.0, 1.0)
    motion = bodies.rigid(at, truth()).motion(loop.period_s, 1.0)
    law = laws(at, loop.gains).together()
    assert spectral_radii(motion, law, everything) == pytest.approx(spectral_radii(motion, law, None))
