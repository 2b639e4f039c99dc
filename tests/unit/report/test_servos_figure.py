"""What the servos say of themselves, in the report: a figure for each arm that has servos, with their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.log.read import RunLog
from agent.log.servos import servo_table
from agent.report.figures_servos import loads, servos
from agent.report.gallery import pictures
from agent.report.prepared import prepare
from agent.report.together import load_limit
from agent.telemetry.row.event import encode
from agent.telemetry.row.health import Health
from tests.support.telemetry.synthetic_run import paper_run

NONE = None


@pytest.fixture
def log() -> RunLog:
    """A run of two arms; the left one has two servos, of which one senses its current."""
    log = paper_run(Path("run.mcap"), duration_s=3.0)
    rows = log.agents["left"]
    texts = [
        Health.from_json(
            encode({
                "utc_ns": int(rows["utc_ns"][200 * s]), "servo_id": [2, 8], "joint": ["shoulder", "wrist_rotate"],
                "temperature_C": [40.0 + s, 35.0], "voltage_V": [12.0, 11.9], "error_bits": [0, 0],
                "current_A": [-1.15, NONE], "load": [NONE, -0.25], "temperature_limit_C": [80.0, 72.0],
                "voltage_min_V": [9.5, 6.0], "voltage_max_V": [16.0, 14.0], "stall_current_A": [2.3, 1.4],
            })
        )
        for s in range(3)
    ]  # fmt: skip
    table = servo_table(texts, rows["utc_ns"], rows["t"])
    log.attachments["cell.toml"] = b"[safety.monitors]\nload_share = 0.3\n"
    object.__setattr__(log, "servos", {"left": table})
    return log


def test_arms_with_servos_have_a_figure_and_others_none(log: RunLog) -> None:
    stems = [picture.stem for picture in pictures(prepare(log))]
    assert "servos_left" in stems
    assert "servos_right" not in stems


def test_it_shows_every_servo_and_every_limit(log: RunLog) -> None:
    run = prepare(log)
    figure = servos(run, run.info.arm("left"))
    drawn = []
    for ax in figure.axes:
        curves = [line for line in ax.get_lines() if line.get_linestyle() != "--" or len(line.get_xdata()) > 2]
        lines = [line for line in ax.get_lines() if line not in curves]
        drawn.append(([np.asarray(c.get_ydata()).tolist() for c in curves], [line.get_ydata()[0] for line in lines]))
    (hot, hot_limits), (supply, supply_limits), (load, load_limits) = drawn
    assert hot == [[40.0, 41.0, 42.0], [35.0] * 3]
    assert hot_limits == [72.0, 80.0]
    assert supply == [[12.0] * 3, [11.9] * 3]
    assert supply_limits == [6.0, 9.5, 14.0, 16.0]
    np.testing.assert_allclose(load, [[50.0] * 3, [25.0] * 3])
    np.testing.assert_allclose(load_limits, [30.0])
    for ax, limit in zip(figure.axes, (80.0, 16.0, 30.0), strict=True):
        assert ax.get_ylim()[1] > limit, "it is seen"


def test_load_is_that_of_current_where_it_is_sensed(log: RunLog) -> None:
    np.testing.assert_allclose(loads(log.servos["left"]), [[0.5, 0.25]] * 3)


def test_the_limit_of_load_is_the_cells_and_none_where_nobody_watches_it(log: RunLog) -> None:
    assert load_limit(log) == 0.3
    log.attachments["cell.toml"] = b'[safety.monitors]\noff = ["servo_load"]\n'
    assert np.isnan(load_limit(log))
    log.attachments["cell.toml"] = b"[safety.monitors]\nload_share = 7\n"
    assert np.isnan(load_limit(log)), "a damaged cell file"
    log.attachments["cell.toml"] = b""
    assert load_limit(log) == 0.45
    del log.attachments["cell.toml"]
    assert np.isnan(load_limit(log))
