"""What the loop makes of a monitor's finding: HOLD from the next cycle on, no start, the reason told once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.config.monitors import bounds
from agent.modes import Event, Mode
from agent.monitors.bounds import Name
from agent.monitors.watch import Watch
from drivers.interface import Vector
from tests.support.runner_rig import START_AFTER, fault, paper, q_start, run


def watch(*off: Name) -> Watch:
    b = bounds(paper(), paper().arms[0])
    return Watch(replace(b, watched=frozenset({Name.POSITION}) - frozenset(off)))


def beyond(first: int) -> Vector:
    high = bounds(paper(), paper().arms[0]).position_rad[2][1]
    q: Vector = q_start()
    q[2] = high + 1e-3 * first
    return q


def release(read: int) -> Event:
    return Event.RELEASED if read == 40 else Event.NONE


@pytest.mark.parametrize("first", [3, START_AFTER + 5], ids=["before the start", "on the way"])
def test_a_finding_holds_from_the_next_cycle_on_and_no_start_leads_out(first: int) -> None:
    patient = {"error_max_m": 10.0, "error_max_rad": 7.0}
    q = lambda n: beyond(1) if n == first else q_start()  # noqa: E731
    done = run(release, q=q, agent=patient, watch=watch(), hold_at_end=True)
    before = [] if first < START_AFTER else [Mode.TRACK]
    assert done.modes == [*before, Mode.HOLD, Mode.OFF]
    assert done.rows["mode"][first - 1] == (before or [Mode.READY])[0]
    assert done.rows["mode"][first] == Mode.HOLD
    at = f"t = {done.rows['t'][first - 1]:.3f} s" if before else "before a start"
    assert done.summary.reason.startswith(f"{at}: monitor position: position of wrist_angle: found 1.5")
    assert done.troubles == [done.summary.reason]


def test_without_the_monitor_or_without_a_watch_the_arm_goes_on() -> None:
    for own in (watch(Name.POSITION), None):
        done = run(q=lambda n: beyond(1) if n == 3 else q_start(), watch=own)
        assert Mode.HOLD not in done.modes or "monitor" not in done.summary.reason


def test_a_flag_of_the_law_is_told_before_a_monitor_and_an_earlier_reason_stays() -> None:
    done = run(q=lambda n: q_start() * np.nan if n == 15 else q_start(), watch=watch())
    assert "NOT_FINITE" in done.summary.reason
    done = run(q=lambda n: beyond(1) if n == 16 else q_start(), failures={15: fault(True)}, watch=watch())
    assert done.summary.reason == str(fault(True))
    done = run(q=lambda n: beyond(1) if n == 16 else q_start(), refused=frozenset({14}), watch=watch())
    assert Mode.HOLD in done.modes
    assert "0 bytes taken" not in done.summary.reason, "one write that the bus did not take holds nothing"
