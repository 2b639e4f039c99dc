"""A motion into a singular pose, which the check would have refused: it ends in a hold, in bounded torque, by name."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, ConfigError, load_cell
from agent.control.memory import restore
from agent.loop import step
from agent.modes import Event, Mode
from agent.process.simulated import plant_spec
from agent.safety import Flag
from agent.verify.check import examine, start_configurations
from drivers.interface import JointState
from tests.support.few import long
from tests.support.plant.plant_arm import ArmRun, run_loop, run_one
from tests.support.plant.served_plant import ServedPlant

PAPER = configs.CELLS_DIR / "paper.toml"


def towards(x_m: float, z_m: float, move_s: float, *overrides: str, cell: str = "identify_wx200") -> Cell:
    """One arm that is to carry its object to a place it cannot reach."""
    path = configs.CELLS_DIR / f"{cell}.toml"
    start = list(load_cell(path).file.object.p_start_m)
    motion = f'{{kind="rest_to_rest", p_from_m={start}, p_to_m=[{x_m}, 0.0, {z_m}], move_s={move_s}}}'
    # the arm cannot follow into the singularity either; here the other reason to stop is to speak
    blind = ["safety.tracking_error_max_m=1.0", "safety.tracking_error_max_rad=3.1"]
    return load_cell(path, [f"trajectory={motion}", *blind, *overrides])


REST_S, LEAST_S = 1.5, 3.5  # behind the motion, and of all of a run
# slow and fast, forward and up: the arm stretches; the last is fast enough to pass the margin within one tick or two
INTO = [
    (0.6, 0.25, 3.0, "identify_wx200"),
    (0.6, 0.25, 1.0, "identify_wx200"),
    (0.45, 0.5, 3.0, "identify_wx200"),
    (0.3, 0.7, 1.5, "identify_wx200"),
    (0.6, 0.35, 8.0, "identify_wx250s"),
    (0.3, 0.8, 3.0, "identify_wx250s"),
]


def target(into: tuple[float, float, float, str]) -> Cell:
    x_m, z_m, move_s, cell = into
    return towards(x_m, z_m, move_s, cell=cell)


LONG = {INTO[1], INTO[2], INTO[4]}  # `make long` runs these


@pytest.fixture(
    scope="module",
    params=[pytest.param(into, marks=[pytest.mark.long] * (into in LONG)) for into in INTO],
    ids=lambda into: f"{into[3]} to {into[0]} {into[1]} in {into[2]} s",
)
def run(request: pytest.FixtureRequest) -> ArmRun:
    return run_one(target(request.param), max(LEAST_S, request.param[2] + REST_S))


def test_the_check_would_have_refused_each_of_them() -> None:
    for into in INTO:
        with pytest.raises(ConfigError, match=r"unreachable|singular"):
            examine(target(into)).require()


@pytest.mark.fault("M4")
def test_it_ends_in_a_hold_that_names_the_singularity(run: ArmRun) -> None:
    assert run.modes == [Mode.TRACK, Mode.HOLD]
    assert run.summary.mode is Mode.HOLD
    assert "SINGULAR" in run.summary.reason
    first = run.rows[run.rows["mode"] == Mode.TRACK][-1]
    assert first["flags"] & Flag.SINGULAR
    assert f"t = {first['t']:.3f} s" in run.summary.reason


@pytest.mark.fault("M4")
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


@pytest.mark.parametrize("override", ['controller.velocity="servo"', long('controller.kind="adaptive"')])
def test_other_velocities_and_the_other_law_hold_too(override: str) -> None:
    run = run_one(towards(0.45, 0.5, 3.0, override), 4.0)
    assert run.modes == [Mode.TRACK, Mode.HOLD]
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
                runs[cell.arms[i].name] = run_loop(cell, i, drivers[i], drivers[i].clock, 4.5)
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
        assert run.modes == [Mode.TRACK, Mode.HOLD]
        assert "SINGULAR" in run.summary.reason
        assert np.abs(run.held["dq"][-100:]).max() < 0.1
    starts = [run.held["t"][0] for run in runs.values()]
    assert abs(starts[0] - starts[1]) < 0.05


def test_a_stop_at_a_regular_pose_holds_the_object_by_the_law_itself() -> None:
    ticks: list[int] = []

    def operator() -> Event:
        ticks.append(1)
        return Event.STOP if len(ticks) == 200 else Event.NONE

    run = run_one(load_cell(configs.CELLS_DIR / "identify_wx200.toml"), 3.0, operator)
    assert run.modes == [Mode.TRACK, Mode.HOLD]
    assert not np.any(run.held["flags"] & Flag.SINGULAR)
    assert np.any(run.held["tau_feedback"] != 0.0)
