"""What must hold of every figure of a report: units on each axis, no peak lost, gaps visible."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agent.control.adaptation import JOINT_PARAMETERS
from agent.control.regressor import BODY_PARAMETERS
from agent.log.read import RunLog
from agent.report import figures, figures_more
from agent.report.figures_more import estimates, loop_timing, tail_of
from agent.report.figures_together import in_stretches
from agent.report.gallery import pictures
from agent.report.names import picture_files
from agent.report.plotting import DRAWN_MAX, UNDRAWN, drawable, in_columns, panels, unbroken
from agent.report.plotting import line as draw_line
from agent.report.prepared import prepare
from agent.report.report import write_report
from agent.report.series import DURATIONS
from tests.support.telemetry.synthetic_run import paper_run, spatial_run

RUNS = {
    "paper": lambda: paper_run(Path("run.mcap"), duration_s=25.0),
    "adaptive": lambda: paper_run(Path("run.mcap"), duration_s=25.0, adaptive=True),
    "no plant": lambda: paper_run(Path("run.mcap"), duration_s=25.0, plant=False),
    "six joints": lambda: spatial_run(Path("run.mcap"), duration_s=25.0),
}

BODY = ("mass", *("first moment",) * 3, *("inertia",) * 6)
OF_JOINTS = ("rotor inertia", "viscous friction", "Coulomb friction", "breakaway", "load friction", "breakaway load")


OFTEN = ("paper", "six joints")  # drawn by tests/unit/report/test_report.py, too


@dataclass(frozen=True)
class Drawn:
    """Every figure of a run, and the settings of matplotlib before and after they were drawn."""

    arms: list[str]
    figures: dict[str, Figure]
    before: dict[str, Any]
    after: dict[str, Any]


@pytest.fixture(
    scope="module",
    params=[pytest.param(run, id=name, marks=[pytest.mark.long] * (name in OFTEN)) for name, run in RUNS.items()],
)
def drawn(request: pytest.FixtureRequest) -> Drawn:
    run, before = prepare(request.param()), dict(mpl.rcParams)
    arms = [arm.name for arm in run.arms]
    return Drawn(arms, {picture.stem: picture.draw() for picture in pictures(run)}, before, dict(mpl.rcParams))


def test_every_figure_is_one_of_those_that_a_run_looks_for_in_its_folder(drawn: Drawn) -> None:
    assert {f"{stem}.png" for stem in drawn.figures} <= set(picture_files(drawn.arms))


def test_every_axis_of_every_figure_names_its_unit(drawn: Drawn) -> None:
    assert len(drawn.figures) > 10
    for stem, figure in drawn.figures.items():
        rows = {round(ax.get_position().x0, 3): ax for ax in figure.axes}  # the lowest panel of each column
        for ax in figure.axes:
            assert "[" in ax.get_ylabel(), stem
        for ax in rows.values():
            assert "[" in ax.get_xlabel(), stem


def test_every_figure_shows_something(drawn: Drawn) -> None:
    for stem, figure in drawn.figures.items():
        for ax in figure.axes:
            shown = [y for line in ax.lines for y in np.asarray(line.get_ydata(), dtype=float)]
            assert np.isfinite(shown).any(), f"{stem}: {ax.get_title()}"


def test_figures_leave_the_settings_of_matplotlib_alone(drawn: Drawn) -> None:
    assert drawn.after == drawn.before


def test_estimates_are_drawn_from_as_many_columns_as_the_law_has_of_a_body_and_of_a_joint() -> None:
    """Counted by the figures themselves: the law's module would bring the model of the arms into every report."""
    assert figures_more.BODY_PARAMETERS == BODY_PARAMETERS
    assert len(figures_more.JOINT_GROUPS) == JOINT_PARAMETERS


def test_a_run_without_rows_has_no_figures() -> None:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    assert pictures(prepare(replace(log, agents={}, plant=None))) == []


