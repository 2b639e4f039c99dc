"""A motion into a singular pose, which the check would have refused: it ends in a hold, in bounded torque, by name."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import Cell, ConfigError, load_cell
from agent.control import joint_hold
from agent.control.memory import restore
from agent.loop import hold_here, initial_memory, step
from agent.modes import Event, Mode
from agent.process.build import HOLD_RATE_MAX_RAD_PER_S, build_agent
from agent.process.simulated import plant_spec
from agent.safety import Flag
from agent.verify.check import examine, start_configurations
from drivers.interface import JointState
from tests.support.plant.plant_arm import ArmRun, run_loop, run_one
from tests.support.plant.served_plant import ServedPlant

ONE_ARM = configs.CELLS_DIR / "identify_wx200.toml"
PAPER = configs.CELLS_DIR / "paper.toml"


def towards(x_m: float, z_m: float, move_s: float, *overrides: str, cell: str = "identify_wx200") -> Cell:
    """One arm that is to carry its object to a place it cannot reach."""
    path = configs.CELLS_DIR / f"{cell}.toml"
    start = list(load_cell(path).file.object.p_start_m)
    motion = f'{{kind="rest_to_rest", p_from_m={start}, p_to_m=[{x_m}, 0.0, {z_m}], move_s={move_s}}}'
    # the arm cannot follow into the singularity either; here the other reason to stop is to speak
    blind = ["safety.tracking_error_max_m=1.0", "safety.tracking_error_max_rad=3.1"]
    return load_cell(path, [f"trajectory={motion}", *blind, *overrides])


# slow and fast, forward and up: the arm stretches; the last is fast enough to pass the margin within one tick or two
INTO = [
    towards(0.6, 0.25, 3.0),
    towards(0.6, 0.25, 1.0),
    towards(0.45, 0.5, 3.0),
    towards(0.3, 0.7, 1.5),
    towards(0.6, 0.35, 8.0, cell="identify_wx250s"),
    towards(0.3, 0.8, 3.0, cell="identify_wx250s"),
]


@pytest.fixture(scope="module", params=INTO, ids=lambda cell: f"{cell.file.name} {cell.file.trajectory.p_to_m}")
def run(request: pytest.FixtureRequest) -> ArmRun:
    return run_one(request.param, 9.0)


def test_the_check_would_have_refused_each_of_them() -> None:
    for target in INTO:
        with pytest.raises(ConfigError, match=r"unreachable|singular"):
            examine(target).require()


def test_it_ends_in_a_hold_that_names_the_singularity(run: ArmRun) -> None:
    assert run.modes == [Mode.HOLD]
    assert run.summary.mode is Mode.HOLD
    assert "SINGULAR" in run.summary.reason
    first = run.rows[run.rows["mode"] == Mode.TRACK][-1]
    assert first["flags"] & Flag.SINGULAR
    assert f"t = {first['t']:.3f} s" in run.summary.reason


def test_no_torque_and_no_step_of_it_exceeds_its_bound(run: ArmRun) -> None:
    sent = run.rows["tau_sent"][:, : run.agent.model.n]
    limits, lsb = run.agent.limits, 0.01
    assert np.all(np.abs(sent) <= np.array(limits.tau_max_Nm) + 1e-12)
    assert np.all(np.abs(np.diff(sent, axis=0)) <= np.array(limits.tau_step_max_Nm) + lsb)


def test_the_arm_comes_to_rest_near_where_the_hold_began(run: ArmRun) -> None:
    held = run.held
    last = held[-200:]
    assert np.abs(last["dq"]).max() < 0.1  # four steps of the velocity grid
    assert np.abs(np.diff(last["tau_sent"], axis=0)).mean() < 5e-3
    assert np.linalg.norm(last["e_p"], axis=1).max() < 0.01
    assert np.abs(held["q_measured"][-1] - held["q_measured"][0]).max() < 0.3


def test_the_hold_takes_up_the_torque_of_the_motion_without_letting_go(run: ArmRun) -> None:
    """The object never falls freely: gravity is compensated from the first held tick."""
    gravity = run.held["tau_gravity"]
    assert np.all(np.isfinite(gravity))
    assert np.abs(gravity).max() > 0.3


def test_the_terms_of_the_held_torque_are_its_sum_and_nothing_old_stays_in_the_row(run: ArmRun) -> None:
    held = run.held
    names = ("inertia", "coriolis", "gravity", "adaptive", "feedback", "object", "internal", "friction", "posture")
    total = sum(held[f"tau_{name}"] for name in names)
    assert np.allclose(total, held["tau_cmd"], atol=1e-12)


def test_the_hold_replays_from_any_of_its_rows(run: ArmRun) -> None:
    for row in run.held[[0, 1, 50, -1]]:
        n = run.agent.model.n
        memory = restore(row["memory"], n)
        state = JointState(int(row["stamp_ns"]), row["q_measured"][:n], row["dq_measured"][:n], row["tau_measured"][:n])
        again = step(run.agent, state, float(row["t"]), Mode.HOLD, memory)
        assert np.array_equal(again.tau, row["tau_limited"][:n])
        assert int(again.flags) == row["flags"]


@pytest.mark.parametrize("override", ['controller.velocity="servo"', 'controller.kind="adaptive"'])
def test_other_velocities_and_the_other_law_hold_too(override: str) -> None:
    run = run_one(towards(0.45, 0.5, 3.0, override), 6.0)
    assert run.modes == [Mode.HOLD]
    assert "SINGULAR" in run.summary.reason
    assert np.abs(run.held["dq"][-100:]).max() < 0.1
    assert np.linalg.norm(run.held["e_p"][-1]) < 0.01


def test_both_arms_of_a_cell_that_stretch_together_hold_together(tmp_path: Path) -> None:
    motion = '{kind="rest_to_rest", p_from_m=[0.3, 0.12, 0.0], p_to_m=[0.3, 0.55, 0.0], move_s=4.0}'
    cell = load_cell(PAPER, [f"trajectory={motion}"])
    q_start = start_configurations(cell, [cell.model(arm) for arm in cell.arms])
    served = {"names": [a.name for a in cell.arms], "spec": plant_spec(cell, q_start), "config_id": cell.config_id}
    runs: dict[str, ArmRun] = {}
    with ServedPlant(tmp_path, **served) as plant:
        drivers = [plant.driver(a.name, joints=tuple(a.entry.controlled), config_id=cell.config_id) for a in cell.arms]

        def work(i: int) -> None:
            try:
                runs[cell.arms[i].name] = run_loop(cell, i, drivers[i], drivers[i].clock, 5.0)
            finally:
                drivers[i].disable()

        for driver in drivers:
            driver.connect()
        for driver in drivers:
            driver.enable()
        threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60.0)
            assert not thread.is_alive()
    assert set(runs) == {"left", "right"}
    for run in runs.values():
        assert run.modes == [Mode.HOLD]
        assert "SINGULAR" in run.summary.reason
        assert np.abs(run.held["dq"][-100:]).max() < 0.1
    starts = [run.held["t"][0] for run in runs.values()]
    assert abs(starts[0] - starts[1]) < 0.05


def stretched() -> np.ndarray:
    """Elbow in line with shoulder and wrist: the Jacobian of the first link's direction is lost."""
    model = load_cell(ONE_ARM).model(load_cell(ONE_ARM).arms[0])
    grid = np.linspace(-1.8, 0.5, 2000)
    sigma = [joint_hold.sigma_min(model, np.array([0.5, elbow, 0.3])) for elbow in grid]
    return np.array([0.5, grid[int(np.argmin(sigma))], 0.3])


