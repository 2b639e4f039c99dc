"""A link that was away is told once, when it is back, with how long that took."""

from __future__ import annotations

import pytest

from agent.telemetry.link.cut import CutWatch


def test_a_link_that_was_away_is_told_once_when_it_is_back() -> None:
    linked = iter([False, True, True, False, False, True, True])
    watch = CutWatch(lambda: next(linked))
    told, away = {}, []
    for k in range(7):
        told[k] = watch.ended(float(k))
        away.append(watch.away)
    assert {k: for_s for k, for_s in told.items() if for_s is not None} == {5: pytest.approx(2.0)}
    assert away == [False, False, False, True, True, False, False], "before there was one, nothing is away"


def test_the_link_is_not_looked_at_in_every_cycle() -> None:
    looks: list[bool] = []
    watch = CutWatch(lambda: not looks.append(True))
    for k in range(100):
        watch.ended(0.01 * k)
    assert 9 <= len(looks) <= 11
