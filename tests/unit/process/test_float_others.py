"""An arm that floats while the other carries the object: driver, loop and ending on emulated servos in virtual time."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agent.calibrate.run import calibrate, write
from agent.config import floating, monitors
from agent.config.cell import Cell, load_cell
from agent.control.floating import Floating
from agent.modes import Mode
from agent.process import float_loop
from agent.process.float_loop import FloatError, Floats
from agent.process.floating_cell import FloatOptions, floating_cell, names_of, require_motion
from agent.process.scene import scene_of
from drivers.interface import Refusal
from tests.support.servos import float_rig
from tests.support.servos.float_rig import OFF, FloatRun, modes_of, replayed
from tests.support.telemetry.run_log import write_run

TWO = Path("two_wx200")
MOTION = ("trajectory.period_s=5.0", "trajectory.ramp_s=1.0")
SLOWER = (*MOTION, "floating.speed_max_rad_per_s=0.2")  # than the motion


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(float_loop, "STAND_S", 0.2)
    monkeypatch.setattr(float_loop, "SINK_MAX_S", 0.3)
    monkeypatch.setattr("agent.config.floating.Floating", partial(Floating, sink_s=0.2))


def test_the_log_of_an_arm_that_floats_while_the_other_moves_the_object_calibrates_their_cell(tmp_path: Path) -> None:
    cell = moved(*OFF)
    run = FloatRun(cell, starts_s=0.3, until_s=4.1)
    left, right = run.arms["left"], run.arms["right"]
    assert left.error is right.error is None
    assert modes_of(left.rows) == ["FLOAT"]
    assert modes_of(right.rows) == ["READY", "TRACK"]
    assert np.abs(right.rows["tau_object"]).max() > 0.05
    assert all(any(said.startswith("gripper holds the object") for said in arm.texts.said) for arm in (left, right))
    assert not any("monitor" in said for arm in (left, right) for said in arm.texts.said)
    assert not np.nan_to_num(right.rows["unexpected"]).any(), "it notices nobody"
    log = write_run(tmp_path / "run.mcap", cell, {name: arm.rows for name, arm in run.arms.items()})
    found = calibrate([log], ["tolerance.base_m=0.01", "tolerance.zeros_rad=0.017"])
    before_m, after_m, _, after_rad = found.judged
    assert before_m > 2.5e-3
    assert after_m < 0.1 * before_m
    assert after_rad < 1e-3
    assert load_cell(write(found, [log], tmp_path / "new").cell).file.floating is None


@pytest.mark.parametrize(
    ("change", "stop_s"),
    [
        ("duration_s=100.0", 0.6),
        pytest.param("duration_s=0.3", 0.8, marks=pytest.mark.long),
        ("safety.tracking_error_max_m=5e-5", 0.8),
    ],
)
def test_an_arm_that_moves_while_others_float_stands_and_sinks_where_it_is_stopped_ends_or_is_off_its_track(
    change: str, stop_s: float
) -> None:
    run = FloatRun(moved(change), starts_s=0.3, stop_s=stop_s)
    stands_and_sinks(run)
    assert any("OFF_TRACK" in said for said in run.arms["right"].texts.said) == ("error" in change)


@pytest.mark.fault("P1")
@pytest.mark.long  # one that floats alone: test_floats.py
def test_a_guard_lets_an_arm_down_whose_process_is_killed_while_it_moves_and_others_float() -> None:
    stands_and_sinks(FloatRun(moved(), starts_s=0.3, dies_s=0.6, guarded=True))


@pytest.mark.fault("P1")
def test_a_guard_that_lets_an_arm_down_whose_servos_had_stopped_closes_its_gripper_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(float_rig, "HOST_NS", 300_000_000)  # longer than they wait
    monkeypatch.setattr(float_loop, "STAND_S", 1.0)
    cell = floating_cell(FloatOptions(TWO, ("left", "right"), MOTION, holding=True))
    run = FloatRun(cell, dies_s=1.5, guarded=True)
    for arm in run.arms.values():
        assert arm.error is None
        said = [text for text in arm.texts.said if text.startswith("gripper")]
        assert len(said) == 2, "the agent, and the guard after it"
        assert all(text.startswith("gripper holds the object") for text in said)


def moved(*changes: str) -> Cell:
    """Two arms of which the left one floats while the right one moves the object."""
    return floating_cell(FloatOptions(TWO, ("left",), (*MOTION, *changes), others_move=True))


def stands_and_sinks(run: FloatRun) -> None:
    """Both arms, from the motion on: within their limits, as a replay computes them, and letting go of nothing."""
    for name, begins in (("left", ["FLOAT"]), ("right", ["READY", "TRACK"])):
        arm = run.arms[name]
        assert arm.error is None
        assert arm.summary is not None
        assert (arm.summary.mode, modes_of(arm.rows)) == (Mode.OFF, [*begins, "STAND", "SINK"]), name
        bounds = np.array(arm.loop._agent.limits.tau_step_max_Nm)  # type: ignore[union-attr]
        assert np.all(np.abs(np.diff(arm.rows["tau_limited"][:, :3], axis=0)) <= bounds + 1e-9)
        replayed(arm)
    rows = run.arms["right"].rows
    stood, before = rows[rows["mode"] == Mode.STAND], rows[rows["mode"] == Mode.TRACK][-1]
    assert stood["t"][0] < 0.34, "s after its start, whatever stopped it"
    assert np.abs(stood["q"][:, :3] - before["q"][:3]).max() < 0.01, "rad"
    assert np.abs(stood["tau_object"][:, :3] - before["tau_object"][:3]).max() < 0.02, "N·m: its share"


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        (FloatOptions(TWO, ("left",), others_move=True), "a normal priority, expected SCHED_FIFO"),
        (FloatOptions(TWO, ("left",), SLOWER, emulate=True, others_move=True), "a joint at 0.2"),
        (
            FloatOptions(TWO, ("left",), ("object.p_start_m=[0.155,0.0,0.25]",), emulate=True, others_move=True),
            "70.00 mm",
        ),
        (
            FloatOptions(TWO, ("left", "right"), others_move=True),
            "every arm .left, right., expected one left that moves",
        ),
        (FloatOptions(TWO, ("middle",), others_move=True), "--arm: found 'middle', expected left or right"),
        (FloatOptions(TWO, ("left",), ("floating.others_move=true",)), "expected holding = true"),
    ],
)
def test_arms_that_cannot_move_while_others_float_are_refused_in_one_line(options: FloatOptions, refused: str) -> None:
    with pytest.raises(Refusal, match=refused) as found:
        require_motion(floating_cell(options), options)
    assert "\n" not in str(found.value)


def test_all_arms_take_part_where_others_move_and_begin_where_the_motion_does() -> None:
    cell = moved()
    assert names_of(cell) == [arm.name for arm in scene_of(cell).arms] == ["left", "right"]
    left, right = (Floats.of(cell, name).servos("virtual") for name in ("left", "right"))
    assert {j.name for j in left.joints if j.start_rad is None} >= {"shoulder", "elbow", "wrist_angle"}
    assert {j.name for j in right.joints if j.start_rad is None} == {"gripper"}
    require_motion(cell, FloatOptions(TWO, ("left",), priority=80, others_move=True))
    bounds = floating.bounds(cell, cell.arm("right"), Floats.of(cell, "right").spec)
    assert bounds.watched == monitors.bounds(cell, cell.arm("right")).watched
    assert max(bounds.speed_rad_per_s) <= floating.TOO_FAST * 1.0
    slow = moved("floating.speed_max_rad_per_s=0.3")
    assert floating.bounds(slow, slow.arm("right"), Floats.of(slow, "right").spec).speed_rad_per_s == (0.75,) * 3
    assert Floats.of(slow, "left").moves is False
    alone = load_cell(TWO, ['floating.arms=["left"]', "floating.holding=true"])
    with pytest.raises(FloatError, match="found no floating"):
        Floats.of(alone, "right")
