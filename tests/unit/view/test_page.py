"""The page shows what is wished for last, plays at its pace, and serves this host alone."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.view import _serve_log
from agent.log.collect import LogError
from agent.log.scan import MAGIC
from agent.report.moments import Moment, around, marks, moments_of
from agent.report.prepared import prepare
from agent.telemetry.row.event import Event, Level
from agent.view.camera import Camera
from agent.view.curves import Curve, curves_of, thinned
from agent.view.error import ViewError
from agent.view.scene import DESIRED, OBJECT, Placed
from agent.view.staged import Staged, legend, stage
from tests.support.view_run import view_log

viser = pytest.importorskip("viser", reason="the extra `view` is not installed")

from viser import GuiEvent  # noqa: E402 (these need viser)

from agent.view.browser import Nodes  # noqa: E402 (these need viser)
from agent.view.html import VIEW_PX, write_html  # noqa: E402
from agent.view.player import CURVES_S, DRAG_S, EXAGGERATIONS, NOTHING, SPEEDS, WORDS_S, Player  # noqa: E402
from agent.view.plots import needle  # noqa: E402
from agent.view.server import Server  # noqa: E402

UTC_0 = 1_800_000_000_000_000_000


@cache
def staged() -> Staged:
    return stage(prepare(view_log()), 20.0)


@cache
def camera() -> Camera:
    return staged().camera(VIEW_PX)


@pytest.fixture
def server() -> Iterator[Server]:
    found = Server(18300, "test")
    yield found
    found.stop()


def test_a_stop_waits_for_no_connection(capfd: pytest.CaptureFixture[str]) -> None:
    """One client says nothing, one went away without a word; left to itself the server waits 10 s for the first."""
    found = Server(18320, "test")
    thread, loop = found._websock_server._server_thread, found._websock_server._background_event_loop
    assert thread is not None
    with socket.create_connection(("127.0.0.1", found.get_port())) as silent:
        while not getattr(loop, "_transports"):  # noqa: B009 (the stub has none) until it has been let in
            time.sleep(0.01)
        socket.create_connection(("127.0.0.1", found.get_port())).close()
        found.stop()
        assert not thread.is_alive()
        with contextlib.suppress(ConnectionResetError):
            assert silent.recv(1) == b""
    assert capfd.readouterr() == ("", "")


class Clock:
    """Time by hand."""

    def __init__(self) -> None:
        self.s = 0.0  # what is added to it is then exactly what has passed

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def player(server: Server, clock: Clock) -> Player:
    nodes = Nodes(server, staged().scene, camera())
    found = Player(server, nodes, staged(), [Moment(0.5, "left", "mode TRACK → HOLD", True)], clock)
    found.step()
    return found


class Waits(threading.Condition):
    """Waits for nothing, and remembers for how long it should have; `told`: how often somebody was to be woken."""

    def __init__(self) -> None:
        super().__init__()
        self.s: list[float | None] = []
        self.told = 0

    def wait(self, timeout: float | None = None) -> bool:
        self.s.append(timeout)
        return False

    def notify(self, n: int = 1) -> None:
        self.told += n


class Marks:
    """In place of a plot: the times at which its needle was put."""

    def __init__(self) -> None:
        self.t: list[float] = []

    def mark(self, t: float) -> None:
        self.t.append(t)


def place(player: Player, name: str) -> np.ndarray:
    return np.asarray(player._nodes._nodes[name].position)


def test_the_first_picture_is_the_start(player: Player) -> None:
    assert player.pictures == 1
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[0, :3])
    assert "t = 0.0 s · TRACK" in player._words.content


def test_the_slider_goes_over_the_run_in_steps_of_a_picture(player: Player) -> None:
    slider = player._slider
    assert (slider.min, slider.max, slider.step, slider.value) == (0.0, pytest.approx(1.95), 0.05, 0.0)
    assert [mark.label for mark in slider._marks or ()] == ["HOLD"]


def test_a_part_of_two_pictures_has_its_own_steps(server: Server, clock: Clock) -> None:
    part = stage(prepare(view_log()), 20.0, 0.5, 0.6)
    slider = Player(server, Nodes(server, part.scene, part.camera(VIEW_PX)), part, [], clock)._slider
    assert (slider.min, slider.max, slider.step) == (0.5, pytest.approx(0.55), 0.05)


def test_a_run_of_one_picture_has_a_slider_too(server: Server, clock: Clock) -> None:
    log = view_log(plant=False)
    log.agents.update({name: rows[:1] for name, rows in log.agents.items()})
    single = stage(prepare(log), 20.0)
    found = Player(server, Nodes(server, single.scene, single.camera(VIEW_PX)), single, [], clock)
    found.step()
    assert (found.pictures, found._slider.min, found._slider.max, found._slider.step) == (1, 0.0, 1.0, 1.0)
    found._toggle()
    found.step()
    assert found._play.label == "Play", "it is at its end at once"


def test_what_a_person_moves_is_wished_for_and_what_the_run_moves_is_not(player: Player) -> None:
    (moved,) = player._slider._impl.update_cb
    player._slider.value = 0.5
    moved(GuiEvent(client=None, client_id=None, target=player._slider))
    player.step()
    assert player.pictures == 1
    person: Any = object()
    moved(GuiEvent(client=person, client_id=1, target=player._slider))
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[10, :3])


def tell(handle: Any) -> None:
    """What viser does when a person has changed a control."""
    for told in handle._impl.update_cb:
        told(GuiEvent(client=None, client_id=None, target=handle))


def test_the_button_plays_and_pauses(player: Player) -> None:
    tell(player._play)
    assert (player._play.label, player._started is None) == ("Pause", False)
    tell(player._play)
    assert (player._play.label, player._started is None) == ("Play", True)


def test_what_it_shows_is_explained_beside_it(player: Player, server: Server) -> None:
    words = [getattr(handle, "content", "") for handle in server.gui._gui_input_handle_from_uuid.values()]
    words += [
        getattr(handle, "content", "") for handle in server.gui._container_handle_from_uuid["root"]._children.values()
    ]
    assert legend(staged().scene) in words


def test_an_event_is_gone_to_and_nothing_is_no_event(player: Player, server: Server, clock: Clock) -> None:
    assert player._go_to.options == (NOTHING, "0.500 s left: mode TRACK → HOLD")
    assert player._go_to.visible
    player._go_to._impl.value = "0.500 s left: mode TRACK → HOLD"
    tell(player._go_to)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[10, :3])
    player._go_to._impl.value = NOTHING
    tell(player._go_to)
    assert player._wanted_s is None
    quiet = Player(server, Nodes(server, staged().scene, camera()), staged(), [], clock)
    assert not quiet._go_to.visible


def test_errors_are_enlarged_by_the_control(player: Player) -> None:
    player._errors._impl.value = "10 times"
    tell(player._errors)
    player.step()
    apart = place(player, DESIRED) - place(player, OBJECT)
    assert apart == pytest.approx(10.0 * (staged().placed.poses[DESIRED][0, :3] - staged().motion.object[0, :3]))


def test_the_controls_do_what_they_say() -> None:
    assert [float(Fraction(said)) for said in SPEEDS] == list(SPEEDS.values())
    as_is, *enlarged = EXAGGERATIONS.items()
    assert as_is == ("as they were", 1.0)
    assert [said for said, _ in enlarged] == [f"{factor:.0f} times" for _, factor in enlarged]


def test_enlarged_errors_are_shown_at_the_time_that_was_shown_and_a_wish_leaves_the_slider_to_the_hand(
    player: Player,
) -> None:
    player.want(0.5)
    player.step()
    assert player._slider.value == 0.0
    player._exaggerate(10.0)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[10, :3])


def test_the_newest_wish_is_shown_and_what_lies_half_the_way_to_it_before(player: Player) -> None:
    for t in (0.3, 0.9, 1.5):
        player.want(t)
    player.step()
    assert player.pictures == 2
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[15, :3])
    player.step()
    assert player.pictures == 3
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[30, :3])
    assert place(player, "arms/left/elbow") == pytest.approx(staged().placed.poses["arms/left/elbow"][30, :3])
    player.step()
    assert player.pictures == 3


@pytest.mark.parametrize(("first", "second", "after_s"), [(0.5, 1.5, 0.2), (0.5, 0.55, 0.0)])
def test_no_way_is_shown_to_what_is_not_of_a_drag_or_near(
    player: Player, clock: Clock, first: float, second: float, after_s: float
) -> None:
    for t in (first, second):
        player.want(t)
        player.step()
        assert place(player, OBJECT) == pytest.approx(staged().motion.object[round(20 * t), :3])
        clock.s += after_s


def test_a_wish_is_not_waited_for_and_the_end_of_a_way_comes_half_a_browsers_step_later(player: Player) -> None:
    player._wish = waits = Waits()
    player.step()
    assert waits.s == [1.0 / 30.0]
    player.want(0.2)
    player.want(1.8)
    assert waits.told == 2
    player.step()
    assert waits.s == [1.0 / 30.0], "it is shown at once"
    player.step()
    player.step()
    assert waits.s == [1.0 / 30.0, 0.025, 1.0 / 30.0]
    player._exaggerate(10.0)
    assert waits.told == 3
    player.step()
    assert len(waits.s) == 3


def test_what_is_shown_already_is_not_shown_again(player: Player) -> None:
    player.want(0.01)
    player.step()
    assert player.pictures == 1
    player._exaggerate(10.0)
    player.step()
    assert player.pictures == 2


def test_who_pauses_while_the_next_picture_is_chosen_has_paused(player: Player, clock: Clock) -> None:
    player._toggle()
    clock.s += 0.5

    asked: list[float] = []

    def pauses() -> float:
        asked.append(clock())
        if len(asked) == 1:
            player._toggle()
        return clock()

    player._now = pauses
    player.step()
    assert (player._started, player._play.label) == (None, "Play")


def test_a_newer_wish_ends_the_way_to_the_one_before(player: Player) -> None:
    player.want(0.2)
    player.step()
    player.want(1.8)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[20, :3])
    player.want(0.6)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[16, :3])
    player._exaggerate(10.0)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[12, :3])


def test_playing_goes_on_from_where_a_drag_is(player: Player, clock: Clock) -> None:
    player.want(0.2)
    player.want(1.0)
    player.step()
    player._toggle()
    clock.s += 0.1
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[12, :3])
    for t in (1.2, 1.8):
        player.want(t)
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[36, :3]), "what plays shows no way between"


def test_it_plays_at_the_pace_of_the_run_and_ends(player: Player, clock: Clock) -> None:
    player._toggle()
    clock.s += 0.5
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[10, :3])
    assert player._slider.value == pytest.approx(0.5)
    assert "mode TRACK → HOLD" in player._words.content
    player._speed.value = "4"
    clock.s += 0.1
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[18, :3])
    clock.s += 100.0
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[-1, :3])
    assert player._play.label == "Play"
    clock.s += 1.0
    shown = player.pictures
    player.step()
    assert player.pictures == shown
    player._toggle()  # from the end it begins again
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[0, :3])


def test_it_pauses_where_it_is_and_a_wish_moves_the_playing(player: Player, clock: Clock) -> None:
    player._toggle()
    clock.s += 0.5
    player.step()
    player._toggle()
    clock.s += 0.5
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[10, :3])
    player._toggle()
    player.want(1.0)
    clock.s += 0.25
    player.step()
    player.step()
    assert place(player, OBJECT) == pytest.approx(staged().motion.object[25, :3])


def test_errors_are_enlarged_on_request(player: Player) -> None:
    player._exaggerate(10.0)
    player.step()
    apart = place(player, DESIRED) - place(player, OBJECT)
    assert apart == pytest.approx(10.0 * (staged().placed.poses[DESIRED][0, :3] - staged().motion.object[0, :3]))


def test_the_curves_follow_now_and_then(player: Player, clock: Clock) -> None:
    before = player._plots[0]._handle.data
    player.want(1.0)
    player.step()
    assert player._plots[0]._handle.data is before
    clock.s += 2 * CURVES_S
    player.want(1.5)
    player.step()
    peak = np.nanargmax(player._plots[0]._handle.data[-1])
    assert player._plots[0]._handle.data[0][peak] == pytest.approx(1.5)


def test_the_needle_is_put_once_to_a_picture_and_not_before_its_time(player: Player, clock: Clock) -> None:
    player._plots[:] = [marks := Marks()]  # type: ignore[list-item]
    player.want(0.5)
    for at_s, t in ((0.29, []), (0.3, [0.5]), (0.3, [0.5]), (0.6, [0.5]), (0.9, [0.5])):
        clock.s = at_s
        player.step()
        assert marks.t == t
    player.want(1.0)
    player.step()
    assert marks.t == [0.5, 1.0]
    player.want(0.5)
    for at_s, count in ((1.1, 2), (1.3, 3)):
        clock.s = at_s
        player.step()
        assert len(marks.t) == count, "0.3 s after the last"


def test_the_text_is_told_at_its_time_and_of_no_picture_that_is_about_to_be_drawn_anew(
    player: Player, clock: Clock
) -> None:
    player.want(0.6)
    for at_s, t in ((0.14, 0.0), (0.15, 0.6)):
        clock.s = at_s
        player.step()
        assert player._words.content.startswith(f"t = {t} s")
    clock.s = 9.0
    player._exaggerate(10.0)
    player._follow(clock())
    assert player._words.content.startswith("t = 0.6 s")


def test_the_text_follows_a_while_later_and_ends_at_the_picture(player: Player, clock: Clock) -> None:
    for t in (0.3, 0.6):
        player.want(t)
        player.step()
        assert player._words.content.startswith("t = 0.0 s")
    clock.s += DRAG_S
    player.step()
    assert player._words.content.startswith("t = 0.6 s")


def test_text_and_curves_follow_a_drag_half_as_often_and_its_end_as_ever(player: Player, clock: Clock) -> None:
    def drag(t: float) -> None:
        player.want(t)
        player.step()
        player.step()

    clock.s += 1.0
    drag(0.2)
    assert player._words.content.startswith("t = 0.2 s")
    clock.s += 1.05 * WORDS_S
    drag(0.5)
    assert player._words.content.startswith("t = 0.2 s")
    clock.s += 1.05 * WORDS_S
    drag(0.9)
    assert player._words.content.startswith("t = 0.7 s"), "half the way"
    clock.s += 1.05 * DRAG_S
    player.step()
    assert player._words.content.startswith("t = 0.9 s"), "the hand rests"


def test_a_scene_without_a_title_has_no_text_in_the_picture(server: Server) -> None:
    nodes = Nodes(server, staged().scene, camera(), titled=False)
    nodes.show(staged().placed, 3, "a text")
    assert nodes._label is None
    titled = Nodes(server, staged().scene, camera())
    titled.show(staged().placed, 3, "a text")
    assert titled._label is not None
    assert titled._label.text == "a text"


def test_it_listens_on_this_host_alone_and_opens_no_tunnel(server: Server) -> None:
    assert server.get_host() == "127.0.0.1"
    assert server.request_share_url() is None
    with socket.socket() as other:  # an address of this host that a server of all addresses would have
        assert other.connect_ex(("127.0.0.2", server.get_port())) != 0


def test_a_pose_that_is_no_number_moves_nothing(server: Server) -> None:
    nodes = Nodes(server, staged().scene, camera())
    poses = {name: at.copy() for name, at in staged().placed.poses.items()}
    poses[OBJECT][1] = np.nan
    broken = Placed(poses, {"wrench/left": np.full((2, 2, 3), np.nan)})
    nodes.show(broken, 0, "")
    nodes.show(broken, 1, "")
    assert np.asarray(nodes._nodes[OBJECT].position) == pytest.approx(poses[OBJECT][0, :3])
    assert not nodes._arrows["wrench/left"].visible


def test_one_html_file_holds_the_whole_run(tmp_path: Path) -> None:
    path = tmp_path / "view.html"
    assert write_html(prepare(view_log()), path) == 40
    page = path.read_text()
    assert page.lstrip().lower().startswith("<!doctype html")
    assert "__VISER_EMBED_DATA__" in page
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ViewError, match="No such file"):
        write_html(prepare(view_log()), tmp_path / "nowhere" / "view.html")


# ----------------------------------------------------------------------------------------------- what the page is told


def test_events_stand_at_their_time_on_the_runs_axis() -> None:
    log = view_log()
    log.events.extend([
        Event(UTC_0 + 1, "left", Level.INFO, "torque on", {}),
        Event(UTC_0 + 7, "left", Level.ERROR, "mode TRACK → HOLD", {"t": 1.25}),
        Event(UTC_0 + 9_000_000_000, "right", Level.INFO, "run ended in TRACK", {"ticks": 400, "wall_s": 9.0}),
        Event(UTC_0 - 7, "right", Level.WARN, "safety: stale", {"t": -0.5}),
    ])  # fmt: skip
    found = moments_of(prepare(log))
    assert [(m.t, m.source, m.grave) for m in found] == [
        (0.0, "left", False), (0.0, "right", True), (1.25, "left", True), (2.0, "right", False),
    ]  # fmt: skip
    assert found[2].line == "1.250 s left: mode TRACK → HOLD"
    assert found[1].line == "-0.500 s right: safety: stale", "it is shown at the start, and told as it was"
    assert [m.t for m in around(found, 2.0)] == [2.0, 1.25, 0.0, 0.0]
    assert [m.t for m in around(found, 4.5)] == [2.0]


def test_what_an_agent_tells_with_a_stamp_stands_where_its_rows_have_that_stamp() -> None:
    log = view_log()
    stamp_ns = int(log.agents["left"]["stamp_ns"][50])
    log.events.append(Event(UTC_0, "left", Level.INFO, "run ended", {"stamp_ns": stamp_ns, "ticks": 1, "wall_s": 9.0}))
    assert moments_of(prepare(log))[0].t == pytest.approx(float(log.agents["left"]["t"][50]), abs=1e-9)


def test_an_event_without_a_tick_stands_by_the_wall_where_the_run_kept_its_pace() -> None:
    log = view_log()
    for rows in log.agents.values():
        rows["utc_ns"] = UTC_0 + (rows["t"] * 1e9).astype(np.int64)
    log.events.extend([
        Event(UTC_0 + 500_000_000, "left", Level.WARN, "a word", {}),
        Event(UTC_0 + 2_000_000_000, "left", Level.INFO, "run ended", {"ticks": 400, "wall_s": 2.0}),
    ])  # fmt: skip
    assert moments_of(prepare(log))[0].t == pytest.approx(0.5)


def test_the_slider_shows_each_thing_once_and_apart() -> None:
    flood = [Moment(0.1 * i, "left", "safety: saturated", True) for i in range(100)]
    hold = Moment(5.0, "right", "mode TRACK → HOLD", True)
    told = Moment(8.0, "right", "torque on")
    assert marks([*flood, hold, told], 0.0, 10.0) == ((0.0, "saturated"), (5.0, "HOLD"))
    close = Moment(5.5, "left", "safety: singular", True)
    assert marks([hold, close], 0.0, 10.0) == ((5.0, "HOLD"),)
    written = Moment(5.0, "left", "EEPROM written (servo 1, waist): Operating Mode 3 → 5")
    assert not written.weighty
    assert marks([written, replace(written, grave=True, t=9.0), hold], 0.0, 10.0) == (
        (5.0, "HOLD"), (9.0, written.text),
    )  # fmt: skip


def test_curves_are_error_disagreement_and_forces() -> None:
    found = {curve.title: curve for curve in curves_of(staged().motion)}
    assert [curve.unit for curve in found.values()] == ["mm", "mm", "N", "N"]
    error = found["position error"].lines[0][1]
    assert error[0] == pytest.approx(1e3 * np.sqrt(0.001**2 + 0.003**2))
    assert found["arms disagree on the object by"].lines[0][0] == "left − right"
    assert found["internal force"].lines[0][1][0] == pytest.approx(1.5)


def test_arms_disagree_by_the_distance_of_their_beliefs_and_one_arm_with_nobody() -> None:
    log = view_log()
    log.agents["right"]["p_object"] = log.agents["left"]["p_object"] + [3e-3, 0.0, 4e-3]
    (apart,) = [c for c in curves_of(stage(prepare(log), 20.0).motion) if c.unit == "mm" and "disagree" in c.title]
    assert apart.lines[0][1] == pytest.approx(np.full(40, 5.0))
    assert log.plant is not None
    log.plant["contact_error_m"][100:, 1] = np.nan
    (opened,) = [c for c in curves_of(stage(prepare(log), 20.0).motion) if c.unit == "mm" and "disagree" in c.title]
    assert opened.lines[0][1] == pytest.approx([*[5.0] * 10, *[np.nan] * 30], nan_ok=True), (
        "empty grippers count no more"
    )
    del log.agents["right"]
    assert [c.title for c in curves_of(stage(prepare(log), 20.0).motion)] == [
        "position error", "commanded force", "internal force"
    ]  # fmt: skip


def test_a_thinned_curve_keeps_its_peaks_and_what_is_no_number_is_a_gap() -> None:
    t = np.arange(10_000) * 0.01
    values = np.sin(t)
    values[5432], values[77] = -7.0, np.nan
    found = thinned(Curve("x", "m", t, (("a", values),)), 100)
    assert len(found.t) == 100
    assert thinned(found, 100) is found
    assert len(thinned(Curve("x", "m", t, (("a", values),))).t) == 400
    assert found.lines[0][1].min() == -7.0
    assert np.isfinite(found.lines[0][1]).all()
    log = view_log()
    log.agents["left"]["wrench_cmd"][100:110] = np.inf
    log.agents["left"]["wrench_cmd"][150:160] = [1e6, 0.0, 0.0, 0.0, 0.0, 0.0]
    force = next(c for c in curves_of(stage(prepare(log), 20.0).motion) if c.title == "commanded force")
    assert np.isnan(force.lines[0][1][[10, 15]]).all()
    assert np.isfinite(force.lines[0][1][[9, 11, 14, 16]]).all()


def test_the_needle_stands_at_now() -> None:
    found = needle(np.arange(5.0), 2.3, 1.0, 9.0)
    assert np.isnan(found[[0, 4]]).all()
    assert found[1:4].tolist() == [1.0, 9.0, 1.0]
    assert needle(np.arange(5.0), -1.0, 1.0, 9.0)[:2].tolist() == [9.0, 1.0]


def test_the_legend_tells_the_scale_of_the_arrows() -> None:
    scale = next(a.metres for a in staged().scene.arrows if a.name == "internal/left")
    assert f"internal force, {100 * scale:.2g} cm for 1 N" in legend(staged().scene)


def test_the_browser_is_sent_to_a_page_that_answers_before_the_log_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, told = tmp_path / "run.mcap", list[str]()
    log.write_bytes(MAGIC)

    def serve(path: Path, server: Server, _stop: object, ready: Callable[[], None], say: Callable[[str], None]) -> int:
        assert (path, told) == (log, [server.address])
        assert b"<html" in urllib.request.urlopen(server.address).read()
        assert "READY" not in capsys.readouterr().out
        say("a word")
        ready()
        assert capsys.readouterr().out == f"READY page={server.address}\n"
        return 7

    monkeypatch.setattr("agent.view.open.serve", serve)
    monkeypatch.setattr("agent.cli.view._browse", told.append)
    _serve_log(log, 18310, True, lambda: False)
    assert "7 pictures shown" in capsys.readouterr().err
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(told[0])


def test_what_is_no_log_is_refused_before_a_browser_is_sent_anywhere(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    told = list[str]()
    monkeypatch.setattr("agent.cli.view._browse", told.append)
    (tmp_path / "run.mcap").write_bytes(b"something else")
    with pytest.raises(LogError, match="no MCAP file"):
        _serve_log(tmp_path / "run.mcap", 18311, True, lambda: False)
    assert told == []
