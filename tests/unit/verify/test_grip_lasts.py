"""A gripper that presses harder than its servo bears for long is warned of, however well it would hold."""

from __future__ import annotations

from dataclasses import replace

import pytest

import configs
from agent.config.cell import load_cell
from agent.verify import session
from agent.verify.finding import Verdict


@pytest.mark.parametrize(("effort", "warned"), [(0.25, False), (0.39, False), (0.4, True), (1.0, True)])
def test_a_grip_that_its_servo_calls_an_overload_is_warned_of(effort: float, warned: bool) -> None:
    """`coop check` found 0.6 well; both grippers of emulated servos let go after five seconds of the motion."""
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.lift_m=0.02"])
    assert "grip for long" not in [finding.what for finding in session.session(cell, session.lives(cell))]
    arm = cell.arms[0]
    gripper = arm.file.gripper
    assert gripper is not None
    assert gripper.grip_effort is not None
    pressing = gripper.model_copy(update={"grip_effort": gripper.grip_effort.model_copy(update={"value": effort})})
    found = session._grip_lasts(replace(arm, file=arm.file.model_copy(update={"gripper": pressing})))
    assert bool(found) is warned
    for finding in found:
        assert finding.verdict is Verdict.WARNING
        assert finding.line.startswith(
            f"left: grip for long: found {effort:.0%} of stall, wanted below 40%; lower grip"
        )
