"""Stamps of one instant are equal in all processes of a run, so that foreign viewers see the report's errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.log.read import read_log
from agent.log.when import trajectory_time
from tests.process.conftest import TRANSIENT_S, WAITING, RunOf


def positions(log: Path, topic: str) -> dict[int, NDArray[np.float64]]:
    """PoseStamped positions by their header stamp, ns, as any ROS tool reads them."""
    found = {}
    with log.open("rb") as file:
        for decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=[topic]):
            stamp, p = decoded.decoded_message.header.stamp, decoded.decoded_message.pose.position
            found[stamp.sec * 1_000_000_000 + stamp.nanosec] = np.array([p.x, p.y, p.z])
    return found


def test_poses_of_one_stamp_give_the_error_of_the_report(paper_runs: tuple[Path, Path]) -> None:
    log = paper_runs[0] / "run.mcap"
    true, desired = positions(log, "/object/pose"), positions(log, "/object/pose_des")
    zero_ns = min(true)
    assert zero_ns == min(desired)
    assert set(desired) <= set(true), "every desired pose has a true one of its instant"
    assert len(desired) == 150
    errors = [np.linalg.norm(true[s] - p) for s, p in desired.items() if s - zero_ns >= TRANSIENT_S * 1e9]
    results = json.loads((paper_runs[0] / "results.json").read_text())
    assert max(errors) == pytest.approx(results["max_position_error_m"], rel=1e-9)


def test_an_agents_own_events_are_on_the_runs_time(run_of: RunOf) -> None:
    """In lockstep, where the wall's time says nothing."""
    log = read_log(run_of(*WAITING) / "run.mcap")
    for arm, rows in log.agents.items():
        on, *_, ended = [e for e in log.events if e.source == arm and "stamp_ns" in e.data]
        assert on.text.startswith("torque on")
        assert ended.text.startswith("run ended")
        assert on.utc_ns <= rows["utc_ns"][0]
        assert ended.utc_ns == rows["utc_ns"][-1]
        assert ended.data["stamp_ns"] == rows["stamp_ns"][-1]
        assert trajectory_time(on, Table.of(rows)) == pytest.approx(-0.5, abs=0.011)
        assert trajectory_time(ended, Table.of(rows)) == pytest.approx(float(rows["t"][-1]), abs=1e-6)


@pytest.mark.realtime
@pytest.mark.long  # that all processes tie their clocks alike is held by the run in test_run_wire.py
def test_simulated_arms_in_real_time_have_one_origin(run_of: RunOf) -> None:
    log = read_log(run_of("paper", "--duration", 1, "--real-time", "--no-report") / "run.mcap")
    assert log.plant is not None
    members = [log.plant, *log.agents.values()]
    offsets = np.concatenate([np.unique(rows["utc_ns"] - rows["stamp_ns"]) for rows in members])
    assert len(set(offsets.tolist())) == 1
    assert (log.plant["utc_ns"] % 20_000_000 == 0).all(), "on the instants that viewers are shown"
    for rows in log.agents.values():
        assert len(np.intersect1d(rows["utc_ns"], log.plant["utc_ns"])) > 10
