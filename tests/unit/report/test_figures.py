"""What must hold of every figure of a report: units on each axis, no peak lost, gaps visible."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.axes import Axes

from agent.report import figures
from agent.report.figures_more import tail_of
from agent.report.gallery import pictures
from agent.report.plotting import in_columns, panels, unbroken
from agent.report.plotting import line as draw_line
from agent.report.prepared import Prepared, prepare
from tests.support.telemetry.synthetic_run import paper_run, spatial_run

RUNS = {
    "paper": lambda: paper_run(Path("run.mcap"), duration_s=25.0),
    "adaptive": lambda: paper_run(Path("run.mcap"), duration_s=25.0, adaptive=True),
    "no plant": lambda: paper_run(Path("run.mcap"), duration_s=25.0, plant=False),
    "six joints": lambda: spatial_run(Path("run.mcap"), duration_s=25.0),
}


@pytest.fixture(scope="module", params=RUNS.values(), ids=RUNS.keys())
def run(request: pytest.FixtureRequest) -> Prepared:
    return prepare(request.param())


def test_every_axis_of_every_figure_names_its_unit(run: Prepared) -> None:
    for picture in pictures(run):
        figure = picture.draw()
        rows = {round(ax.get_position().x0, 3): ax for ax in figure.axes}  # the lowest panel of each column
        for ax in figure.axes:
            assert "[" in ax.get_ylabel(), picture.stem
        for ax in rows.values():
            assert "[" in ax.get_xlabel(), picture.stem


def test_every_figure_shows_something(run: Prepared) -> None:
    for picture in pictures(run):
        for ax in picture.draw().axes:
            drawn = [y for line in ax.lines for y in np.asarray(line.get_ydata(), dtype=float)]
            assert np.isfinite(drawn).any(), f"{picture.stem}: {ax.get_title()}"


def test_figures_leave_the_settings_of_matplotlib_alone(run: Prepared) -> None:
    before = dict(mpl.rcParams)
    for picture in pictures(run):
        picture.draw()
    assert dict(mpl.rcParams) == before


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
    assert [ax.get_title(loc="left") for ax in timing.draw().axes] == ["Loop timing", "Lateness of each cycle"]
    assert "how late each cycle began" in timing.caption
    for rows in log.agents.values():
        rows["late_s"] = 0.0
    timing = {picture.stem: picture for picture in pictures(prepare(log))}["loop_timing"]
    (tail,) = timing.draw().axes
    assert "No cycle began late" in timing.caption
    assert "began late" not in [text.get_text() for text in tail.get_legend().get_texts()]
    assert "control step" in [text.get_text() for text in tail.get_legend().get_texts()]


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


def test_tail_is_the_fraction_that_is_at_least_as_long() -> None:
    values = np.arange(1.0, 1001.0)
    x, fraction = tail_of(values)
    assert (x.min(), x.max()) == (1.0, 1000.0)
    for longest, share in zip(x, fraction, strict=True):
        assert share == pytest.approx(np.mean(values >= longest))
