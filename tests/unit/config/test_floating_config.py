"""What a cell's files make of an arm that floats: what it knows of the object, its limits, and what stops it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agent.calm import brake_per_s
from agent.config import floating, monitors
from agent.config.agent import build_agent
from agent.config.cell import Cell, load_cell
from agent.monitors.bounds import Name
from drivers.interface import END_STOP_RAD

ALONE = ('floating.arms=["left"]',)
TOGETHER = (*ALONE, "floating.holding=true", "floating.others_move=true")
SPEED = "floating.speed_max_rad_per_s=0.4"


@cache
def cell_of(*settings: str) -> Cell:
    return load_cell(Path("two_wx200"), [*settings])


@pytest.mark.parametrize(
    ("settings", "names"), [((), []), (ALONE, ["left"]), (TOGETHER, ["left", "right"])], ids=["none", "one", "together"]
)
def test_the_arms_that_take_part_float_or_move_while_others_do(settings: tuple[str, ...], names: list[str]) -> None:
    cell = cell_of(*settings)
    assert [arm.name for arm in floating.taking_part(cell)] == names
    assert [arm.name for arm in cell.arms if floating.spec_of(cell, arm) is cell.file.floating is not None] == names


def test_an_arm_floats_by_the_limits_and_shares_of_its_files() -> None:
    cell = cell_of(*ALONE, SPEED, "floating.friction_share=0.25", "floating.drag_per_s=3.0", "rate_hz=125.0")
    arm, spec = cell.arms[0], cell.file.floating
    assert spec is not None
    made, model = floating.build(cell, arm, spec), cell.model(arm).model
    assert np.array_equal(made.low_rad, model.lowerPositionLimit)
    assert np.array_equal(made.high_rad, model.upperPositionLimit)
    assert np.allclose(made.tau_max_Nm, cell.file.safety.tau_max_fraction_of_stall * arm.tau_stall_Nm, rtol=1e-15)
    assert np.allclose(made.friction_Nm, [0.25 * servo.coulomb_Nm.value for servo in arm.servos], rtol=1e-15)
    assert (made.speed_max_rad_per_s, made.drag_per_s, made.brake_per_s) == (0.4, 3.0, brake_per_s(0.008))
    for array in (made.low_rad, made.high_rad, made.tau_max_Nm, made.friction_Nm):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    model.lowerPositionLimit[0] += 1.0
    assert made.low_rad[0] == model.lowerPositionLimit[0] - 1.0, "a copy"
    model.lowerPositionLimit[0] -= 1.0


def test_who_does_not_hold_the_object_knows_nothing_of_its_weight() -> None:
    cell = cell_of()
    offline = build_agent(cell, cell.arms[0]).offline
    alone, together = (cell_of(*settings).file.floating for settings in (ALONE, TOGETHER))
    assert alone is not None
    assert together is not None
    assert floating.carried(offline, together) is offline
    assert floating.carried(offline, alone) == replace(offline, object_mass_kg=0.0, object_inertia=(0.0,) * 9)


def test_what_stops_a_floating_arm_is_too_hard_a_push_an_end_stop_or_its_servos() -> None:
    cell = cell_of(*ALONE, SPEED)
    arm, spec = cell.arms[0], cell.file.floating
    assert spec is not None
    found, usual, model = floating.bounds(cell, arm, spec), monitors.bounds(cell, arm), cell.model(arm).model
    of_motion = {Name.POWER, Name.START, Name.WORKSPACE, Name.FROZEN, Name.LOAD, Name.GRAVITY}
    assert found.speed_rad_per_s == (1.0,) * 3, "2.5 times the largest"
    assert np.allclose(np.array(found.position_rad).T[0], model.lowerPositionLimit - 0.03, rtol=1e-15)
    assert np.allclose(np.array(found.position_rad).T[1], model.upperPositionLimit + 0.03, rtol=1e-15)
    assert found.watched == usual.watched - of_motion == floating.WATCHED
    assert replace(found, watched=usual.watched, speed_rad_per_s=usual.speed_rad_per_s) == replace(
        usual, position_rad=found.position_rad
    )


def test_a_monitor_that_the_cell_switches_off_stays_off() -> None:
    cell = cell_of(*ALONE, 'safety.monitors.off=["voltage", "power"]')
    assert cell.file.floating is not None
    found = floating.bounds(cell, cell.arms[0], cell.file.floating)
    assert found.watched == floating.WATCHED - {Name.VOLTAGE}


def test_an_arm_that_moves_while_others_float_has_its_own_bounds_and_the_speed_s() -> None:
    for settings in ((*TOGETHER, SPEED), (*TOGETHER, "floating.speed_max_rad_per_s=2.0")):
        cell = cell_of(*settings)
        arm, spec = cell.arms[1], cell.file.floating
        assert spec is not None
        usual = monitors.bounds(cell, arm)
        fastest = 2.5 * spec.speed_max_rad_per_s
        assert floating.bounds(cell, arm, spec) == replace(
            usual, speed_rad_per_s=tuple(min(own, fastest) for own in usual.speed_rad_per_s)
        )


def test_joints_may_be_a_little_beyond_their_limits_at_the_start() -> None:
    cell = cell_of()
    arm = cell.arms[0]
    model = cell.model(arm).model
    low, high = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    for end, sign in ((low, -1.0), (high, 1.0)):
        assert floating.outside(cell, arm, end + sign * 0.0299) == []
        found = floating.outside(cell, arm, end + sign * 0.0301)
        assert [name for name, *_ in found] == list(arm.entry.controlled)
        assert [row[1:] for row in found] == list(zip(end + sign * 0.0301, low, high, strict=True))
    just = low[0] - END_STOP_RAD
    assert floating.outside(cell, arm, np.array([just, 0.0, 0.0])) == []
    just = high[0] + END_STOP_RAD
    assert floating.outside(cell, arm, np.array([just, 0.0, 0.0])) == []
