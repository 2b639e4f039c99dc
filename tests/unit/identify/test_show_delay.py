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


@pytest.mark.parametrize(("value_s", "told"), [(4e-3, False), (4.59e-3, False), (4.61e-3, True), (3.39e-3, True)])
def test_a_delay_that_is_another_one_than_believed_is_told_with_what_it_costs(value_s: float, told: bool) -> None:
    line = said(Delay(value_s, 0.2e-3, 4e-3))
    assert line.startswith(f"loop delay: {value_s:.4f} s ± 0.0002 (loop_delay_s, or one period: 0.004)")
    assert line.endswith("set loop_delay_s and record again") is told


def test_a_delay_that_was_not_seen_says_nothing_of_the_file() -> None:
    assert said(None) == "loop delay: not to be seen in this motion"
