"""What a gripper's own words say of what it holds: verdicts over time, and the geometry behind a width and a force."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

import configs
from agent.config.cell import ConfigError, cell_from_toml, load_cell
from agent.config.schema.arm import GRIP_KEYS, GripperJoint
from agent.config.session import MEASURED, fingers, grip_plan
from agent.grip import GripPlan, GripResult
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.fingers import Fingers
from drivers.interface import GripState

PLAN = GripPlan(closed_m=0.03, open_m=0.074, width_m=0.044, effort=0.25)
WX200 = Fingers(0.014, 0.024, (1802 - 2048) * TICK_RAD, (2875 - 2048) * TICK_RAD)
MS = 1_000_000


def said(at_ms: int, width_m: float, speed: float = 0.0, effort: float = 0.25) -> GripState:
    return GripState(at_ms * MS, width_m, speed, effort, 10.0)


def closed(width_m: float, effort: float = 0.25, from_m: float = 0.074) -> list[GripResult]:
    """Verdicts while fingers close to a width within half a second and stand there."""
    watch = PLAN.begin(said(0, from_m))
    verdicts = []
    for ms in range(5, 5000, 5):
        moving = ms < 500 and width_m != from_m
        width = from_m + (width_m - from_m) * min(1.0, ms / 500)
        state = said(ms, width, -0.05 if moving else 0.0, effort)
        watch = PLAN.watch(watch, state)
        verdicts.append(PLAN.closing(watch, state))
    return verdicts


@pytest.mark.parametrize(
    ("width_mm", "effort", "verdict"),
    [
        (44.0, 0.25, GripResult.HOLDS), (46.9, 0.25, GripResult.HOLDS), (41.1, 0.25, GripResult.HOLDS),
        (30.0, 0.25, GripResult.NOTHING), (40.9, 0.25, GripResult.NOTHING), (47.1, 0.25, GripResult.TOO_EARLY),
        (44.0, 0.1, GripResult.NO_FORCE), (74.0, 0.25, GripResult.STUCK),
    ],
)  # fmt: skip
def test_what_closed_fingers_hold(width_mm: float, effort: float, verdict: GripResult) -> None:
    verdicts = closed(width_mm * 1e-3, effort)
    first = verdicts.index(verdict)
    assert set(verdicts[:first]) <= {GripResult.MOVING}
    assert set(verdicts[first:]) == {verdict}
    assert 0.5 <= 5e-3 * first <= 1.0 or verdict is GripResult.STUCK


def test_fingers_that_never_stand_are_judged_in_the_end() -> None:
    watch = PLAN.begin(said(0, 0.074))
    state = said(4100, 0.060, -0.05)
    assert PLAN.closing(PLAN.watch(watch, state), state) is GripResult.TOO_EARLY
    early = said(3900, 0.060, -0.05)
    assert PLAN.closing(PLAN.watch(watch, early), early) is GripResult.MOVING


def test_opening_is_done_at_the_open_width_and_stuck_short_of_it() -> None:
    watch = PLAN.begin(said(0, 0.044))
    assert PLAN.opening(watch, said(600, 0.072)) is GripResult.OPEN
    assert PLAN.opening(watch, said(300, 0.05)) is GripResult.MOVING
    assert PLAN.opening(watch, said(600, 0.05)) is GripResult.STUCK


def test_an_object_is_lost_when_the_fingers_come_nearer_than_it_is_wide() -> None:
    assert PLAN.lost(said(0, 0.0409))
    assert not PLAN.lost(said(0, 0.0411))


def test_widths_of_the_shipped_gripper_are_those_of_its_maker() -> None:
    assert WX200.closed_m == pytest.approx(0.030, abs=1e-4)
    assert WX200.open_m == pytest.approx(0.074, abs=1e-4)


def test_angle_and_width_are_inverse_and_the_lever_is_the_slope() -> None:
    for width in (0.031, 0.044, 0.05, 0.073):
        angle = WX200.angle(width)
        assert WX200.width(angle) == pytest.approx(width, abs=1e-9)
        slope = (WX200.width(angle + 1e-6) - WX200.width(angle - 1e-6)) / 2e-6
        assert WX200.lever(angle) == pytest.approx(slope, rel=1e-6)
    assert WX200.angle(0.2) == pytest.approx(WX200.open_rad)
    assert WX200.angle(0.0) == pytest.approx(WX200.closed_rad)


def test_the_plan_of_a_cell_closes_on_the_side_of_the_object_that_the_fingers_face() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml")
    plan = grip_plan(cell, cell.arms[0])
    assert (plan.width_m, plan.effort) == (0.044, 0.25)
    assert (plan.closed_m, plan.open_m) == (WX200.closed_m, WX200.open_m)
    assert math.isclose(fingers(cell.arms[0]).rod_length_m, 0.024)


def test_a_gripper_that_is_not_measured_is_refused_with_each_measure_and_its_key() -> None:
    text = (configs.CELLS_DIR / "three_wx250s.toml").read_text().replace('model = "wx250s"', 'model = "awx250s"')
    arm = cell_from_toml(text.encode(), "three_awx250s.toml").arms[0]
    with pytest.raises(ConfigError) as refused:
        fingers(arm)
    said = str(refused.value)
    assert "found no closed_tick, no open_tick, no rod_length_m, no grip_effort, expected" in said
    assert "measure closed_tick (position in `coop motors scan`, fingers shut by hand); open_tick (the same" in said
    assert "rod_length_m (a rod from pin to pin); grip_effort (share of stall torque" in said
    assert "horn_radius_m" not in said  # its file has that
    assert set(MEASURED) == set(GRIP_KEYS) < set(GripperJoint.model_fields)


def test_a_gripper_measured_in_a_file_of_its_own_closes(tmp_path: Path) -> None:
    own = (configs.ARMS_DIR / "awx250s.toml").read_text().replace(
        "horn_radius_m = 0.02",
        "horn_radius_m = 0.02\nrod_length_m = 0.03\nclosed_tick = 1802\nopen_tick = 2875\n"
        'grip_effort = { value = 0.25, status = "estimated", source = "a test" }',
    )  # fmt: skip
    (tmp_path / "mine.toml").write_text(own)
    text = (configs.CELLS_DIR / "three_wx250s.toml").read_text()
    (tmp_path / "cell.toml").write_text(text.replace('model = "wx250s"', 'model = "awx250s"\narm_file = "mine.toml"'))
    arm = load_cell(tmp_path / "cell.toml").arms[0]
    assert (fingers(arm).horn_radius_m, fingers(arm).rod_length_m) == (0.02, 0.03)
    assert fingers(arm).closed_m < 0.044 < fingers(arm).open_m


def test_a_servo_that_takes_no_command_on_the_bus_is_named() -> None:
    arm = load_cell(configs.CELLS_DIR / "two_wx200.toml").arms[0]
    gripper = arm.file.gripper.model_copy(update={"servo": "AX-12A"})
    old = replace(arm, file=arm.file.model_copy(update={"gripper": gripper}))
    with pytest.raises(ConfigError, match="found AX-12A, which takes no command on this bus, expected a servo with"):
        fingers(old)
