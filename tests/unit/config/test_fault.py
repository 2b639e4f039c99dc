"""A fault of a cell or a study happens in the first cycle that begins at its instant or later."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.config.cell import ConfigError, load_cell
from agent.config.schema.fault import Fault, FaultKind


def at(at_s: float) -> Fault:
    return Fault(kind=FaultKind.LIMP, arm="left", at_s=at_s)


@pytest.mark.parametrize(
    ("at_s", "period_ns", "cycle"),
    [(0.0, 5_000_000, 0), (0.3, 5_000_000, 60), (0.301, 5_000_000, 61), (0.3049, 5_000_000, 61), (1.0, 16_666_667, 60)],
)
def test_it_happens_in_the_cycle_of_its_instant_or_the_next(at_s: float, period_ns: int, cycle: int) -> None:
    assert at(at_s).cycle(period_ns) == cycle


@given(at_s=st.floats(0.0, 1e4), period_ns=st.sampled_from([2_000_000, 5_000_000, 16_666_667, 33_333_333]))
def test_no_cycle_before_it_begins_at_its_instant_or_later(at_s: float, period_ns: int) -> None:
    found, exact = at(at_s).cycle(period_ns), Fraction(at_s) * 10**9 / period_ns
    assert abs(found - math.ceil(exact)) <= (abs(exact - round(exact)) < 1e-6)
    assert found * period_ns * 1e-9 >= at_s


def test_one_of_an_arm_that_is_not_there_or_of_no_kind_is_refused() -> None:
    for entry, match in (
        ("{kind='limp', arm='middle', at_s=1.0}", r"simulation\.fault\.0\.arm.* found middle, expected left or right"),
        ("{kind='lame', arm='left', at_s=1.0}", r"simulation\.fault.*kind.*'lame'"),
        ("{kind='limp', arm='left', at_s=-1.0}", r"simulation\.fault.*at_s.*-1"),
    ):
        with pytest.raises(ConfigError, match=match):
            load_cell(Path("paper"), [f"simulation.fault=[{entry}]"])


def test_a_person_is_told_what_whom_and_when() -> None:
    assert at(1.25).told == "limp left at 1.25 s"
