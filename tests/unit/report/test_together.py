"""How the arms get along: shares, disagreement, what they notice, margins and bus errors, in figures and numbers."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D

from agent.control.against import NO_PULL
from agent.control.borne import Borne
from agent.control.knock import Struck
from agent.control.memory import initial
from agent.control.residual import nothing_sensed
from agent.log.read import RunLog
from agent.report import figures, figures_more, figures_together
from agent.report.gallery import pictures
from agent.report.labels import LINE_IN, end_labels, mark_moments, room_in
from agent.report.metrics import summarise
from agent.report.plotting import DASHES, PANEL_IN, line, panels, save_png, time_axis
from agent.report.prepared import prepare
from agent.report.tables import tables
from agent.report.together import Thresholds, thresholds
from agent.telemetry.row.event import Event, Level
from tests.support.telemetry.synthetic_run import paper_run
from tests.support.view_run import view_log


def log_with(**columns: float) -> RunLog:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    for rows in log.agents.values():
        rows["unexpected"] = rows["unexpected_wrench"] = np.nan
        for name, value in columns.items():
            rows[name][:] = value
    return log


def tell(log: RunLog, table: str, text: str) -> None:
    """Have the cell file say so in a table that it has."""
    before, after = log.attachments["cell.toml"], f"[{table}]\n{text}\n".encode()
    found = re.sub(rb"\[" + table.encode() + rb"\][^\n]*\nenabled = false\n", after, before)
    assert found != before
    log.attachments["cell.toml"] = found


def stems(log: RunLog) -> set[str]:
    return {picture.stem for picture in pictures(prepare(log))}


def labelled(ax: Axes) -> dict[str, np.ndarray]:
    return {
        str(c.get_label()): np.asarray(c.get_ydata()) for c in ax.get_lines() if not str(c.get_label()).startswith("_")
    }


def test_a_run_shows_what_it_has_and_no_empty_figure() -> None:
    always = {"load_share", "disagreement", "margins", "errors_rest"}
    assert always <= stems(log_with())
    assert not {"noticed", "bus"} & stems(log_with())
    assert {"noticed", "bus"} <= stems(log_with(unexpected=0.1, bus_timeouts=2))
    without = paper_run(Path("run.mcap"), duration_s=2.0, plant=False)
    assert not {"load_share", "errors_rest"} & stems(without)


def test_the_load_share_is_of_each_stretch() -> None:
    t = np.array([0.0, 0.4, 1.1, 1.2, 2.5, 2.6])
    at, share = figures_together.in_stretches(t, np.arange(6.0), np.array([1.0, 1.0, 2.0, 2.0, 0.0, 0.0]), 1.0)
    assert at == pytest.approx([0.2, 1.15, 2.55])
    assert share[:2] == pytest.approx([0.5, 1.25])
    assert np.isnan(share[2])


def test_the_load_share_of_both_arms_is_one() -> None:
    (ax,) = figures_together.load_share(prepare(log_with())).axes
    lines = labelled(ax)
    assert list(lines) == ["left", "right"]
    assert lines["left"] + lines["right"] == pytest.approx(np.ones(25))
    dotted = [c.get_ydata()[0] for c in ax.get_lines() if c.get_linestyle() == ":"]
    assert dotted == [0.5, 0.5]


def test_disagreement_is_the_distance_of_two_beliefs_and_the_shift_has_its_limit() -> None:
    log = view_log()
    tell(log, "controller.alignment", "max_m = 0.004")
    log.agents["right"]["p_object"][:, 1] += 2e-3
    log.agents["right"]["shift"][:, 0] = 3e-3
    run = prepare(log)
    upper, lower = figures_together.disagreement(run).axes
    assert labelled(upper)["left − right"] == pytest.approx(np.full(400, 2.0))
    assert labelled(lower)["right"] == pytest.approx(np.full(400, 3.0))
    assert labelled(lower)["limit"][0] == pytest.approx(4.0)
    assert len(figures_together.disagreement(prepare(view_log())).axes) == 1
    right = summarise(log).arms["right"]
    assert (right.shift_max_m, right.shift_max_rad) == (pytest.approx(3e-3), 0.0)


def test_what_an_arm_learns_of_its_friction_is_drawn_and_told() -> None:
    log = view_log()
    assert "friction" not in stems(log), "nobody has learned"
    before = summarise(log).arms
    log.agents["right"]["friction_factor"] = np.linspace(1.0, 1.31, 400)
    assert "friction" in stems(log)
    (ax,) = figures_together.friction(prepare(log)).axes
    assert labelled(ax)["left"] == pytest.approx(np.ones(400))
    assert labelled(ax)["right"] == pytest.approx(np.linspace(1.0, 1.31, 400))
    results = summarise(log)
    assert [results.arms[name].friction_factor for name in ("left", "right")] == [1.0, pytest.approx(1.31)]
    assert before["right"].friction_factor == 1.0
    (noticed,) = (table for table in tables(results) if table.title.startswith("Largest of what each arm noticed"))
    assert [row[noticed.header.index("friction, of its file's")] for row in noticed.rows] == ["1.00", "1.31"]


def test_thresholds_are_the_cells_and_none_without_a_table() -> None:
    log = view_log(0.1)
    assert np.isnan(vars_of(thresholds(log))).all()
    tell(log, "safety.noticing", "fast_N = 3.5")
    found = thresholds(log)
    assert found.fast_N == 3.5
    assert np.isnan(found.slow_Nm), "an older log does not say what was derived"
    run = json.loads(log.attachments.get("run.json", b"{}"))
    limits = {"fast_N": 3.5, "fast_Nm": 0.4, "slow_N": 1.2, "slow_Nm": 0.25}
    log.attachments["run.json"] = json.dumps(run | {"noticing": limits}).encode()
    assert vars_of(thresholds(log))[1:] == (3.5, 0.4, 1.2, 0.25)
    del log.attachments["run.json"]
    assert thresholds(log).fast_N == 3.5
    assert np.isnan(found.shift_m)
    log.attachments["cell.toml"] = b"no [ toml"
    assert np.isnan(thresholds(log).fast_N)
    del log.attachments["cell.toml"]
    assert np.isnan(thresholds(log).fast_N)


def vars_of(found: Thresholds) -> tuple[float, ...]:
    return found.shift_m, found.fast_N, found.fast_Nm, found.slow_N, found.slow_Nm


def test_what_an_arm_notices_is_shown_by_part_with_its_threshold() -> None:
    log = view_log()
    tell(log, "safety.noticing", "fast_N = 2.5\nslow_Nm = 0.3")
    for rows in log.agents.values():
        rows["unexpected"] = [2.0, 0.2, 1.0, 0.1]
    log.agents["left"]["unexpected"][7] = [4.0, 0.5, 3.0, 0.25]
    axes = figures_together.noticed(prepare(log)).axes
    assert [labelled(ax)["right"][0] for ax in axes] == [2.0, 1.0, 0.2, 0.1]
    assert [ax.get_title(loc="left") for ax in axes] == [
        "Unexpected force, fast part", "Unexpected force, slow part",
        "Unexpected moment, fast part", "Unexpected moment, slow part",
    ]  # fmt: skip
    assert labelled(axes[0])["holds above"][0] == 2.5
    assert labelled(axes[3])["holds above"][0] == 0.3
    assert "a touch below" not in labelled(axes[0]), "a cell or a log without that sense"
    run = json.loads(log.attachments.get("run.json", b"{}"))
    log.attachments["run.json"] = json.dumps(run | {"noticing_touch": {"most_N": 2.6}}).encode()
    sudden, *others = figures_together.noticed(prepare(log)).axes
    assert labelled(sudden)["a touch below"][0] == 2.6
    assert not any("a touch below" in labelled(ax) for ax in others)
    left = summarise(log).arms["left"]
    assert (left.unexpected_fast_max_N, left.unexpected_fast_max_Nm) == (4.0, 0.5)
    assert (left.unexpected_slow_max_N, left.unexpected_slow_max_Nm) == (3.0, 0.25)


def test_what_pulls_back_and_down_is_shown_where_the_run_has_limits_for_it() -> None:
    log = view_log()
    run = json.loads(log.attachments.get("run.json", b"{}"))
    for rows in log.agents.values():
        rows["unexpected"] = 0.1
    assert "pulled" not in stems(log), "arms of two have no such limits, nor do older logs"
    limits = {"level_N": 0.7, "climb_N": 0.1, "weight_N": 0.6}
    log.attachments["run.json"] = json.dumps(run | {"noticing_against": limits}).encode()
    assert "pulled" in stems(log)
    sense = nothing_sensed(3)._replace(pull=NO_PULL._replace(level_N=0.5, weight_N=0.4))
    log.agents["left"]["memory"][:] = initial(3)._replace(sense=sense).flatten()
    back, down = figures_together.pulled(prepare(log)).axes
    assert (labelled(back)["left"][5], labelled(down)["left"][5]) == (0.5, 0.4)
    assert (labelled(back)["holds above"][0], labelled(down)["holds above"][0]) == (0.7, 0.6)
    assert back.get_title(loc="left") == "Unexpected force against the motion", "a log whose limits do not grow"


def test_what_limits_that_grow_are_for_is_shown_over_the_slip() -> None:
    log = view_log()
    run = json.loads(log.attachments.get("run.json", b"{}"))
    limits = {
        "level_N": 0.7,
        "climb_N": 0.1,
        "weight_N": 0.6,
        "lifted_N": 0.8,
        "knock_N": 0.9,
        "load_N": 1.1,
        "stuck_N": 1.7,
    }
    log.attachments["run.json"] = json.dumps(run | {"noticing_against": limits}).encode()
    pull, struck = NO_PULL._replace(level_N=1.0, weight_N=-0.8), Struck(knock_N=1.2, slip=2.0)
    sense = nothing_sensed(3)._replace(pull=pull, struck=struck, borne=Borne(0.1, 0.5, 0.2, 1.3))
    for rows in log.agents.values():
        rows["memory"][:] = initial(3)._replace(sense=sense).flatten()
    back, down, blow, load, stuck = figures_together.pulled(prepare(log)).axes
    assert [labelled(ax)["left"][5] for ax in (back, down, blow, load, stuck)] == [0.5, -0.4, 0.6, 0.5, 1.3]
    assert [labelled(ax)["holds above"][0] for ax in (back, down, blow, load, stuck)] == [0.7, 0.6, 0.9, 1.1, 1.7]
    assert labelled(down)["holds below"][0] == -0.8
    assert not any("holds below" in labelled(ax) for ax in (back, blow, load, stuck))
    assert load.get_title(loc="left") == "Unexpected force down, with what friction bears", "whose limit does not grow"
    assert stuck.get_title(loc="left") == "Unexpected force down, with joints that stick"
    assert blow.get_title(loc="left") == "Unexpected force of a blow over the slip"


def test_margins_are_sigma_and_the_torque_of_the_most_loaded_joint() -> None:
    log = log_with(sigma_min=0.04, tau_sent=0.0)
    log.agents["left"]["tau_sent"][:, 2] = -0.5  # of 1.25; the others may give 3
    log.agents["left"]["tau_sent"][:, 0] = 0.6
    sigma, load = figures_together.margins(prepare(log)).axes
    assert np.ptp(labelled(sigma)["right"] - 0.04) == pytest.approx(0.0, abs=1e-12)
    assert labelled(load)["left"][5] == pytest.approx(40.0)
    assert summarise(log).arms["left"].load_max == pytest.approx(0.4)


def test_bus_errors_are_counted_by_kind() -> None:
    log = log_with()
    log.agents["right"]["bus_retries"][100:] = 3
    left, right = figures_together.bus(prepare(log)).axes
    assert labelled(left) == {}
    assert labelled(right)["retries"][[99, 100]].tolist() == [0.0, 3.0]


def test_errors_after_the_transient_have_a_scale_of_their_own() -> None:
    run = prepare(log_with())
    whole, rest = figures.errors(run).axes[0], figures.errors_rest(run).axes[0]
    assert rest.get_xlim() == (20.0, 25.0)
    assert rest.get_ylim()[1] < 0.2 * whole.get_ylim()[1]


def test_curves_without_a_style_differ_in_grey_too() -> None:
    _, (ax,) = panels(1)
    for colour in DASHES:
        line(ax, np.arange(5.0), np.ones(5), color=colour)
    line(ax, np.arange(5.0), np.ones(5), color="#005c9e")
    dashes = [str(c._dash_pattern) for c in ax.get_lines()]  # type: ignore[attr-defined]
    assert len(set(dashes)) == len(dashes)
    assert all(pattern[1] for pattern in DASHES.values())


def test_end_labels_stand_at_their_curves_and_apart_and_inside() -> None:
    _, (ax,) = panels(1)
    for name, value in (("low", 0.0), ("high", 10.0), ("near", 9.9)):
        ax.plot([0.0, 1.0], [value, value], label=name)
    end_labels(ax)
    heights = {text.get_text(): text.xy[1] for text in ax.texts}  # type: ignore[attr-defined]
    assert heights["low"] == pytest.approx(0.045, abs=0.01)
    assert heights["high"] - heights["near"] == pytest.approx(LINE_IN / PANEL_IN)
    assert heights["high"] == pytest.approx(1.0)


def test_a_name_beside_a_panel_has_the_look_of_its_curve_and_room() -> None:
    names = ["left", r"$e_\varepsilon$ z", "wrist rotate"]
    figure, (ax,) = panels(1, names_in=room_in(names))
    for number, name in enumerate(names):
        line(ax, np.arange(5.0), np.full(5, float(number)), color=list(DASHES)[number], label=name)
    end_labels(ax)
    renderer = FigureCanvasAgg(figure).get_renderer()
    inside, page = ax.get_window_extent(renderer), figure.bbox
    for text in ax.texts:
        where = text.get_window_extent(renderer)
        assert inside.x1 < where.x0, "beside the panel, where it hides no curve"
        assert where.x1 < page.x1, "and on the page"
    samples = [mark for mark in figure.artists if isinstance(mark, Line2D) and mark.get_linewidth() > 1.0]
    drawn = [
        [(c.get_color(), str(c._unscaled_dash_pattern)) for c in some]  # type: ignore[attr-defined]
        for some in (samples, ax.get_lines())
    ]
    assert drawn[0] == drawn[1]
    ends = [mark.get_ydata()[0] for mark in figure.artists if isinstance(mark, Line2D) and mark.get_linewidth() < 1.0]
    assert ends == pytest.approx([0.5 / 1.1 * (0.1 + number) for number in range(3)], abs=0.01), "a line from its end"


def test_names_leave_out_what_all_of_them_have() -> None:
    _, (ax,) = panels(1)
    ax.plot([0.0, 1.0], [0.0, 1.0], label="actual, seen by left")
    end_labels(ax, "actual, seen by ")
    assert [text.get_text() for text in ax.texts] == ["left"]


def test_moments_are_marked_on_time_axes_alone_and_named_once() -> None:
    figure, axes = panels(3, sharex=False)
    time_axis(axes[:2], 25.0)
    axes[2].set_xlim(0.0, 1.0)
    mark_moments(figure, [(5.0, "HOLD")])
    assert [[c.get_xdata()[0] for c in ax.get_lines()] for ax in axes] == [[5.0], [5.0], []]
    assert [[t.get_text() for t in ax.texts] for ax in axes] == [["HOLD"], [], []]


@pytest.mark.parametrize("height_in", [1.4, 1.75, 2.1])
@pytest.mark.parametrize(
    "text",
    [
        "holds: servo 4 of joint wrist_angle does not answer: no status packet within 12 ms, asked three times",
        "the wall clock was set by +3600 s, MMMM WWWW MMMM",
        "wrist_angle_of_an_arm_with_one_word_for_everything",
        "HOLD",
    ],
)
def test_a_long_warning_is_shortened_to_what_its_panel_has_room_for(height_in: float, text: str) -> None:
    figure, axes = panels(2, height_in=height_in)
    time_axis(axes, 25.0)
    mark_moments(figure, [(5.0, text)])
    (told,) = axes[0].texts
    save_png(figure)
    box, panel = told.get_window_extent(), axes[0].get_window_extent()
    assert panel.y0 <= box.y0
    assert box.y1 <= panel.y1
    shown = told.get_text()
    assert shown == text if len(text) < 10 else text.startswith(shown.removesuffix("…")) and len(shown) > 12
    assert shown.endswith("…") is (shown != text)


def test_a_part_of_the_run_has_the_moments_of_that_part() -> None:
    figure, axes = panels(1)
    time_axis(axes, 25.0, 20.0)
    mark_moments(figure, [(5.0, "HOLD"), (22.0, "stale")])
    assert [c.get_xdata()[0] for c in axes[0].get_lines()] == [22.0]


def test_a_hold_is_marked_in_the_figures_of_a_run() -> None:
    log = log_with()
    log.events.append(Event(1_800_000_000_000_000_000, "left", Level.ERROR, "mode TRACK → HOLD", {"t": 12.5}))
    drawn = {
        picture.stem: picture.draw()
        for picture in pictures(prepare(log))
        if picture.stem in {"errors", "margins", "errors_start"}
    }
    told = {stem: [t.get_text() for t in figure.axes[0].texts].count("HOLD") for stem, figure in drawn.items()}
    assert told == {"errors": 1, "margins": 1, "errors_start": 0}


def test_internal_force_shows_what_the_arm_itself_finds() -> None:
    log = view_log()
    for rows in log.agents.values():
        rows["unexpected_wrench"] = np.nan
    name = "unexpected"
    assert all(name not in labelled(ax) for ax in figures_more.internal_force(prepare(log)).axes)
    log.agents["right"]["unexpected_wrench"] = [3.0, 4.0, 0.0, 1.0, 1.0, 1.0]
    force, _, other, moment = figures_more.internal_force(prepare(log)).axes
    assert name not in labelled(force)
    assert labelled(other)[name] == pytest.approx(np.full(400, 5.0))
    assert name not in labelled(moment)
    caption = {picture.stem: picture.caption for picture in pictures(prepare(log))}["internal_force"]
    assert "as the arm itself finds it" in caption
