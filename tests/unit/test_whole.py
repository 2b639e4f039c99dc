"""From rest to rest: real drivers, loops and sessions on emulated servos with a table, grippers and an object on it.

All in virtual time; `tests/process/run/test_run_whole.py` has the processes.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.guard.takeover import STALE_NS
from agent.modes import Event, Mode
from agent.operator.table import EVENT_OF
from agent.session_modes import next_in_session
from drivers.dynamixel.servo.models import CONTINUOUS_SHARE
from tests.support.servos.whole_rig import WholeRun
from tests.support.telemetry.run_log import write_run
from tests.unit.docs.test_first_carry import SEEN
from tests.unit.docs.test_first_carry import WORDS as SAID
from tests.unit.replay.test_verify import verified

QUICK = [
    "session.speed_max_rad_per_s=2.0", "session.back_off_m=0.03", "session.lift_m=0.015", "session.lift_s=0.6",
    "session.lower_s=0.4", "session.take_up_s=0.2", "session.ease_s=0.2", "duration_s=0.75",
]  # fmt: skip
CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", QUICK)
STALL_CURRENT_SHARE = 0.4  # above it servos are reported to trip


@cache
def whole() -> WholeRun:
    return WholeRun(CELL)


def modes(run: WholeRun, arm: str) -> list[Mode]:
    return [mode for _, mode in run.arms[arm].modes]


@pytest.mark.long  # by real processes in real time: tests/process/run/test_run_whole.py
def test_both_arms_go_from_rest_to_the_object_carry_it_and_come_back() -> None:
    run = whole()
    way = [
        Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.RELEASE, Mode.PARK,
        Mode.REST, Mode.OFF,
    ]  # fmt: skip
    assert {name: modes(run, name) for name in run.arms} == {"left": way, "right": way}
    assert {name: arm.summary.reason for name, arm in run.arms.items() if arm.summary} == {"left": "", "right": ""}
    assert not any(event.text for arm in run.arms.values() for event in arm.events if "fault" in event.text)


def test_the_object_is_carried_as_the_cell_asks_and_set_down_where_it_stood() -> None:
    run = whole()
    bounds = CELL.file.report
    for arm in run.arms.values():
        tracked = arm.rows[arm.rows["mode"] == Mode.TRACK]
        assert tracked["t"][-1] > CELL.file.duration_s - 0.02
        # the cell judges after its transient; at the start of the lift joints begin to turn, against their friction
        assert np.linalg.norm(tracked["e_p"], axis=1).max() < 2.0 * (bounds.max_position_error_m or 0.0)
        assert 2.0 * np.linalg.norm(tracked["e_eps"], axis=1).max() < 2.0 * (bounds.max_attitude_error_rad or 0.0)
        lifted = tracked["p_object"][:, 2].max() - CELL.file.p_place_m[2]
        assert lifted == pytest.approx(0.015, abs=2e-3)
        lowered = arm.rows[arm.rows["mode"] == Mode.LOWER]["p_object"][-1, 2] - CELL.file.p_place_m[2]
        assert lowered == pytest.approx(0.0, abs=3e-3)
    assert run.place is not None
    assert run.place[0] < 3e-3
    assert run.place[1] < 20e-3


def test_no_phase_takes_longer_between_two_rows_than_a_real_arms_guard_waits() -> None:
    for arm in whole().arms.values():
        assert np.diff(arm.rows["stamp_ns"].astype(np.int64)).max() < STALE_NS


def test_no_torque_steps_in_any_phase_and_no_servo_is_overloaded() -> None:
    for arm in whole().arms.values():
        rows, n = arm.rows, 3
        limits = arm.agent.limits
        steps = np.abs(np.diff(rows["tau_limited"][:, :n], axis=0))
        assert (steps <= np.array(limits.tau_step_max_Nm) + 1e-12).all()
        alone = np.isin(rows["mode"][1:], [Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK])
        assert (steps[alone] <= np.array(arm.agent.session.limits.tau_step_max_Nm) + 1e-12).all()
        share = np.abs(rows["tau_sent"][:, :n]) / np.array([8.2, 4.1, 4.1])
        assert np.nanmax(share) < STALL_CURRENT_SHARE
        bound = CELL.file.session.speed_max_rad_per_s if CELL.file.session else 0.0
        assert np.nanmax(np.abs(rows["dq_measured"][:, :n])) < 1.1 * bound


def test_no_servo_takes_more_than_its_continuous_current_over_the_session() -> None:
    for arm in CELL.arms:
        rows = whole().arms[arm.name].rows
        sent = rows["tau_sent"][np.isfinite(rows["tau_sent"][:, 0]), : arm.n]
        shares = np.sqrt((sent**2).mean(axis=0)) / arm.tau_stall_Nm
        assert shares.max() < CONTINUOUS_SHARE


def test_the_words_of_docs_first_carry_in_their_order_lead_through_the_phases_that_it_says_are_seen() -> None:
    """The rig says the next word when all arms are ready for it; the rest is the doing of driver, servos and loop."""
    run = whole()
    said = {EVENT_OF.get(verb, Event.STARTED) for verb in SAID}
    for arm in run.arms:
        way = modes(run, arm)
        own = {Event.GRIPPED, Event.ARRIVED, Event.STOP}  # what nobody says: STOP is the end of the trajectory
        for before, after in pairwise(way):
            assert any(next_in_session(before, event) is after for event in said | own)
        seen = [mode for told in SEEN for mode in told if mode is not Mode.HALT]
        assert [mode for mode in way if mode in seen] == seen
    assert run.place is not None
    assert run.place[0] < 3e-3, "the object stays where it is"
    assert CELL.file.session is not None


def test_a_session_replays_bit_for_bit_from_its_log_and_by_one_zero_between_waits(tmp_path: Path) -> None:
    rows = whole().arms["left"].rows
    assert verified(write_run(tmp_path / "run.mcap", CELL, {"left": rows})).equal
    carried = int(np.flatnonzero(rows["mode"] == Mode.LOWER)[10])
    rows["t"][carried] += 1e-9
    found = verified(write_run(tmp_path / "wrong.mcap", CELL, {"left": rows[carried - 5 : carried + 5]})).first
    assert found is not None
    assert (found.row, found.field) == (carried, "t")
