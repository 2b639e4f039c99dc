"""What servos bear for long: an advice, said by `coop check` and held against what shipped cells ask."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict
from drivers.dynamixel.servo.models import SERVOS
from tests.support.control.level_wx200 import LEVEL


@cache
def found(name: str, *overrides: str) -> list[Finding]:
    return [f for f in examine(load_cell(Path(name), overrides)).findings if f.what.startswith("current for long")]


def test_no_servo_of_two_wx200_carries_more_than_is_advised_for_long() -> None:
    assert [f.verdict for f in found("two_wx200")] == [Verdict.OK, Verdict.OK]
    assert all(f.found.startswith("20% of stall") for f in found("two_wx200"))


def test_elbows_of_arms_that_reach_out_level_carry_more() -> None:
    level = found("two_wx200", *LEVEL)
    assert [(f.what, f.where, f.verdict) for f in level] == [
        ("current for long, elbow", "left", Verdict.WARNING),
        ("current for long, elbow", "right", Verdict.WARNING),
    ]
    assert all(f.found.startswith("26% of stall") for f in level)
    assert all(f.wanted.startswith("≤ 20%") for f in level)


def test_the_arms_of_the_paper_carry_less() -> None:
    assert [f.verdict for f in found("paper_real")] == [Verdict.OK, Verdict.OK]
    assert all(f.found.startswith("11% of stall") for f in found("paper_real"))


def test_a_servo_bears_a_fifth_of_its_stall_current_for_long() -> None:
    assert SERVOS["XM430-W350"].continuous_current_A == pytest.approx(0.2 * 2.3)
