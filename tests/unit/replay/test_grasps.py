"""What each arm of a log without a simulation sees and carries, to the last digit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.log.read import open_log
from agent.modes import Mode
from agent.replay.grasps import grasps
from agent.safety import Flag
from tests.support.runner_rig import paper, run
from tests.support.telemetry.run_log import write_run

TURN = 0.6  # rad, of what one arm sees against the other


def two_arms() -> tuple[np.ndarray, np.ndarray]:
    """The same ticks; the second arm sees the object 2 mm aside and turned, as the opposite quaternion."""
    left = run(ticks=20).rows.copy()
    left["wrench_cmd"] = 0.0
    left["quat_object"] = [1.0, 0.0, 0.0, 0.0]
    right = left.copy()
    right["p_object"][:, 0] += 2e-3
    right["quat_object"] = [-np.cos(TURN / 2), -0.6 * np.sin(TURN / 2), -0.8 * np.sin(TURN / 2), 0.0]
    track = np.flatnonzero(left["mode"] == Mode.TRACK)
    left["wrench_cmd"][track[3], :6] = [3.0, 4.0, 12.0, 99.0, 0.0, 0.0]
    left["wrench_cmd"][track[5], 0] = 77.0
    left["flags"][track[5]] |= Flag.STALE.value
    right["wrench_cmd"][track[4], 0] = 0.25
    return left, right


def test_arms_differ_from_their_mean_by_half_of_what_they_differ_by(tmp_path: Path) -> None:
    left, right = two_arms()
    with open_log(write_run(tmp_path / "run.mcap", paper(), {"left": left, "right": right})) as log:
        found = grasps(log, paper())
    assert not found.truth
    assert [arm.arm for arm in found.arms] == ["left", "right"]
    assert [arm.rows for arm in found.arms] == [19, 19], "without the tick that one of them did not see"
    for arm in found.arms:
        assert arm.offset_m == pytest.approx(1e-3)
        assert arm.offset_rad == pytest.approx(2.0 * np.sin(TURN / 4), rel=1e-9)
    assert [arm.force_max_N for arm in found.arms] == [13.0, 0.25]
