"""An arm that a hand guides: real driver, loop and ending on emulated servos in virtual time, and a hand."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import configs
from agent.calibrate.run import calibrate, write
from agent.config.cell import Cell, load_cell
from agent.config.schema.driver import DriverKind
from agent.control.floating import Floating
from agent.modes import Event, Mode
from agent.process import float_loop, floats
from agent.process.build import Connection, patient
from agent.process.float_loop import SINKS, STANDS, Ending, FloatError, Floats
from agent.process.floating_cell import FloatOptions, floating_cell
from agent.safety import Flag
from agent.telemetry.row.event import Level
from drivers.dynamixel.servo.table import TORQUE_ENABLE
from drivers.interface import Refusal, Vector
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.control.level_wx200 import LEVEL
from tests.support.servos.float_rig import OFF, FloatRun, modes_of, replayed
from tests.support.telemetry.run_log import write_run

LEFT = 'floating.arms=["left"]'
CELL = load_cell(Path("two_wx200"), [LEFT])
SPEED = 1.0
FORWARD = np.array([-0.35, 0.69, -0.33])  # the gripper level: what a hand lifts turns the elbow alone, or nearly so
NOTHING = np.zeros(6)
SINK_S = 0.5


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(float_loop, "STAND_S", 0.2)
    monkeypatch.setattr("agent.config.floating.Floating", partial(Floating, sink_s=SINK_S))


def modes(run: FloatRun) -> list[str]:
    return modes_of(run.one.rows)


def part(run: FloatRun, begin_s: float, end_s: float) -> tuple[Vector, Vector]:
    """True q and dq of the one arm in that time."""
    chosen = [(q, dq) for t, q, dq in run.seen if begin_s <= t < end_s]
    return np.array([q for q, _ in chosen]), np.array([dq for _, dq in chosen])


def pushed(force: tuple[float, float, float], begin_s: float, end_s: float) -> Any:
    wrench = np.array([*force, 0.0, 0.0, 0.0])
    return lambda _, t: wrench if begin_s <= t < end_s else NOTHING


def real(**figures: float) -> Cell:
    return load_cell(Path("two_wx200"), [LEFT, *(f"simulation.reality.arms.left.{k}={v}" for k, v in figures.items())])


def test_a_stop_lets_the_arm_stand_then_sink_and_says_so_before_its_torque_goes_off() -> None:
    run = FloatRun(CELL, stop_s=0.4, q_start=np.array([-0.35, 1.55, -0.33]))
    arm = run.one
    assert arm.error is None
    assert arm.summary is not None
    assert (arm.summary.mode, arm.summary.late_cycles, arm.summary.stale_cycles) == (Mode.OFF, 0, 0)
    assert modes(run) == ["FLOAT", "STAND", "SINK"]
    rows = arm.rows
    begins = {Mode(m): rows["t"][rows["mode"] == m][0] for m in set(rows["mode"].tolist())}
    assert begins[Mode.SINK] - begins[Mode.STAND] == pytest.approx(0.2, abs=0.02)
    assert arm.texts.said.index(STANDS) < arm.texts.said.index(SINKS) < len(arm.texts.said) - 1
    assert np.abs(rows["dq"][rows["mode"] == Mode.SINK]).max() < 0.4
    lies = rows[rows["t"] > rows["t"][-1] - 0.4]
    assert np.abs(lies["dq"]).max() <= float_loop.LIES_RAD_PER_S
    assert rows["t"][-1] > begins[Mode.SINK] + SINK_S, "the weight is gone before the torque is"
    bounds = arm.loop._agent.limits  # type: ignore[union-attr]
    steps = np.abs(np.diff(rows["tau_limited"][:, :3], axis=0)).max(axis=0)
    assert np.all(steps <= np.array(bounds.tau_step_max_Nm) + 1e-9)
    assert not arm.port.is_open  # type: ignore[union-attr]
    servos = [run.emulated.arms[0].servo(i) for i in range(1, 8)]
    assert not any(servo.firmware.memory.get(TORQUE_ENABLE) for servo in servos)
    replayed(run.one)


@pytest.mark.parametrize(
    ("masses", "fastest"), [(1.1, 0.4), pytest.param(0.9, 0.4, marks=pytest.mark.long), (1.0, 0.02)]
)
def test_an_arm_that_is_let_go_rests_or_drifts_slowly_where_its_weight_is_not_what_the_files_say(
    masses: float, fastest: float
) -> None:
    run = FloatRun(CELL, truth=real(masses=masses, friction=0.6), until_s=1.2)
    _, dq = part(run, 0.7, 1.2)
    assert np.abs(dq).max() <= fastest
    assert modes(run) == ["FLOAT"]
    tau = run.one.rows["tau_limited"][-60:, :3]
    assert np.abs(np.diff(tau, axis=0)).max() < 0.05, "no chatter"


def test_a_hand_moves_it_against_the_drag_and_what_it_leaves_comes_to_rest() -> None:
    run = FloatRun(CELL, q_start=FORWARD, hand=pushed((2.7, 0.0, 1.8), 0.2, 0.7), until_s=1.3)
    (q0, _), (q1, dq) = part(run, 0.1, 0.2), part(run, 1.1, 1.3)
    assert np.abs(q1[-1] - q0[-1]).max() > 0.15
    assert np.abs(dq).max() < 0.06
    assert np.abs(run.one.rows["dq"]).max() < SPEED


def test_a_push_beyond_the_largest_speed_meets_all_that_the_arm_has_and_stops_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(float_loop, "STAND_S", 9.0)
    run = FloatRun(CELL, q_start=FORWARD, hand=pushed((0.0, 0.0, -20.0), 0.2, 0.4), until_s=2.2)
    rows = run.one.rows
    assert "STAND" in modes(run)
    assert "monitor speed" in next(text for text in run.one.texts.said if "holds" in text)
    pushed_rows = rows[(rows["t"] > 0.2) & (np.abs(rows["dq"][:, 1]) > 1.2 * SPEED) & (rows["t"] < 0.4)]
    assert len(pushed_rows) > 3
    against = pushed_rows["tau_limited"][:, 1] * np.sign(pushed_rows["dq"][:, 1])
    assert np.all(against[2:] < -1.9), "N·m of 2.05: it resists with what it has"
    _, dq = part(run, 2.1, 2.2)  # it comes back from an end stop, by the phase of the push
    assert np.abs(dq).max() < 0.05, "it comes to rest"


def test_a_wall_keeps_a_joint_from_its_end_stop() -> None:
    start = np.array([-0.35, 1.35, -0.33])  # the elbow ends at 1.62
    run = FloatRun(CELL, q_start=start, hand=pushed((0.0, 0.0, -1.5), 0.1, 0.8), until_s=1.0)
    q, _ = part(run, 0.0, 1.0)
    assert 1.5 < q[:, 1].max() < 1.65
    assert modes(run) == ["FLOAT"]


def test_an_arm_beyond_its_limits_gets_no_torque() -> None:
    run = FloatRun(CELL, q_start=np.array([-0.35, 1.7, -0.33]), until_s=0.2)
    assert isinstance(run.one.error, FloatError)
    assert "arm left: joint elbow: found 1.70 rad" in str(run.one.error)
    assert "by hand (servos of `coop emulate`: start that anew)" in str(run.one.error), "where no hand reaches"
    assert not len(run.one.rows)


@pytest.mark.fault("S1")
def test_a_silent_bus_gets_the_weight_then_nothing_and_the_loop_ends_as_lost() -> None:
    silence = Fault(kind=FaultKind.MUTE, arm="left", start_s=0.3, duration_s=60.0)
    run = FloatRun(CELL, faults=[silence], stop_s=60.0)
    rows = run.one.rows
    assert run.one.summary is not None
    assert run.one.summary.mode is Mode.FAULT
    assert modes(run)[:2] == ["FLOAT", "STAND"]
    blind = rows[(rows["flags"] & int(Flag.BLIND)) != 0]
    before = rows[rows["t"] < 0.29][-1]["tau_limited"][:3]
    assert np.allclose(blind["tau_limited"][5, :3], before, atol=0.1), "its weight"
    assert rows["t"][np.isfinite(rows["tau_sent"][:, 0])][-1] < 0.3 + 0.25, "then silence, for the watchdogs"


def test_an_arm_without_a_guard_whose_process_is_killed_keeps_its_torque_for_a_fifth_of_a_second_and_falls() -> None:
    run = FloatRun(CELL, dies_s=0.3)
    assert run.one.error is None
    (q0, _), (before, _), (after, fell) = part(run, 0.25, 0.3), part(run, 0.3, 0.48), part(run, 0.52, 1.3)
    assert np.abs(before - q0[-1]).max() < 0.01, "its weight is still carried"
    assert np.abs(after[-1] - q0[-1]).max() > 0.5
    assert np.abs(fell).max() > 2.0, "rad/s: nobody guards it"


@pytest.mark.fault("P1")
def test_a_guard_lets_an_arm_down_whose_process_is_killed() -> None:
    low = np.array([-0.35, 1.4, -0.33])
    run = FloatRun(CELL, dies_s=0.3, guarded=True, q_start=low, hand=pushed((0.0, 0.0, 1.5), 0.1, 0.3))
    arm = run.one
    assert arm.error is None
    assert arm.summary is not None
    assert arm.summary.mode is Mode.OFF
    assert modes(run) == ["FLOAT", "STAND", "SINK"]
    rows, (q0, dq0), (q1, dq1) = arm.rows, part(run, 0.25, 0.3), part(run, 0.3, 0.5)
    assert np.abs(dq0[-1]).max() > 0.1, "it moved"
    assert np.abs(q1 - q0[-1]).max() < 0.1
    assert np.abs(dq1[-1]).max() < 0.3 * np.abs(dq0[-1]).max(), "it brakes"
    assert np.array_equal(rows["sequence"], np.arange(len(rows)))
    stood = rows[rows["mode"] == Mode.STAND]
    assert stood["t"][0] - rows["t"][rows["mode"] == Mode.FLOAT][-1] < 0.025, "s without a torque of its own"
    bounds = np.array(arm.loop._agent.limits.tau_step_max_Nm)  # type: ignore[union-attr]
    assert np.all(np.abs(np.diff(rows["tau_limited"][:, :3], axis=0)) <= bounds + 1e-9)
    assert arm.texts.said.index(STANDS) < arm.texts.said.index(SINKS)
    servos = [run.emulated.arms[0].servo(i) for i in range(1, 8)]
    assert not any(servo.firmware.memory.get(TORQUE_ENABLE) for servo in servos)


def test_an_error_of_the_loop_itself_lets_the_arm_sink_and_is_raised() -> None:
    def break_it(run: FloatRun) -> None:
        loop: Any = run.one.loop
        servos = loop._servos

        class Bad:
            def beat(self) -> None:
                loop._servos = servos
                raise RuntimeError("a defect")

        loop._servos = Bad()

    run = FloatRun(CELL, at=[(0.3, break_it)], q_start=np.array([-0.35, 1.6, -0.33]))
    assert isinstance(run.one.error, RuntimeError)
    assert modes(run) == ["FLOAT", "STAND", "SINK"]
    assert any("the loop failed: RuntimeError: a defect" in text for text in run.one.texts.said)
    rows = run.one.rows
    assert np.array_equal(rows["sequence"], np.arange(len(rows)))
    assert np.abs(np.diff(rows["tau_limited"][:, :3], axis=0)).max() < 0.7, "no fall in between"


@pytest.mark.long  # tests/unit/process/test_float_others.py calibrates from the log of one that floats, too
def test_the_log_of_arms_that_floated_with_the_object_calibrates_their_cell(tmp_path: Path) -> None:
    off = (*LEVEL, *OFF)
    cell = floating_cell(FloatOptions(Path("two_wx200"), ("left", "right"), off, holding=True))

    def hand(_: FloatRun, t: float) -> Vector:
        return np.array([3.5 * np.sin(2.0 * t), 0.0, 2.5 * np.sin(3.0 * t), 0.0, 0.2 * np.sin(2.4 * t), 0.0])

    run = FloatRun(cell, hand=hand, until_s=5.0)
    for name, arm in run.arms.items():
        assert arm.error is None, name
        assert set(arm.rows["mode"].tolist()) == {Mode.FLOAT}
        assert np.abs(arm.rows["tau_object"]).max() > 0.05
        assert any(text.startswith("gripper holds the object") for text in arm.texts.said)
    logs = []
    for name, arm in run.arms.items():  # each on a host of its own, whose cell lets that arm float
        own = floating_cell(FloatOptions(Path("two_wx200"), (name,), off, holding=True))
        (tmp_path / name).mkdir()
        logs.append(write_run(tmp_path / name / "run.mcap", own, {name: arm.rows}))
    found = calibrate(logs, ["tolerance.base_m=0.01", "tolerance.zeros_rad=0.017"])
    before_m, after_m, _, after_rad = found.judged
    assert before_m > 2.5e-3
    assert after_m < 0.25e-3, "what the pads give under the hand is left"
    assert after_rad < 1e-3
    written = load_cell(write(found, logs, tmp_path / "new").cell)
    assert written.file.floating is None, "arms of the new cell work"


class Clock:
    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        return self.ns


def test_what_ends_follows_from_time_and_speed() -> None:
    class Tell:
        def event(self, level: Level, text: str) -> None:
            said.append((level, text))

    said: list[tuple[Level, str]] = []
    clock, stopped = Clock(), []
    tell: Any = Tell()
    ending = Ending(lambda: bool(stopped), tell, clock, sink_s=3.0, period_s=0.1)

    def after(seconds: float, fastest: float) -> Event:
        """What the last of cycles says that brought this speed; of the others none says anything."""
        for left in range(round(10.0 * seconds) - 1, -1, -1):
            clock.ns += 100_000_000
            found = ending.events(fastest)
            assert found is Event.NONE or not left
        return found

    assert after(0.1, 2.0) is Event.NONE
    stopped.append(1)
    assert after(0.1, 0.0) is Event.STOP
    ending.mode(Mode.STAND)
    assert after(0.1, 0.0) is Event.NONE
    assert after(0.3, float("nan")) is Event.NONE, "nobody sees it"
    assert after(0.1, 0.0) is Event.RELEASED
    ending.mode(Mode.SINK)
    assert said == [(Level.WARN, STANDS), (Level.WARN, SINKS)]
    assert after(2.8, 0.01) is Event.NONE, "the weight is not gone yet"
    assert after(1.0, float("nan")) is Event.NONE
    assert after(0.1, 0.01) is Event.NONE, "nor is it by cycles that nobody saw"
    assert after(0.3, 0.2) is Event.NONE, "it moves"
    assert after(0.3, 0.01) is Event.NONE, "not for long enough"
    assert after(1.0, float("nan")) is Event.NONE, "nobody sees it"
    assert after(0.2, 0.01) is Event.ARRIVED
    clock.ns += 30_000_000_000
    assert after(0.1, 0.2) is Event.ARRIVED, "at last"


@pytest.mark.fault("P7")
@pytest.mark.parametrize("asked", [False, True])
def test_an_arm_that_floats_stops_when_its_guard_is_gone_and_says_so_unless_somebody_had_asked_it_to(
    asked: bool,
) -> None:
    told = iter(["", "the guard hangs", ""])
    guard: Any = SimpleNamespace(poll=lambda: next(told))
    stops = floats.Stops(lambda: asked, guard)
    assert [stops() for _ in range(3)] == [asked, True, asked]
    assert stops.unasked == ("" if asked else "the guard hangs")
    assert floats.Stops(lambda: asked, None)() is asked


@pytest.mark.parametrize(
    ("changes", "said", "told"),
    [
        ((), {"arms": ('left"',)}, """--arm: found 'left"', expected left or right; name arms of the cell"""),
        ((), {"arms": ("",)}, "--arm: found '', expected left or right"),
        (("floating.holding = false",), {"holding": True}, "--holding: found --set floating.holding = false beside it"),
        (("floating.holding=true",), {"others_move": True}, "--others-move: found --set floating.holding=true beside"),
        (("floating . others_move=false",), {"others_move": True}, "--others-move: found --set floating . others_move"),
        (('floating.arms=["right"]',), {}, "--arm: found --set floating.arms="),
        (("floating.drag_per_s=5.0\n[session]",), {}, "floating.drag_per_s in "),
        (("floating.drag_per_s",), {}, "override: found 'floating.drag_per_s', expected key.path=value"),
    ],
    ids=lambda value: "; ".join(value) if isinstance(value, tuple) else "",
)
def test_what_options_and_settings_say_of_floating_is_told_by_their_words(
    tmp_path: Path, changes: tuple[str, ...], said: dict[str, Any], told: str
) -> None:
    kept = tmp_path / "kept.toml"  # a cell whose file has the table
    kept.write_text((configs.CELLS_DIR / "two_wx200.toml").read_text() + '\n[floating]\narms = ["right"]\n')
    for cell in (Path("two_wx200"), kept):
        with pytest.raises(Refusal) as refused:
            floating_cell(FloatOptions(**{"cell": cell, "arms": ("left",), "overrides": changes, **said}))
        assert told in str(refused.value)


def test_of_two_settings_the_later_counts_as_it_does_anywhere() -> None:
    twice = ("floating.drag_per_s=7.0", "floating.drag_per_s=8.0")
    spec = floating_cell(FloatOptions(Path("two_wx200"), ("left",), twice)).file.floating
    assert spec is not None
    assert spec.drag_per_s == 8.0


def test_a_cell_floats_as_asked_and_an_arm_that_works_does_not() -> None:
    cell = floating_cell(FloatOptions(Path("two_wx200"), ("right",), holding=True))
    assert cell.file.floating is not None
    assert (cell.file.floating.arms, cell.file.floating.holding) == (["right"], True)
    assert cell.toml.startswith((configs.CELLS_DIR / "two_wx200.toml").read_bytes().rstrip()), "comments and all"
    fast = FloatOptions(Path("two_wx200"), ("left",), ("floating.drag_per_s=7.0", "rate_hz=210.0"))
    changed = floating_cell(fast).file
    assert changed.floating is not None
    assert (changed.floating.drag_per_s, changed.floating.arms, changed.rate_hz) == (7.0, ["left"], 210.0)
    with pytest.raises(FloatError, match="coop float --arm left"):
        Floats.of(cell, "left")
    for arms, said in (
        ((), "found none, expected --arm NAME; name left"),
        (("lft",), "--arm: found 'lft', expected left"),
    ):
        with pytest.raises(FloatError, match=said) as refused:
            floating_cell(FloatOptions(Path("two_wx200"), arms))
        assert refused.value.exit_code == 2, "a mistake of the command line, as an arm that no command knows"
    stop: Any = lambda: False  # noqa: E731
    asked: Any = SimpleNamespace(arm="right", driver=DriverKind.DYNAMIXEL, guard=None, whole=True)
    with pytest.raises(FloatError, match="found --whole, expected no session"):
        floats.run_float(cell, asked, stop, lambda _: None)
    asked.driver = DriverKind.SIM
    with pytest.raises(FloatError, match="driver sim"):
        floats.run_float(cell, asked, stop, lambda _: None)
    servos = Floats.of(cell, "right").servos("virtual")
    borne = [patient(servos, Connection(emulated=emulated)).line_patience_cycles for emulated in (False, True)]
    assert borne == [0, 100], "half a second, of a host that stalls, and of no real line"
    assert {j.name for j in servos.joints if j.start_rad is not None} == {"waist", "wrist_rotate"}
