"""Where things were at some instants: which of them a time is at, which a stretch has, whose object is shown."""

from __future__ import annotations

import numpy as np

from agent.view.motion import ArmMotion, Motion

T = np.array([0.0, 0.05, 0.1, 0.15])
K = len(T)


def motion(*, true: bool) -> Motion:
    rows = np.arange(7.0 * K).reshape(K, 7)
    three = np.zeros((K, 3))
    arms = {
        name: ArmMotion(three, rows + k, rows, three, three, np.zeros(K, np.int64), np.ones(K, np.bool_))
        for k, name in enumerate(("left", "right"), 1)
    }
    return Motion(T, arms, rows + 100.0 if true else None)


def test_the_object_is_where_it_truly_is_or_where_the_first_arm_believes_it() -> None:
    for true, first in ((True, 100.0), (False, 1.0)):
        assert motion(true=true).object[0, 0] == first


def test_a_time_is_at_the_last_instant_that_is_not_a_microsecond_after_it() -> None:
    own = motion(true=True)
    assert [own.row_at(t) for t in (-1.0, 0.05 - 1.5e-6, 0.05 - 5e-7, 0.05, 0.09, 9.0)] == [0, 0, 1, 1, 1, 3]


def test_a_stretch_has_its_first_instant_and_not_its_end_but_for_rounding() -> None:
    own = motion(true=True)
    for begin, end, rows in (
        (0.05, 0.15, [1, 2]), (0.05 + 5e-10, 0.15 + 5e-10, [1, 2]), (0.05 + 1.5e-9, 0.15 + 1.5e-9, [2, 3]),
    ):  # fmt: skip
        part = own.within(begin, end)
        assert part.t.tolist() == T[rows].tolist()
        assert part.true is not None
        np.testing.assert_array_equal(part.true, own.object[rows])
        np.testing.assert_array_equal(part.arms["right"].belief, own.arms["right"].belief[rows])
    assert motion(true=False).within(0.0, 0.1).true is None
