"""Whether an arm that is to rehearse holds something."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.interface import Vector
from sim_backend.hil.gripper import PATIENCE_S, Carried, GripperCheck

T_NS = 5_000_000
GRAVITY, WEIGHT, FRICTION = np.array([1.0, 0.5]), np.array([0.4, 0.2]), np.array([0.05, 0.05])
BLUR = float(WEIGHT @ FRICTION / (WEIGHT @ WEIGHT))  # 0.15
ZERO = np.zeros(2)


def looked(share: float, dq: Callable[[int], Vector] = lambda _: ZERO, cycles: int = 80) -> GripperCheck:
    check = GripperCheck(Carried(lambda _: GRAVITY, lambda _: WEIGHT, FRICTION, 0.3))
    for k in range(cycles):
        if not check.done:
            check.look(k * T_NS, ZERO, dq(k), GRAVITY + share * WEIGHT)
    return check


@pytest.mark.parametrize(
    ("share", "loaded"),
    [(0.0, False), (0.3 + BLUR - 0.01, False), (0.3 + BLUR + 0.01, True), (1.0, True), (-1.0, False)],
)
def test_what_is_more_than_friction_and_a_share_of_the_weight_is_an_object(share: float, loaded: bool) -> None:
    check = looked(share)
    assert check.done
    assert check.loaded is loaded
    assert check.share == pytest.approx(share)
    assert check.blur == pytest.approx(BLUR)


def test_only_an_arm_at_rest_tells_and_one_that_never_rests_is_let_go_on() -> None:
    still_s = 60
    moving = looked(1.0, lambda k: np.array([0.0, 0.1]) if k % still_s == still_s - 1 else ZERO, cycles=400)
    assert not moving.done, "the mean begins anew with every motion"
    lasting = looked(1.0, lambda _: np.array([0.0, 0.1]), cycles=round(PATIENCE_S * 200) + 2)
    assert lasting.done
    assert not lasting.loaded


def test_torques_that_nobody_has_sent_yet_tell_nothing() -> None:
    check = GripperCheck(Carried(lambda _: GRAVITY, lambda _: WEIGHT, FRICTION, 0.3))
    for k in range(100):
        check.look(k * T_NS, ZERO, ZERO, np.full(2, np.nan) if k % 2 else ZERO)
    assert not check.done
