"""Who bears how much: the worst survivor at every place, and the worst place of every survivor."""

from __future__ import annotations

import math

import numpy as np

from agent.verify.loads import Load, loads, unbearable

FIRST, THIRD = np.array([[0.1, 0.4], [0.2, 0.3], [0.5, 0.1]]), np.array([[0.2, 0.1], [0.6, 0.7], [0.1, 0.3]])


def test_the_worst_survivor_at_every_place_and_the_worst_place_of_every_survivor() -> None:
    found = loads({0: FIRST, 2: THIRD})
    assert found.along == (Load(0.4, 0, 1, 0), Load(0.7, 2, 1, 1), Load(0.5, 0, 0, 2))
    assert found.each == (Load(0.5, 0, 0, 2), Load(0.7, 2, 1, 1))
    assert found.most == Load(0.7, 2, 1, 1)


def test_of_weights_that_nothing_balances_no_survivor_has_a_part_of_stall() -> None:
    found = unbearable([1, 2], 3)
    assert [(load.share, load.arm, load.place) for load in found.along] == [(math.inf, 1, k) for k in range(3)]
    assert [(load.share, load.arm) for load in found.each] == [(math.inf, 1), (math.inf, 2)]
