"""A recorded row is the row that `step` gives from it, whatever happened in the run; a changed bit is found."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.log.read import open_log
from agent.modes import Event, Mode
from agent.replay.comparison import ArmComparison, Comparison, Difference
from agent.replay.rows import Window
from agent.replay.source import ReplayError, recorded_cell
from agent.replay.verify import verify
from agent.safety import Flag
from agent.telemetry.row.sample import AGENT_FIELDS
from tests.support.few import few
from tests.support.plant.plant_arm import run_one
from tests.support.runner_rig import fault, lost_at, paper, q_start, run, wandering
from tests.support.telemetry.run_log import flipped, write_other_release, write_run

WX200 = configs.CELLS_DIR / "identify_wx200.toml"


def verified(path: Path, window: Window = Window(), arm: str | None = None) -> Comparison:  # noqa: B008
    with open_log(path, any_layout=True) as log:
        return verify(log, recorded_cell(log), window, arm)


def replayed(folder: Path, rows: np.ndarray, cell: Cell | None = None, window: Window = Window()) -> Comparison:  # noqa: B008
    cell = cell or paper()
    return verified(write_run(folder / "run.mcap", cell, {cell.arms[0].name: rows}), window)


def stopped(reads: int) -> Event:
    return {25: Event.STOP, 62: Event.RELEASED}.get(reads, Event.NONE)


@cache
def eventful() -> np.ndarray:
    """READY, TRACK and HOLD, with cycles that brought no state in each of them."""
    failures = lost_at(4, 15, 16, 33)
    done = run(
        stopped,
        failures,
        refused=frozenset({18}),
        q=wandering,
        ticks=40,
        hold_at_end=True,
        oversleeps_ns={20: 9_000_000},
    )
    rows: np.ndarray = done.rows[:60]
    assert {Mode.READY, Mode.TRACK, Mode.HOLD} <= set(rows["mode"].tolist())
    assert np.count_nonzero(rows["flags"] & Flag.STALE) == 4
    return rows


# ------------------------------------------------------------------------------------------------------ all equal


def test_waiting_following_holding_and_lost_cycles_replay_bit_for_bit(tmp_path: Path) -> None:
    verdict = replayed(tmp_path, eventful())
    assert (verdict.rows, verdict.different, verdict.first, verdict.equal) == (60, 0, None, True)


@pytest.mark.parametrize("begin", [0, 1, 3, 4, 5, 13, 26, 27, 59])
def test_a_replay_may_begin_at_any_row(tmp_path: Path, begin: int) -> None:
    verdict = replayed(tmp_path, eventful(), window=Window(from_row=begin))
    assert (verdict.rows, verdict.equal) == (60 - begin, True)


def test_a_replay_may_begin_at_any_time(tmp_path: Path) -> None:
    rows = eventful()
    verdict = replayed(tmp_path, rows, window=Window(from_s=0.05))
    assert (verdict.rows, verdict.equal) == (int(np.sum(rows["t"] >= 0.05)), True)


def test_a_window_begins_with_the_row_of_that_time(tmp_path: Path) -> None:
    assert replayed(tmp_path, eventful(), window=Window(from_s=float(eventful()["t"][30]))).rows == 30


def test_a_hold_that_is_asked_for_while_there_is_no_state_replays(tmp_path: Path) -> None:
    def operator(reads: int) -> Event:
        return {24: Event.STOP, 40: Event.RELEASED}.get(reads, Event.NONE)

    rows = run(operator, lost_at(24, 25, 26), q=wandering, ticks=40, hold_at_end=True).rows
    lost = np.flatnonzero(rows["flags"] & Flag.STALE)
    assert rows["mode"][lost].tolist() != [Mode.TRACK] * 3, "the mode changes among them"
    assert replayed(tmp_path, rows).equal


def test_a_start_that_is_told_late_has_one_zero_from_then_on(tmp_path: Path) -> None:
    rows = run(q=wandering, ticks=3, start_ns=lambda reads, zero_ns: zero_ns if reads > 8 else None).rows
    assert np.count_nonzero(rows["t"] < -80_000) > len(rows) / 2, "most rows are a day before their zero"
    assert replayed(tmp_path, rows).equal


def test_a_fault_with_a_state_and_one_without_replay(tmp_path: Path) -> None:
    for i, with_state in enumerate((True, False)):
        rows = run(failures={15: fault(with_state)}, q=wandering, ticks=30).rows
        (tmp_path / str(i)).mkdir()
        verdict = replayed(tmp_path / str(i), rows)
        assert (verdict.rows, verdict.equal) == (len(rows), True)


def test_numbers_that_are_none_replay(tmp_path: Path) -> None:
    rows = run(q=lambda read: q_start() if read != 14 else np.full(3, np.nan), ticks=20).rows
    assert np.any(rows["flags"] & Flag.NOT_FINITE)
    assert replayed(tmp_path, rows).equal


CELLS = {
    "known": (),
    "adaptive": ('controller.kind="adaptive"',),
    "servo velocities": ('controller.velocity="servo"',),
    "noticing": (
        "safety.noticing.fast_N=30.0",
        "safety.noticing.fast_Nm=3.0",
        "safety.noticing.slow_N=20.0",
        "safety.noticing.slow_Nm=2.0",
    ),
    "alignment": ("controller.alignment.max_m=0.02",),
}


@pytest.mark.parametrize("overrides", CELLS.values(), ids=CELLS)
def test_every_law_replays_with_a_hold_in_it_and_from_its_middle(tmp_path: Path, overrides: tuple[str, ...]) -> None:
    ticks: list[int] = []

    def operator() -> Event:
        ticks.append(1)
        return Event.STOP if len(ticks) == 70 else Event.NONE

    cell = load_cell(WX200, overrides)
    done = run_one(cell, 0.5, operator)
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    verdict = replayed(tmp_path, done.rows, cell)
    assert (verdict.rows, verdict.equal) == (len(done.rows), True)
    for begin in (1, 37, 70, 71, 90):
        assert verified(tmp_path / "run.mcap", Window(from_row=begin)).equal


def looped(arm: str, *, bridged: bool) -> tuple[Cell, np.ndarray]:
    """Rows of the left arm in a cell with this arm in the loop; bridged: with what a bridge tells."""
    cell = load_cell(configs.CELLS_DIR / "paper.toml", [f'hil.arms=["{arm}"]'])
    rows = eventful().copy()
    rows["config_id"] = cell.config_id
    if bridged:
        rows["tau_bridge"][:, :3], rows["q_twin"][:, :3], rows["twin_age_s"] = 0.25, 1.5, 3e-3
    return cell, rows


@pytest.mark.parametrize(
    ("arm", "bridged", "equal"), [("left", True, True), ("right", False, True), ("right", True, False)]
)
def test_what_a_bridge_tells_is_taken_as_recorded_for_an_arm_in_the_loop_alone(
    tmp_path: Path, arm: str, bridged: bool, equal: bool
) -> None:
    cell, rows = looped(arm, bridged=bridged)
    verdict = replayed(tmp_path, rows, cell)
    assert (verdict.rows, verdict.equal) == (60, equal)
    assert verdict.first is None or verdict.first.fields == ("tau_bridge", "q_twin", "twin_age_s")


def test_rows_that_are_missing_leave_the_others_equal(tmp_path: Path) -> None:
    rows = eventful()
    kept = rows[np.r_[0:7, 9:20, 30:60]]
    verdict = replayed(tmp_path, kept)
    assert (verdict.rows, verdict.equal) == (len(kept), True)


# --------------------------------------------------------------------------------------------------- one bit changed

# field, byte in it, bit, and a field that tells of it; sizes that a computed number can show
CHANGED = [
    ("mode", 0, 0, "memory"),  # what a hold holds
    ("mode", 1, 3, "mode"),
    ("flags", 0, 4, "q_measured"),  # STALE: such a cycle has no joints
    ("flags", 0, 1, "flags"),
    ("joint_count", 0, 0, "joint_count"),
    ("config_id", 3, 7, "config_id"),
    ("t", 0, 0, "t"),
    ("stamp_ns", 0, 0, "t"),
    ("q_measured", 2, 0, "q"),
    ("q_measured", 8 * 3, 0, "q_measured"),  # behind the last joint
    ("dq_measured", 8 + 7, 6, "dq"),
    ("q", 0, 0, "q"),
    ("p_object_des", 0, 0, "p_object_des"),
    ("tau_gravity", 8, 0, "tau_gravity"),
    ("tau_limited", 16, 0, "tau_limited"),
    ("sigma_min", 0, 0, "sigma_min"),
    ("theta_object", 0, 0, "theta_object"),
    *(("memory", 8 * k, 0, "memory") for k in (0, 7, 14, 21, 28, 35, 42, 70, 73, 77, 78, 79, 85, 86, 104)),
]


@pytest.mark.parametrize(("field", "byte", "bit", "first"), CHANGED, ids=str)
@pytest.mark.parametrize("row", few((20, 45), (45).__eq__))
def test_one_bit_changed_in_one_row_is_found(
    tmp_path: Path, field: str, byte: int, bit: int, first: str, row: int
) -> None:
    verdict = replayed(tmp_path, flipped(eventful(), row, field, byte, bit))
    assert not verdict.equal
    assert verdict.different == 1, "the rows behind it begin with what they recorded themselves"
    found = verdict.first
    assert found is not None
    assert (found.arm, found.row) == ("left", row)
    assert first in found.fields
    assert found.recorded != found.replayed or np.isnan(found.recorded)


def test_a_bit_of_any_field_that_is_compared_is_found(tmp_path: Path) -> None:
    """Of each in a row of its own, a few to a log."""
    told = {"sequence", "tau_measured", "tau_sent", "q_measured", "dq_measured"}  # by the driver, and what orders rows
    compared = [f.name for f in AGENT_FIELDS if f.name not in told and not f.timing]
    for begin in range(0, len(compared), 8):
        names, rows = compared[begin : begin + 8], eventful()
        for row, name in enumerate(names, 50):
            rows = flipped(rows, row, name)
        path = write_run(tmp_path / f"{begin}.mcap", paper(), {"left": rows})
        assert verified(path, Window(from_row=48)).different == len(names), names


def test_the_first_difference_is_that_of_the_earliest_row() -> None:
    late, early = (Difference(arm, row, 0.0, "q", 0, 0.0, 1.0, ("q",)) for arm, row in (("left", 9), ("right", 4)))
    verdict = Comparison((ArmComparison("left", 9, 1, 0, late, 0.0), ArmComparison("right", 9, 1, 0, early, 0.0)), ())
    assert verdict.first is early


def test_a_verdict_is_equal_where_no_arm_differs_or_left_a_row_out() -> None:
    good, other, short = (ArmComparison("left", 9, d, n, None, 0.0) for d, n in ((0, 0), (1, 0), (0, 1)))
    assert Comparison((good, good), ()).equal
    for arms in ((good, other), (short, good), (good, short), (short, short)):
        assert not Comparison(arms, ()).equal


def test_it_says_at_which_arm_it_is(tmp_path: Path) -> None:
    told: list[str] = []
    path = write_run(tmp_path / "run.mcap", paper(), {"left": eventful()[:3]})
    with open_log(path) as log:
        verify(log, recorded_cell(log), Window(), tell=told.append)
    assert told == ["replaying left", "replaying right"]


def test_a_change_of_the_first_memory_is_found_because_a_run_begins_with_nothing(tmp_path: Path) -> None:
    verdict = replayed(tmp_path, flipped(eventful(), 0, "memory", 8 * 28))
    assert verdict.first is not None
    assert (verdict.first.row, verdict.first.field, verdict.first.index, verdict.first.replayed) == (
        0,
        "memory",
        28,
        0.0,
    )


@pytest.mark.parametrize("field", ["tau_cmd", "tau_limited"])
def test_the_difference_says_both_values_and_how_much_torque_it_is(tmp_path: Path, field: str) -> None:
    rows = eventful().copy()
    rows[field][30, 1] += 0.25
    verdict = replayed(tmp_path, rows)
    found = verdict.first
    assert found is not None
    assert (found.row, found.field, found.index, found.t_s) == (30, field, 1, rows["t"][30])
    assert found.recorded == rows[field][30, 1]
    assert found.replayed == eventful()[field][30, 1]
    assert found.fields == (field,)
    assert verdict.arms[0].torque_difference_Nm == pytest.approx(0.25)


@pytest.mark.parametrize("row", [20, 30], ids=["followed", "held"])
@pytest.mark.parametrize("t", [np.nan, np.inf, 1e300])
def test_a_time_that_is_none_is_a_difference_and_no_crash(tmp_path: Path, t: float, row: int) -> None:
    rows = eventful().copy()
    rows["t"][row] = t
    verdict = replayed(tmp_path, rows)
    assert verdict.different == 1
    assert verdict.first is not None
    assert (verdict.first.row, verdict.first.fields[0]) == (row, "t")
    says_why = str(verdict.first.replayed).startswith("no torque at all: ")
    assert says_why == (row == 20 and np.isinf(t))


@pytest.mark.parametrize("begin", [0, 20])
def test_a_time_beside_the_others_is_found_wherever_the_replay_begins(tmp_path: Path, begin: int) -> None:
    rows = eventful().copy()
    rows["t"][30] = round(1e9 * rows["t"][30] + 1e6) * 1e-9  # a millisecond late, in whole nanoseconds as all are
    verdict = replayed(tmp_path, rows, window=Window(from_row=begin))
    assert (verdict.rows, verdict.different) == (60 - begin, 1)
    assert verdict.first is not None
    assert (verdict.first.row, verdict.first.fields) == (30, ("t",))


@pytest.mark.parametrize("t", [-1.5e9, 1.5e9])
def test_a_time_of_decades_is_none_in_a_wait_too(tmp_path: Path, t: float) -> None:
    rows = eventful().copy()
    assert rows["mode"][3] == Mode.READY
    rows["t"][3] = t
    assert replayed(tmp_path, rows).different == 1


# ------------------------------------------------------------------------------------------- built from the log alone


def test_no_arm_file_of_this_installation_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_run(tmp_path / "run.mcap", paper(), {"left": eventful()})
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.setattr(configs, "ARMS_DIR", empty)
    monkeypatch.setattr(configs, "CELLS_DIR", empty)
    assert verified(path).equal


@pytest.mark.parametrize("name", ["cell.toml", "widowx_mk2.toml", "widowx_mk2.urdf"])
def test_a_log_without_one_of_its_files_says_which(tmp_path: Path, name: str) -> None:
    path = write_run(tmp_path / "run.mcap", paper(), {"left": eventful()}, left_out=(name,))
    with pytest.raises(ReplayError, match=name.replace(".", r"\.")):
        verified(path)


def test_the_law_of_the_log_is_replayed_and_not_that_of_a_file_of_the_same_name(tmp_path: Path) -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ["controller.k_p_per_s=149.0"])
    verdict = verified(write_run(tmp_path / "run.mcap", cell, {"left": eventful()}))
    assert verdict.different == 60
    assert verdict.first is not None
    assert "config_id" in verdict.first.fields
    assert verdict.arms[0].torque_difference_Nm > 1e-6


def test_an_arm_that_is_not_there_and_an_empty_window_are_refused(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run.mcap", paper(), {"left": eventful()})
    with pytest.raises(ReplayError, match="expected left or right"):
        verified(path, arm="middle")
    for beyond in (Window(from_s=1e6), Window(from_row=10**6)):
        with pytest.raises(ReplayError, match=r"nothing to replay in .*no row from there on.*begin earlier"):
            verified(path, beyond)
    with pytest.raises(ReplayError, match=r"nothing to replay of right in .*no row at all.*name another arm"):
        verified(path, arm="right")


# --------------------------------------------------------------------------------------------------- other releases

OLDER = {"without": ("shift", "unexpected_wrench", "unexpected"), "memory": 51}


def test_a_log_of_another_release_replays_from_its_first_row_and_says_what_it_lacks(tmp_path: Path) -> None:
    verdict = verified(write_other_release(tmp_path / "run.mcap", paper(), {"left": eventful()}, **OLDER))
    assert (verdict.rows, verdict.equal) == (60, True)
    assert verdict.notes == (
        "left: recorded by another release; not compared: shift, unexpected_wrench, unexpected, memory",
    )


def test_without_a_memory_that_can_be_read_a_change_is_found_too(tmp_path: Path) -> None:
    rows = flipped(eventful(), 30, "q_measured", 5)
    verdict = verified(write_other_release(tmp_path / "run.mcap", paper(), {"left": rows}, **OLDER))
    assert verdict.first is not None
    assert (verdict.first.row, verdict.first.field) == (30, "q")
    assert (verdict.rows, verdict.arms[0].left_out) == (60, 0), "and the rows behind it are compared still"


def test_without_a_memory_that_can_be_read_nothing_behind_a_gap_is_called_equal(tmp_path: Path) -> None:
    rows = eventful()[np.r_[0:20, 25:60]]
    path = write_other_release(tmp_path / "run.mcap", paper(), {"left": rows}, **OLDER)
    verdict = verified(path)
    assert (verdict.rows, verdict.different, verdict.arms[0].left_out, verdict.equal) == (20, 0, 35, False)
    with pytest.raises(ReplayError, match="nothing to replay"):
        verified(path, Window(from_row=30))


def test_rows_without_an_input_of_step_are_refused_with_its_name(tmp_path: Path) -> None:
    path = write_other_release(tmp_path / "run.mcap", paper(), {"left": eventful()}, without=("dq_measured",))
    with pytest.raises(ReplayError, match="they lack dq_measured"):
        verified(path)


def test_a_release_without_any_one_output_replays(tmp_path: Path) -> None:
    inputs = {"sequence", "stamp_ns", "mode", "flags", "joint_count", "t", "q_measured", "dq_measured", "utc_ns"}
    for f in AGENT_FIELDS[::7]:
        if f.name not in inputs and f.ros_type == "float64":  # an odd number of words of four bytes would misalign
            path = tmp_path / f"{f.name}.mcap"
            assert verified(write_other_release(path, paper(), {"left": eventful()}, without=(f.name,))).equal