def test_desired_is_blue_and_actual_red_as_in_the_paper() -> None:
    figure = figures.pose(prepare(RUNS["paper"]()))
    for ax in figure.axes:
        desired, actual = ax.lines
        assert (desired.get_label(), actual.get_label()) == ("desired", "actual")
        blue, red = mpl.colors.to_rgb(desired.get_color()), mpl.colors.to_rgb(actual.get_color())
        assert blue[2] == max(blue)
        assert red[0] == max(red)


def test_a_single_peak_of_a_long_run_is_in_the_figure() -> None:
    log = RUNS["paper"]()
    assert log.plant is not None
    log.plant["p_object"][3001, 0] = 0.5
    top = figures.pose(prepare(log)).axes[0]
    assert top.dataLim.y1 == 0.5
    assert top.get_ylim()[1] > 0.5


def test_limits_are_drawn_only_when_a_torque_comes_near_them() -> None:
    log = RUNS["paper"]()

    def limits(ax: Axes) -> list[float]:
        return [line.get_ydata()[0] for line in ax.lines if len(line.get_ydata()) == 2]  # horizontal lines

    assert [limits(ax) for ax in figures.torques(prepare(log)).axes] == [[], []]
    log.agents["left"]["tau_cmd"][10, 0] = 2.9
    assert [limits(ax) for ax in figures.torques(prepare(log)).axes] == [[-3.0, 3.0], []]


def test_lateness_has_a_panel_only_where_a_cycle_began_late() -> None:
    log = RUNS["paper"]()
    timing = {picture.stem: picture for picture in pictures(prepare(log))}["loop_timing"]
    assert [ax.get_title(loc="left") for ax in timing.draw().axes] == [
        "Loop timing (left solid, right dashed)", "Lateness of each cycle"
    ]  # fmt: skip
    assert "how late each cycle began" in timing.caption
    for rows in log.agents.values():
        rows["late_s"] = 0.0
    timing = {picture.stem: picture for picture in pictures(prepare(log))}["loop_timing"]
    (tail,) = timing.draw().axes
    assert "No cycle began late" in timing.caption
    assert "began late" not in [text.get_text() for text in tail.texts]
    assert "control step" in [text.get_text() for text in tail.texts]


def test_a_duration_is_named_once_at_its_curve_and_the_title_tells_the_arms() -> None:
    (tail, _) = loop_timing(prepare(RUNS["paper"]())).axes
    names = sorted(text.get_text() for text in tail.texts)
    assert names == ["began late", "bus read", "bus write", "control step", "period"]
    assert tail.get_title(loc="left") == "Loop timing (left solid, right dashed)"
    step = next(text for text in tail.texts if text.get_text() == "control step")
    x, y = step.xy  # type: ignore[attr-defined]
    curve = next(c for c in tail.lines if c.get_color() == step.get_color() and c.get_linestyle() == "-")
    fraction = np.asarray(curve.get_ydata(), float)
    assert x in np.asarray(curve.get_xdata(), float)
    assert np.abs(fraction - y).min() == abs(fraction[list(np.asarray(curve.get_xdata(), float)).index(x)] - y)


def astray(log: RunLog) -> RunLog:
    """A run whose law went unstable half-way: immense, then infinite, then no number."""
    for rows in [*log.agents.values(), log.plant]:
        assert rows is not None
        half, some = len(rows) // 2, len(rows) // 10
        sign = 1.0 if rows is log.plant else -1.0  # the errors are immense, too
        for name in rows.dtype.names or ():
            if rows.dtype[name].base == np.dtype(np.float64) and name not in ("t", *DURATIONS):
                for number, value in enumerate((1e300, -1e308, -np.inf)):
                    rows[name][half + number * some : half + (number + 1) * some] = sign * value
                rows[name][half + 3 * some :] = np.nan
    return log


