"""Faults of a cell in runs at the wall clock's pace: by a plant, and by emulated servos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.log.read import RunLog, read_log
from agent.modes import Mode
from agent.process.arranged import REASON
from agent.telemetry.row.sample import MAX_JOINTS
from tests.support.loaded import coop
from tests.support.stalls import Stalled, despite_stalls, stalled

HELD_S, LIMP_S, END_S, SOON_S = 0.5, 0.8, 1.2, 0.06
FAULTS = f"{{kind='hold', arm='right', at_s={HELD_S}}}, {{kind='limp', arm='left', at_s={LIMP_S}}}"


@pytest.mark.paced
def test_faults_come_at_their_instant_from_the_common_start(tmp_path: Path) -> None:
    come_at_their_instant(faulty(tmp_path / "out", "--real-time"))


@pytest.mark.realtime
@despite_stalls
def test_so_they_do_on_emulated_servos(tmp_path: Path) -> None:
    log = faulty(tmp_path / "out", "--wire")
    if why := stalled(log, HELD_S):  # an arm holds for it, before any fault
        raise Stalled(why)
    come_at_their_instant(log)


def faulty(out: Path, kind: str) -> RunLog:
    coop(
        "run", "two_wx200", kind, "--no-report", "--duration", END_S + 0.1, "--out", out,
        "--set", f"simulation.fault=[{FAULTS}]", "--set", "simulation.ready_s=1.0",
    )  # fmt: skip
    return read_log(out / "run.mcap")


def come_at_their_instant(log: RunLog) -> None:
    right, rows = log.agents["right"], log.plant
    assert rows is not None
    held_s = right["t"][right["mode"] == Mode.HOLD]
    assert HELD_S < held_s[0] < HELD_S + SOON_S
    assert held_s[-1] > END_S, "to the end"
    assert [event.source for event in log.events if event.text == REASON] == ["right"]
    following = right[right["mode"] == Mode.TRACK]
    zero_ns = int(following["utc_ns"][0]) - round(float(following["t"][0]) * 1e9)
    t = (rows["utc_ns"].astype(np.int64) - zero_ns) * 1e-9
    left, other = rows["tau_applied"][:, :3], rows["tau_applied"][:, MAX_JOINTS : MAX_JOINTS + 3]
    before, after = (t > 0.1) & (t < LIMP_S - SOON_S), (t > LIMP_S + SOON_S) & (t < END_S)
    assert np.abs(left[before]).max(axis=1).min() > 0.05
    assert not left[after].any()
    assert np.abs(other[before | after]).max(axis=1).min() > 0.05
