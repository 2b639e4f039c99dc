"""What identification takes from a log, and every log it refuses in one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import configs
from agent.config.cell import Cell, ConfigError, load_cell
from agent.host.info import attachments
from agent.identify.recording import IdentifyError, acted, from_log, from_rows
from agent.log.read import RunLog
from agent.modes import Mode
from agent.replay.source import ReplayError
from agent.telemetry.row.sample import AGENT_STATE

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml")
PERIOD_NS = CELL.period_ns
FILES = attachments(CELL, b"{}")
UTC_NS = 1_773_446_400_000_000_000  # 2026-03-14


def rows_of(seconds: float = 20.0) -> np.ndarray:
    """Rows of a run in TRACK: each joint at a speed of its own, torque equal to the tick's number."""
    count = round(seconds * CELL.file.rate_hz)
    rows = np.zeros(count, AGENT_STATE.dtype)
    tick = np.arange(count)
    rows["sequence"], rows["stamp_ns"], rows["utc_ns"] = tick, tick * PERIOD_NS + 5000, tick * PERIOD_NS + UTC_NS
    rows["mode"], rows["joint_count"] = Mode.TRACK, 3
    rows["q_measured"][:, :3] = tick[:, None] * 0.005 * np.array([0.1, 0.2, 0.3])
    rows["tau_sent"][:, :3] = tick[:, None]
    return rows


def log_of(cell: Cell, rows: np.ndarray, **changes: Any) -> RunLog:
    log = RunLog(
        path=Path("run.mcap"),
        cell=cell.file.name,
        agents={arm.name: rows for arm in cell.arms},
        plant=None,
        events=[],
        attachments=attachments(cell, b"{}"),
        metadata={},
        complete=True,
        gaps={},
    )
    return replace(log, **changes)


def test_positions_and_torques_are_those_of_the_rows() -> None:
    recording = from_log(log_of(CELL, rows_of()))
    assert recording.arm.name == "arm"
    assert recording.day == "2026-03-14"
    assert recording.q.shape == recording.tau.shape == (4000, 3)
    assert np.allclose(recording.q, rows_of()["q_measured"][:, :3], atol=1e-12)
    # one cycle of delay: around tick k the torques of ticks k − 2 and k − 1 act
    assert np.allclose(recording.tau[10:, 0], np.arange(10, 4000) - 1.5)


@given(st.integers(0, 25), arrays(np.float64, (30, 2), elements=st.floats(-5, 5)))
def test_acted_torque_is_the_mean_of_the_held_one_around_each_sample(tenths: int, sent: np.ndarray) -> None:
    fine = np.repeat(sent, 10, axis=0)  # held over each period, ten steps long
    late = np.concatenate([np.repeat(sent[:1], tenths, axis=0), fine])
    for k in range(4, 30):
        assert np.allclose(acted(sent, tenths / 10)[k], late[10 * k - 5 : 10 * k + 5].mean(axis=0), atol=1e-9)


def test_cycles_without_a_state_are_bridged_by_what_the_servos_really_did() -> None:
    """Position in between, torque repeated; every later sample stays at its time."""
    rows = rows_of()
    holed = np.delete(rows, [1000, 1001, 2500])
    whole, bridged = from_rows(CELL, CELL.arms[0], rows), from_rows(CELL, CELL.arms[0], holed)
    assert np.allclose(bridged.q, whole.q, atol=1e-12)
    assert np.allclose(bridged.tau[1100:2400], whole.tau[1100:2400])
    assert np.allclose(bridged.tau[1001:1004, 0], [999.0, 999.0, (999.0 + 1002.0) / 2])


def test_uneven_stamps_are_taken_as_they_are() -> None:
    rows, random = rows_of(), np.random.default_rng(1)
    shift_ns = random.integers(-300_000, 300_000, len(rows))
    shift_ns[0] = 0
    rows["stamp_ns"] += shift_ns
    rows["q_measured"][:, :3] += shift_ns[:, None] * 1e-9 * np.array([0.1, 0.2, 0.3])
    recording = from_rows(CELL, CELL.arms[0], rows)
    assert np.allclose(recording.q[:3990], rows_of()["q_measured"][:3990, :3], atol=1e-9)


