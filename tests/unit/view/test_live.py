"""What a live page takes from the network, and what it leaves out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.config.files import CellFiles, load_files
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.view_run import view_log

pytest.importorskip("viser", reason="the extra `view` is not installed")

from agent.modes import Mode
from agent.view import live
from agent.view.drawing import drawing_of_cell
from agent.view.live import CURVES_SENT_S, EVENTS_SHOWN, SILENT_S, Intake, LivePage, LiveReport, _start
from agent.view.motion import Motion, motion_now
from agent.view.scene import OBJECT
from agent.view.server import Server
from agent.view.staged import modes_at, status_text

LEFT = "coop/paper/left/state"


@pytest.fixture(scope="module")
def cell() -> CellFiles:
    return load_files(Path("paper"))


def rows(count: int = 3, **changes: float) -> np.ndarray:
    found = view_log(0.1).agents["left"][:count].copy()
    for name, value in changes.items():
        found[name] = value
    return found


def test_the_newest_row_of_a_batch_is_kept(cell: CellFiles) -> None:
    intake = Intake(cell)
    assert not intake.news.is_set()
    intake.put(LEFT, rows().tobytes())
    assert intake.news.is_set()
    found = intake.latest()
    assert not intake.news.is_set()
    assert list(found) == ["left"]
    assert found["left"]["sequence"].tolist() == [2]
    intake.put("coop/paper/plant/state", view_log(0.1).plant[:4].tobytes())  # type: ignore[index]
    assert intake.latest()["plant"]["sequence"].tolist() == [3]
    assert intake.refused == 0


@pytest.mark.parametrize(
    "payload",
    [rows().tobytes()[:-1], b"x" * AGENT_STATE.dtype.itemsize, rows(joint_count=4).tobytes(), rows(20).tobytes() * 20],
    ids=["cut", "no CDR", "another arm", "too large"],
)
def test_what_is_no_row_of_the_arm_is_refused_and_counted(cell: CellFiles, payload: bytes) -> None:
    intake = Intake(cell)
    intake.put(LEFT, payload)
    assert intake.latest() == {}
    assert intake.refused == 1


def test_keys_of_others_and_marks_of_an_end_are_passed_over(cell: CellFiles) -> None:
    intake = Intake(cell)
    for key in (
        "coop/other/left/state",
        "coop/paper/middle/state",
        "coop/paper/left/health",
        "coop/paper/recorder/status",
    ):
        intake.put(key, rows().tobytes())
    intake.put(LEFT, b"")
    assert intake.latest() == {}
    assert intake.refused == 0


def test_rows_of_a_changed_cell_are_taken_and_told(cell: CellFiles) -> None:
    intake = Intake(cell)
    intake.put(LEFT, rows(config_id=cell.config_id).tobytes())
    assert not intake.other_cell
    intake.put(LEFT, rows(config_id=7).tobytes())
    assert intake.other_cell
    assert list(intake.latest()) == ["left"]


def test_the_last_events_are_kept(cell: CellFiles) -> None:
    intake = Intake(cell)
    for number in range(10):
        intake.put("coop/paper/left/event", Event(number, "left", Level.INFO, f"word {number}").to_json())
    intake.put("coop/paper/left/event", b"no event")
    assert [event.text for event in intake.events] == [f"word {n}" for n in range(10 - EVENTS_SHOWN, 10)]
    assert intake.refused == 1


def test_the_lag_is_told_where_rows_carry_the_walls_time() -> None:
    assert LiveReport(10, (), 0).behind == ""
    assert LiveReport(10, (0.1, 0.2, -5.0), 0).behind == LiveReport(10, (0.1, 0.2, 5.0), 0).behind == ""
    assert LiveReport(10, tuple(0.001 * n for n in range(101)), 0).behind == ", 50 ms behind (99 %: 99 ms)"


def test_the_page_moves_with_the_rows_and_its_curves_begin_again_with_another_run(cell: CellFiles) -> None:
    log = view_log()

    def at(row: int) -> Motion:
        motion = motion_now({n: r[row : row + 1] for n, r in log.agents.items()}, log.plant[row : row + 1])  # type: ignore[index]
        assert motion is not None
        return motion

    server = Server(18400, "test")
    try:
        page = LivePage(server, drawing_of_cell(cell), _start(cell))
        page.show(at(0), [], "", 10.0)
        page.show(at(300), [Event(1, "left", Level.WARN, "a word")], "a note", 10.0 + 2 * CURVES_SENT_S)
        assert np.asarray(page._nodes._nodes[OBJECT].position) == pytest.approx(log.plant["p_object"][300])  # type: ignore[index]
        assert page._words.content == "**t = 1.5 s · TRACK**\n\na note\n\n- left: a word"
        assert len(page._plots) == 4
        assert page._plots[0]._handle.data[0].tolist() == [0.0, 1.5]
        page.show(at(100), [], "", 20.0)
        assert [motion.t[0] for motion in page._past] == [0.5]
    finally:
        server.stop()


def test_an_arm_of_which_no_row_comes_is_said_to_have_none(cell: CellFiles, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dead arm was shown in TRACK for as long as somebody looked."""
    now = [100.0]
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    intake = Intake(cell)
    for name in ("left", "right"):
        intake.put(f"coop/paper/{name}/state", rows(mode=Mode.TRACK).tobytes())
    assert intake.silent() == frozenset()
    now[0] += SILENT_S + 0.1
    intake.put(LEFT, rows(mode=Mode.TRACK, utc_ns=2**62).tobytes())
    assert intake.silent() == {"right"}
    motion = motion_now(intake.latest(), None, intake.silent())
    assert motion is not None
    assert modes_at(motion, 0) == "left TRACK, right TRACK (no row)"


def test_rows_that_come_late_are_not_the_newest_unless_nothing_came_for_a_while(
    cell: CellFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder that is back gets what it missed; so does another run, after a moment."""
    now = [100.0]
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    intake = Intake(cell)
    new, old = rows(utc_ns=2_000_000_000, t=9.0), rows(utc_ns=1_000_000_000, t=3.0)
    for given, shown in ((old, 3.0), (new, 9.0), (old, 9.0)):
        intake.put(LEFT, given.tobytes())
        assert intake.latest()["left"]["t"][0] == shown
    now[0] += SILENT_S + 0.1
    intake.put(LEFT, old.tobytes())
    assert intake.latest()["left"]["t"][0] == 3.0


def test_another_cell_is_told_of_as_long_as_its_rows_come(cell: CellFiles) -> None:
    intake = Intake(cell)
    intake.put(LEFT, rows(config_id=1, utc_ns=1).tobytes())
    assert intake.other_cell
    intake.put(LEFT, rows(config_id=cell.config_id, utc_ns=2).tobytes())
    assert not intake.other_cell


def test_an_event_that_is_sent_again_is_shown_once(cell: CellFiles) -> None:
    intake = Intake(cell)
    event = Event(1, "left", Level.INFO, "torque on")
    for _ in range(2):
        intake.put("coop/paper/left/event", event.to_json())
    assert list(intake.events) == [event]


def test_before_a_start_no_time_is_said(cell: CellFiles) -> None:
    motion = motion_now({"left": rows(1, t=-86_397.6)}, None)
    assert motion is not None
    assert status_text(motion, 0).startswith("not started · ")
