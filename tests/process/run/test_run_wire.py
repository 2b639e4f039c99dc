"""The paper's motion with the real driver on emulated servos: real processes, real ptys, real time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agent.log.read import RunLog
from agent.modes import Mode
from agent.safety import Flag
from tests.process.conftest import WHOLE_S
from tests.support.stalls import stalled

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(400)]
# 1.5 times the bounds of the simulated driver with all servo effects
BOUND_M, BOUND_RAD = 1.5e-3, 3e-3
RATE_HZ = 200.0


def test_the_real_driver_tracks_on_an_emulated_bus(whole_run: tuple[Path, RunLog]) -> None:
    out, log = whole_run
    results = json.loads((out / "results.json").read_text())
    assert log.run_info()["driver"] == "dynamixel"
    assert results["complete"] is True
    errors = results["max_position_error_m"], results["max_attitude_error_rad"]
    within = errors[0] <= BOUND_M and errors[1] <= BOUND_RAD
    if not within and (why := stalled(log)):
        pytest.skip(f"this machine stalled, and the error of such a run says nothing: {why}")
    assert within, errors
    for arm in ("left", "right"):
        rows = log.agents[arm]
        assert rows["t"][rows["mode"] == Mode.TRACK].max() > WHOLE_S - 0.02 - rows["late_s"].max()
        assert any("fast sync read" in e.text for e in log.events if e.source == arm), "the real driver ran"
        assert np.nanmax(np.abs(rows["tau_sent"][:, :3])) <= 4.1 + 1e-9, "half of the shoulder pair's stall torque"


def test_all_processes_of_a_run_tie_their_clocks_alike(whole_run: tuple[Path, RunLog]) -> None:
    log = whole_run[1]
    assert log.plant is not None
    origins = [int((rows["utc_ns"] - rows["stamp_ns"])[0]) for rows in (log.plant, *log.agents.values())]
    assert np.ptp(origins) == 0, "one run, one tie between its clocks"


def test_the_health_of_every_servo_is_read_once_a_second(whole_run: tuple[Path, RunLog]) -> None:
    log = whole_run[1]
    for arm in ("left", "right"):
        rows, servos = log.agents[arm], log.servos[arm]
        assert servos.servo_id[:7] == (1, 2, 3, 4, 5, 6, 7)
        fresh_s = np.count_nonzero(rows["flags"] & Flag.STALE.value == 0) / RATE_HZ
        most, least = len(rows) / RATE_HZ + 2.0, fresh_s / 1.25 - 2.0
        assert least <= len(servos) <= most, "once in a second, later where a reply was lost"
        assert np.all(np.abs(servos.voltage_V - 12.0) < 1.0)