def test_a_jacobian_without_inverse_keeps_the_last_torque_and_says_so() -> None:
    cell = load_cell(ONE_ARM, ['controller.velocity="servo"'])
    agent = build_agent(cell, cell.arms[0])
    memory = initial_memory(agent)._replace(tau=np.array([0.1, 0.2, 0.3]))
    for q in (stretched(), stretched() + np.array([0.3, 0.0, -0.2])):
        outcome = step(agent, JointState(0, q, np.zeros(3), np.zeros(3)), 0.0, Mode.TRACK, memory)
        assert outcome.flags & Flag.SINGULAR
        assert np.all(np.abs(outcome.tau - memory.tau) <= np.array(agent.limits.tau_step_max_Nm) + 1e-12)


def test_a_hold_at_a_singular_pose_is_gravity_and_a_spring() -> None:
    cell = load_cell(ONE_ARM, ['controller.velocity="servo"'])
    agent = build_agent(cell, cell.arms[0])
    q = stretched()
    memory = hold_here(agent, q, initial_memory(agent))
    terms = step(agent, JointState(0, q, np.zeros(3), np.zeros(3)), 0.0, Mode.HOLD, memory).terms
    assert terms is not None
    carried = agent.model.model.copy()
    obj, frame = cell.file.object, carried.frames[agent.model.object_id]
    body = pin.Inertia(obj.mass_kg, np.zeros(3), np.array(obj.inertia_kg_m2.matrix()))
    carried.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    weight = pin.rnea(carried, carried.createData(), q, np.zeros(3), np.zeros(3))
    assert np.allclose(terms.tau_cmd, weight, atol=1e-12)
    aside = q + np.array([0.01, -0.02, 0.03])
    pulled = step(agent, JointState(0, aside, np.zeros(3), np.zeros(3)), 0.0, Mode.HOLD, memory).terms
    assert pulled is not None
    stiffness = agent.model.inertia(aside) * agent.hold_rate_rad_per_s**2
    assert np.allclose(pulled.tau_inertia, -stiffness @ (aside - q), atol=1e-12)


