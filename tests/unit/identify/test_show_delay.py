"""What is said of a loop's delay that is another one than the figures were found with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.identify.delay import Delay
from agent.identify.result import Identified
from agent.identify.show import delay_line


def said(delay: Delay | None) -> str:
    result: Any = SimpleNamespace(fit=SimpleNamespace(delay=delay))
    return delay_line(cast(Identified, result))


LOOKS = "loop delay: {:.4f} s ± 0.0002 (loop_delay_s, or one period: 0.004)"


@pytest.mark.parametrize(("value_s", "off"), [(4e-3, False), (4.59e-3, False), (4.61e-3, True), (3.39e-3, True)])
def test_a_delay_that_is_not_the_one_of_the_figures_is_told_with_what_it_costs(value_s: float, off: bool) -> None:
    line = said(Delay(value_s, 0.2e-3, 4e-3, 4e-3))
    costs = "; the figures are those of 0.004 s: viscous friction above all is off by that"
    assert line == LOOKS.format(value_s) + (costs if off else "")


def test_a_delay_that_was_taken_instead_of_the_believed_one_is_told() -> None:
    line = said(Delay(6.01e-3, 0.2e-3, 4e-3, 6.0e-3))
    assert line == LOOKS.format(6.01e-3) + "; the figures are those of 0.006 s: set loop_delay_s to it"


@pytest.mark.parametrize(("sigma_s", "by_friction_s", "told"), [(1e-3, 0.99e-3, True), (1e-3, 0.5e-3, False)])
def test_a_delay_that_other_friction_explains_as_well_is_told(sigma_s: float, by_friction_s: float, told: bool) -> None:
    line = said(Delay(6e-3, sigma_s, 4e-3, 4e-3, by_friction_s))
    found = "loop delay: 0.0060 s ± 0.001 (loop_delay_s, or one period: 0.004)"
    why = "; not told apart from sticking and other friction: the figures are those of the believed one"
    assert line == found + (why if told else "")


def test_a_delay_that_was_not_seen_says_nothing_of_the_file() -> None:
    assert said(None) == "loop delay: not to be seen in this motion"
