"""What the torque would have been: nothing changes without a change, and with one it is what `step` gives."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.agent import build_agent
from agent.config.cell import Cell, ConfigError, load_cell
from agent.control.adaptation import Estimate
from agent.control.memory import restore
from agent.log.read import open_log
from agent.loop import initial_memory, step
from agent.modes import Mode
from agent.replay import whatif
from agent.replay.chain import Chain
from agent.replay.picture import save_picture
from agent.replay.rows import Window
from agent.replay.source import ReplayError, changed_cell, recorded_cell
from agent.replay.whatif import ArmTorques, what_if
from drivers.interface import JointState
from tests.support.plant.plant_arm import run_one
from tests.support.runner_rig import paper, q_start, run
from tests.support.telemetry.run_log import write_other_release, write_run

WX200 = configs.CELLS_DIR / "identify_wx200.toml"


@cache
def recorded() -> tuple[Cell, np.ndarray]:
    cell = load_cell(WX200)
    return cell, run_one(cell, 0.6).rows


@pytest.fixture
def log(tmp_path: Path) -> Path:
    cell, rows = recorded()
    return write_run(tmp_path / "run.mcap", cell, {cell.arms[0].name: rows})


def changed(path: Path, *changes: str, window: Window = Window()) -> ArmTorques:  # noqa: B008
    with open_log(path, any_layout=True) as log:
        arm = next(name for name, rows in log.agents.items() if len(rows))
        return what_if(log, recorded_cell(log), changed_cell(log, changes), window, arm)[0]


def test_the_same_value_gives_the_same_torque(log: Path) -> None:
    cell, rows = recorded()
    mass = cell.file.object.mass_kg
    for window in (Window(), Window(from_row=40)):
        found = changed(log, f"object.mass_kg={mass}", window=window)
        assert np.array_equal(found.changed, found.recorded)
        assert np.array_equal(found.recorded, rows["tau_limited"][-len(found.t) :, : cell.arms[0].n])
        assert all(f.max_difference_Nm == 0.0 for f in found.joints)


@pytest.mark.parametrize(
    "change",
    ["controller.k_p_per_s=20.0", 'controller.kind="adaptive"', "object.mass_kg=0.5", 'controller.velocity="servo"'],
)
def test_a_change_gives_what_step_gives_with_it_at_the_recorded_joints(log: Path, change: str) -> None:
    _, rows = recorded()
    cell = load_cell(WX200, [change])
    agent = build_agent(cell, cell.arms[0])
    memory, expected, n = initial_memory(agent), [], agent.model.n
    for row in rows:
        state = JointState(int(row["stamp_ns"]), *(row[f"{x}_measured"][:n].copy() for x in ("q", "dq", "tau")))
        outcome = step(agent, state, float(row["t"]), Mode.TRACK, memory)
        memory = outcome.memory
        expected.append(outcome.tau)
    found = changed(log, change)
    assert np.array_equal(found.changed, np.array(expected))
    apart = found.changed - found.recorded
    for j, f in enumerate(found.joints):
        assert f.rms_difference_Nm == pytest.approx(np.sqrt(np.mean(apart[:, j] ** 2)))
        assert f.max_difference_Nm == np.abs(apart[:, j]).max()
        assert f.at_s == found.t[np.abs(apart[:, j]).argmax()]
        assert f.rms_recorded_Nm == pytest.approx(np.sqrt(np.mean(found.recorded[:, j] ** 2)))
        assert f.rms_Nm == pytest.approx(np.sqrt(np.mean(found.changed[:, j] ** 2)))
    assert max(f.max_difference_Nm for f in found.joints) > 1e-4


def test_another_law_from_the_middle_begins_with_its_own_estimate(log: Path) -> None:
    _, rows = recorded()
    cell = load_cell(WX200, ['controller.kind="adaptive"'])
    agent, row = build_agent(cell, cell.arms[0]), rows[40]
    n, adaptation = agent.model.n, agent.offline.adaptation
    assert adaptation is not None
    state = JointState(int(row["stamp_ns"]), *(row[f"{x}_measured"][:n].copy() for x in ("q", "dq", "tau")))
    outcome = step(agent, state, float(row["t"]), Mode.TRACK, restore(row["memory"], n, adaptation.start))
    found = changed(log, 'controller.kind="adaptive"', window=Window(from_row=40))
    assert np.array_equal(found.changed[0], outcome.tau)


def test_a_row_from_which_the_law_makes_nothing_is_counted_and_in_no_figure(tmp_path: Path) -> None:
    rows = run(q=lambda read: q_start() if read != 14 else np.full(3, np.nan), ticks=20).rows
    path = write_run(tmp_path / "run.mcap", paper(), {"left": rows})
    found = changed(path, "object.mass_kg=0.5")
    assert (found.without, len(found.t)) == (1, len(rows) - 1)
    assert all(np.isfinite(f.max_difference_Nm) for f in found.joints)


def test_other_joints_are_not_those_of_the_rows() -> None:
    arm = recorded()[0].arms[0]
    other = replace(arm, entry=arm.entry.model_copy(update={"controlled": arm.entry.controlled[:-1]}))
    with pytest.raises(ReplayError, match="leave `controlled` as it is"):
        whatif._refuse_other_joints(arm, other)


def test_rows_that_a_limit_cut_are_counted(log: Path) -> None:
    found = changed(log, "safety.tau_max_fraction_of_stall=0.05")
    assert found.limited > found.limited_recorded
    assert found.without == 0


def test_another_model_of_ours_may_stand_in_for_the_recorded_one(log: Path) -> None:
    name = recorded()[0].arms[0].name
    found = changed(log, f'arms.{name}.model="wx250"')
    assert max(f.max_difference_Nm for f in found.joints) > 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("rate_hz=100.0", "rate_hz: found 100, expected 200, at which the rows are"),
        ("controller.k_p=1.0", "an unknown key"),
        ("controller.k_p_per_s=-1.0", "controller.k_p_per_s in cell.toml of run.mcap with the changes asked for: "),
        ("nothing", "override"),
    ],
)
def test_a_change_that_cannot_be_meant_is_refused(log: Path, change: str, message: str) -> None:
    with pytest.raises((ReplayError, ConfigError), match=message):
        changed(log, change)


def test_nothing_is_no_figure(log: Path) -> None:
    with pytest.raises(ReplayError, match="nothing to replay"):
        changed(log, "object.mass_kg=0.5", window=Window(from_s=99.0))


def test_a_memory_that_cannot_be_read_is_no_start(tmp_path: Path) -> None:
    cell, rows = recorded()
    name = cell.arms[0].name
    path = write_other_release(tmp_path / "old.mcap", cell, {name: rows}, without=("shift",), memory=51)
    assert changed(path, "object.mass_kg=0.5").t.shape == (len(rows),)
    with pytest.raises(ReplayError, match="a memory that this release cannot read"):
        changed(path, "object.mass_kg=0.5", window=Window(from_row=10))


def test_the_picture_is_a_picture(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "torque.png"
    save_picture([changed(log, "object.mass_kg=0.5")], ["object.mass_kg=0.5"], path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert len(path.read_bytes()) > 10_000


def test_behind_rows_that_are_missing_another_law_goes_on_with_what_it_has_learnt() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ['controller.kind="adaptive"'])
    agent, rows = build_agent(cell, cell.arms[0]), run(ticks=4).rows
    adaptation = agent.offline.adaptation
    assert adaptation is not None
    chain = Chain(agent)
    chain.restore(rows[3], keep_estimate=True)
    begun = estimate_of(chain)
    np.testing.assert_array_equal(begun.object, adaptation.start.object)
    learnt = rows[3].copy()
    learnt["theta_object"] = 7.0
    chain.restore(learnt)
    chain.restore(rows[4], keep_estimate=True)
    assert estimate_of(chain).object.tolist() == [7.0] * 10


def test_a_law_that_learns_nothing_has_no_estimate() -> None:
    chain = Chain(build_agent(paper(), paper().arms[0]))
    chain.restore(run(ticks=4).rows[3])
    assert chain.memory is not None
    assert chain.memory.estimate is None


def estimate_of(chain: Chain) -> Estimate:
    assert chain.memory is not None
    assert chain.memory.estimate is not None
    return chain.memory.estimate