def test_joint_errors_of_a_hold_fall_critically_damped_with_an_exact_model() -> None:
    """(1 + ωt) e^{−ωt}, for every joint on its own, at a pose where neither law has an inverse."""
    cell = load_cell(ONE_ARM)
    agent, q_hold, w = build_agent(cell, cell.arms[0]), stretched(), 10.0
    model = agent.model.model
    offline = replace(agent.offline, load_share=0.0)  # the arm alone: the object is no part of this model
    data, q, dq, h = model.createData(), q_hold + np.array([0.05, -0.1, 0.08]), np.zeros(3), 1e-3
    start = q - q_hold

    def acceleration(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        tau = joint_hold.torque(agent.model, offline, q, dq, q_hold, w).tau_cmd
        return np.array(pin.aba(model, data, q, dq, tau))

    for k in range(1, 401):
        middle_q, middle_dq = q + 0.5 * h * dq, dq + 0.5 * h * acceleration(q, dq)
        q, dq = q + h * middle_dq, dq + h * acceleration(middle_q, middle_dq)
        t = k * h
        assert np.allclose(q - q_hold, start * (1.0 + w * t) * np.exp(-w * t), atol=2e-5)


@pytest.mark.parametrize(
    ("rate_hz", "delay", "expected"), [(200.0, 1.0, 20.0), (500.0, 0.0, 20.0), (60.0, 1.0, 10.0), (60.0, 0.25, 16.0)]
)
def test_a_hold_is_no_stiffer_than_the_rate_allows(rate_hz: float, delay: float, expected: float) -> None:
    cell = load_cell(ONE_ARM, [f"rate_hz={rate_hz}", f"loop_delay_s={delay / rate_hz}"])
    assert HOLD_RATE_MAX_RAD_PER_S == 20.0
    assert build_agent(cell, cell.arms[0]).hold_rate_rad_per_s == pytest.approx(expected)


def test_a_stop_at_a_regular_pose_holds_the_object_by_the_law_itself() -> None:
    ticks: list[int] = []

    def operator() -> Event:
        ticks.append(1)
        return Event.STOP if len(ticks) == 200 else Event.NONE

    run = run_one(load_cell(ONE_ARM), 3.0, operator)
    assert run.modes == [Mode.HOLD]
    assert not np.any(run.held["flags"] & Flag.SINGULAR)
    assert np.any(run.held["tau_feedback"] != 0.0)