@pytest.mark.filterwarnings("error")
def test_a_run_that_went_astray_is_drawn_as_far_as_it_can_be_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = astray(RUNS["adaptive"]())
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [])  # they are looked at below, as they are drawn
    result = write_report(log, tmp_path).results
    assert any("pose that is not a number" in line for line in result.missing)
    drawn = {picture.stem: picture.draw() for picture in pictures(prepare(log))}
    for stem, figure in drawn.items():
        for ax in figure.axes:
            assert max(np.abs(ax.get_ylim())) < 2.0 * DRAWN_MAX, stem
    for stem in ("pose", "errors", "torques", "wrenches", "internal_force", "estimates_left", "margins"):
        assert [text.get_text() for text in drawn[stem].axes[0].texts].count(UNDRAWN) == 1, stem
    steady = figures.torques(prepare(RUNS["adaptive"]()))
    assert UNDRAWN not in [text.get_text() for ax in steady.axes for text in ax.texts]


def test_what_is_drawable_ends_at_a_bound() -> None:
    _, (ax,) = panels(1)
    values = np.array([1.0, DRAWN_MAX, -DRAWN_MAX, np.nan])
    assert drawable(ax, values) is values
    assert not ax.texts
    np.testing.assert_array_equal(drawable(ax, np.array([1.0, -2.0 * DRAWN_MAX, np.inf])), [1.0, np.nan, np.nan])
    assert len(ax.texts) == 1


def test_a_stretch_with_an_infinite_force_has_no_load_share() -> None:
    t = np.arange(4) * 0.5
    _, share = in_stretches(t, np.array([1.0, np.nan, np.inf, 1.0]), np.array([2.0, np.nan, np.inf, 2.0]), 1.0)
    np.testing.assert_array_equal(share, [0.5, np.nan])


# -------------------------------------------------------------------------------------------------------- estimates


def test_every_estimate_of_a_joint_has_the_panel_that_names_it() -> None:
    log = RUNS["adaptive"]()
    joints, k = 3, len(BODY) + len(OF_JOINTS)
    rows = log.agents["left"]
    rows["theta_arm"][:] = 0.0
    rows["theta_arm"][:, : k * joints] = 1.0 + np.arange(k * joints)
    panel = {ax.get_title(loc="left"): ax for ax in estimates_figure(log).axes}
    assert list(panel) == ["mass", "rotor inertia", "breakaway", "first moment", "viscous friction", "load friction",
                           "inertia", "Coulomb friction", "breakaway load"]  # fmt: skip
    for number, what in enumerate(OF_JOINTS):
        values = [float(np.asarray(line.get_ydata())[0]) for line in panel[what].lines]
        assert values == [1.0 + (len(BODY) + number) * joints + j for j in range(joints)], what
    rows["theta_arm"][:, 13 * joints :] = 0.0
    assert len(estimates_figure(log).axes) == 6


def test_bounds_of_the_last_estimates_are_drawn_in_their_panels() -> None:
    log = RUNS["adaptive"]()
    log.agents["left"]["theta_arm"][:, :48] = 0.2
    bounds = [[0.1, 0.2]] * 48
    bounds[47] = [0.1, 0.207]
    run = json.loads(log.attachments["run.json"])
    run["arms"][0]["estimate_bounds"] = {"arm": bounds, "object": [[0.0, 1.0]] * 10}
    log.attachments["run.json"] = json.dumps(run).encode()
    heights = {
        ax.get_title(loc="left"): {float(np.asarray(line.get_ydata())[0]) for line in ax.lines if dotted(line)}
        for ax in estimates_figure(log).axes
    }
    assert heights["breakaway load"] == {0.2, 0.207}
    assert heights["load friction"] == {0.2}


def dotted(line: Line2D) -> bool:
    return line.get_linestyle() == ":"


def estimates_figure(log: RunLog) -> Figure:
    run = prepare(log)
    return estimates(run, run.arms[0])


# ------------------------------------------------------------------------------------------------------ long series