def test_only_the_longest_stretch_in_track_counts() -> None:
    rows = rows_of(40.0)
    rows["mode"][:100] = Mode.READY
    rows["mode"][500:520] = Mode.HOLD
    rows["mode"][7000:] = Mode.HOLD
    recording = from_rows(CELL, CELL.arms[0], rows)
    assert len(recording.q) == 7000 - 520
    assert recording.q[0, 0] == pytest.approx(520 * 0.0005)


def refusal(log: RunLog, **options: Any) -> str:
    with pytest.raises(IdentifyError) as caught:
        from_log(log, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_several_arms_are_refused_because_their_forces_are_unknown() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    text = refusal(log_of(cell, rows_of()))
    assert "found 2 arms on one object" in text
    assert "through the object is in no log" in text
    assert "identify_wx200.toml" in text


@pytest.mark.parametrize("arm", [None, "left"])
def test_an_arm_that_a_hand_guided_is_refused_for_the_hand_and_not_for_arms_that_took_no_part(arm: str | None) -> None:
    """The arms of a cell hold one object only where they hold one: this one floated by itself."""
    rows = rows_of()
    rows["mode"][10:] = Mode.FLOAT
    cell = load_cell(Path("two_wx200"), ['floating.arms=["left"]'])
    text = refusal(log_of(cell, rows, agents={"left": rows}), arm=arm)
    assert "found arm left guided by a hand, whose force is in no log, expected one arm that moves by itself" in text
    assert "identify_wx200.toml" in text
    both = {"left": rows, "right": rows_of()}
    moves = refusal(log_of(cell, rows, agents=both), arm="right")
    assert "found 2 arms on one object" in moves, "the one that moves while the other floats holds it with that one"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"complete": False}, "the recorder did not finish it"),
        ({"complete": False, "problems": ("the file ends in the middle of a chunk",)}, "middle of a chunk"),
        ({"gaps": {"arm": ((10, 19), (30, 30))}}, "found 11 rows missing"),
        ({"agents": {"other": np.zeros(4000, AGENT_STATE.dtype)}}, "expected a complete log"),
    ],
)
def test_incomplete_logs_are_refused(changes: dict[str, Any], expected: str) -> None:
    assert expected in refusal(log_of(CELL, rows_of(), **changes))


def test_the_arm_file_is_that_of_the_log_and_not_the_one_that_is_installed() -> None:
    """Someone installed a new arm file after the run: the figures before would be wrong, and so the source."""
    other = FILES["wx200.toml"].replace(b"value = 0.012", b"value = 0.013")
    arm = from_log(log_of(CELL, rows_of(), attachments=FILES | {"wx200.toml": other})).arm
    assert arm.toml == other != CELL.arms[0].toml
    assert arm.servos != CELL.arms[0].servos


@pytest.mark.parametrize(
    ("name", "expected"), [("cell.toml", "does not hold its cell"), ("wx200.toml", "no wx200.toml")]
)
def test_a_log_without_the_files_of_its_cell_is_refused(name: str, expected: str) -> None:
    rest = {key: content for key, content in FILES.items() if key != name}
    with pytest.raises(ReplayError, match=expected):
        from_log(log_of(CELL, rows_of(), attachments=rest))


def test_a_log_of_a_version_with_another_key_for_the_delay_says_so() -> None:
    old = CELL.toml.replace(b"saturation = true", b"saturation = true\ndelay_cycles = 1")
    log = log_of(CELL, rows_of(), attachments=FILES | {"cell.toml": old})
    with pytest.raises(ConfigError, match=r"delay_cycles in cell\.toml of run\.mcap: .*write loop_delay_s"):
        from_log(log)


def test_holes_are_refused_with_their_share() -> None:
    rows = rows_of()
    assert "found 0.1% without a fresh state, up to 5 in a row" in refusal(
        log_of(CELL, np.delete(rows, range(1000, 1005)))
    )
    assert "found 5.0% without a fresh state, up to 1 in a row" in refusal(
        log_of(CELL, np.delete(rows, range(10, 3990, 20)))
    )


def test_a_run_that_stopped_early_is_refused() -> None:
    rows = rows_of()
    rows["mode"][2000:] = Mode.HOLD
    assert "found 10.0 s in TRACK, expected at least 15 s" in refusal(log_of(CELL, rows))
    rows["mode"] = Mode.READY
    assert "found 0.0 s in TRACK" in refusal(log_of(CELL, rows))
