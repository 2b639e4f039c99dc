"""What must hold of every figure of a report: units on each axis, no peak lost, gaps visible."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent.telemetry import figures
from agent.telemetry.figures_more import tail_of
from agent.telemetry.gallery import pictures
from agent.telemetry.plotting import COLUMNS, envelope, with_breaks
from agent.telemetry.prepared import Prepared, prepare
from tests.unit.synthetic_run import Log, paper_run, spatial_run

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
    assert pictures(prepare(Log(log.path, {}, None, attachments=log.attachments))) == []


def test_desired_is_blue_and_actual_red_as_in_the_paper() -> None:
    figure = figures.pose(prepare(RUNS["paper"]()))
    for ax in figure.axes:
        desired, actual = ax.lines
        assert (desired.get_label(), actual.get_label()) == ("desired", "actual")
        blue, red = mpl.colors.to_rgb(desired.get_color()), mpl.colors.to_rgb(actual.get_color())
        assert blue[2] == max(blue)
        assert red[0] == max(red)


def test_the_pose_figure_shows_the_pose_at_every_peak() -> None:
    run = prepare(RUNS["paper"]())
    x = np.asarray(figures.pose(run).axes[0].lines[1].get_ydata(), dtype=float)
    assert run.true is not None
    assert x.min() == run.true.p[:, 0].min()
    assert x.max() == run.true.p[:, 0].max()


def test_limits_are_drawn_only_when_a_torque_comes_near_them() -> None:
    log = RUNS["paper"]()
    dashed = [line for ax in figures.torques(prepare(log)).axes for line in ax.lines if line.get_linestyle() == "--"]
    assert dashed == []
    log.agents["left"]["tau_cmd"][10, 0] = 2.9
    left, right = figures.torques(prepare(log)).axes
    assert [line.get_ydata()[0] for line in left.lines if line.get_linestyle() == "--"] == [-3.0, 3.0]
    assert all(line.get_linestyle() == "-" for line in right.lines)


# --------------------------------------------------------------------------------------------------------- envelope

long_series = arrays(float, st.integers(0, 30_000), elements=st.floats(-1e6, 1e6), fill=st.floats(-1e6, 1e6))


@given(long_series, st.lists(st.integers(0, 29_999), max_size=5))
def test_envelope_keeps_extremes_ends_and_order(values: np.ndarray, spikes: list[int]) -> None:
    for i in spikes:
        values[i % max(len(values), 1) : i % max(len(values), 1) + 1] = 1e9
    t = np.arange(len(values), dtype=float)
    t_kept, kept = envelope(t, values)
    assert len(kept) <= max(len(values) if len(values) <= 4 * COLUMNS else 0, 3 * COLUMNS + 2)
    assert np.all(np.diff(t_kept) > 0)
    np.testing.assert_array_equal(kept, values[t_kept.astype(int)])
    if len(values):
        assert (kept.min(), kept.max()) == (values.min(), values.max())
        assert (kept[0], kept[-1]) == (values[0], values[-1])


def test_envelope_keeps_a_peak_beside_a_value_that_is_no_number() -> None:
    values = np.zeros(20_000)
    values[5_000], values[5_001] = np.nan, 9.0
    _, kept = envelope(np.arange(20_000.0), values)
    assert np.isnan(kept).sum() == 1
    assert np.nanmax(kept) == 9.0


def test_missing_rows_break_the_line() -> None:
    t = np.delete(np.arange(100) * 0.005, np.arange(40, 60))
    t_broken, values = with_breaks(t, np.ones_like(t))
    assert np.isnan(values).sum() == 1
    assert len(t_broken) == len(values) == 81


def test_tail_is_the_fraction_that_is_at_least_as_long() -> None:
    values = np.arange(1.0, 1001.0)
    x, fraction = tail_of(values)
    assert (x.min(), x.max()) == (1.0, 1000.0)
    for longest, share in zip(x, fraction, strict=True):
        assert share == pytest.approx(np.mean(values >= longest))