series = arrays(float, st.integers(1, 3000), elements=st.floats(-1e6, 1e6), fill=st.floats(-1e6, 1e6))


@given(series, st.integers(1, 100))
def test_columns_hold_every_value_and_keep_the_ends(values: np.ndarray, columns: int) -> None:
    t = np.arange(len(values), dtype=float)
    drawn = in_columns(t, values, columns)
    assert len(drawn.t) <= columns
    assert np.all(np.diff(drawn.t) > 0)
    assert drawn.t[-1] == t[-1]
    assert (drawn.lowest.min(), drawn.highest.max()) == (values.min(), values.max())
    assert np.all(drawn.lowest <= drawn.mean)
    assert np.all(drawn.mean <= drawn.highest)


@given(arrays(float, st.integers(0, 60), elements=st.one_of(st.floats(-1, 1), st.just(np.nan))))
def test_unbroken_stretches_hold_every_number_once_and_no_other(values: np.ndarray) -> None:
    t = np.arange(len(values), dtype=float)
    spans = unbroken(t, values)
    np.testing.assert_array_equal(np.concatenate([y for _, y in spans] or [[]]), values[np.isfinite(values)])
    for x, _ in spans:
        assert np.all(np.diff(x) == 1.0)
    for (before, _), (after, _) in pairwise(spans):
        assert np.isnan(values[int(before[-1]) + 1 : int(after[0])]).all()


@pytest.mark.parametrize("rows", [100, 20_000])
def test_missing_rows_break_the_line(rows: int) -> None:
    t = np.delete(np.arange(rows) * 0.005, np.arange(rows // 2, rows // 2 + 20))
    _, (ax,) = panels(1)
    draw_line(ax, t, np.ones_like(t))
    x, y = (np.asarray(a, dtype=float) for a in ax.lines[0].get_data())
    assert np.isnan(y).sum() == 1
    (gap,) = np.flatnonzero(np.isnan(y))
    assert x[gap - 1] == t[rows // 2 - 1]
    assert x[gap + 1] == t[rows // 2]


@pytest.mark.parametrize("rows", [100, 20_000])
def test_a_peak_alone_between_two_gaps_is_a_point(rows: int) -> None:
    values = np.ones(rows)
    values[[9, 11, 30, 32]], values[10], values[31] = np.nan, 7.0, 5.0
    _, (ax,) = panels(1)
    draw_line(ax, np.arange(rows) * 0.005, values, color="#005c9e")
    (points,) = [line for line in ax.lines if line.get_marker() == "."]
    assert [tuple(xy) for xy in points.get_xydata()] == [(0.05, 7.0), (pytest.approx(0.155), 5.0)]
    assert (points.get_linestyle(), points.get_color()) == ("None", "#005c9e")
    assert str(points.get_label()).startswith("_"), "it has no name beside the panel"


def test_a_short_stretch_between_two_gaps_of_a_long_series_has_its_range() -> None:
    values = np.ones(20_000)
    values[[99, 103]], values[101] = np.nan, 7.0
    _, (ax,) = panels(1)
    draw_line(ax, np.arange(20_000) * 0.005, values, color="#005c9e")
    assert not [line for line in ax.lines if line.get_marker() == "."]
    drawn = np.concatenate([path.vertices for path in ax.collections[0].get_paths()])
    at = drawn[(drawn[:, 0] > 0.4999) & (drawn[:, 0] < 0.5101)]
    assert at[:, 1].max() == 7.0
    assert len(np.unique(at[:, 0])) == 2


def test_tail_is_the_fraction_that_is_at_least_as_long() -> None:
    values = np.arange(1.0, 1001.0)
    x, fraction = tail_of(values)
    assert (x.min(), x.max()) == (1.0, 1000.0)
    for longest, share in zip(x, fraction, strict=True):
        assert share == pytest.approx(np.mean(values >= longest))
