"""A run is held against each of its bounds, and what misses one is said with its figure."""

from __future__ import annotations

from dataclasses import replace

import pytest

from agent.faults.catalogue import Within
from agent.faults.judge import misses
from agent.faults.measure import GONE, Measured

GOOD = Measured(
    noticed_s=0.01,
    noticed="left: STALE",
    stopped_s={"left": 0.02, "right": 0.05},
    ended={"left": "HOLD", "right": "HOLD"},
    why={"left": "", "right": ""},
    internal_N=2.0,
    internal_before_N=0.5,
    sag_m=0.004,
    moved_rad=0.05,
    speed_rad_per_s=0.7,
    apart_rad=0.02,
    others_rad_per_s=0.6,
    fall_m_per_s=0.2,
    torque_share=0.9,
    strayed_m=0.006,
    misled_rad=0.01,
)
WITHIN = Within(
    noticed_s=0.01, reacted_s=0.05, internal_N=2.0, sag_m=0.004, moved_rad=0.05, speed_rad_per_s=0.7, apart_rad=0.02,
    others_rad_per_s=0.6, fall_m_per_s=0.2, grown_N=1.5, strayed_m=0.006, misled_rad=0.01,
)  # fmt: skip


def test_a_bound_itself_is_held() -> None:
    assert list(misses(GOOD, WITHIN)) == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"noticed_s": 0.011}, "noticed after 0.011 s, not ≤ 0.01"),
        ({"noticed_s": None}, "noticed never, not ≤ 0.01 s"),
        ({"stopped_s": {"left": 0.02, "right": 0.06}}, "right stopped after 0.06 s, not ≤ 0.05"),
        ({"stopped_s": {"left": None, "right": 0.05}}, "left stopped never, not ≤ 0.05 s"),
        ({"internal_N": 2.1, "internal_before_N": 0.6}, "internal force 2.1 N, not ≤ 2"),
        ({"internal_before_N": 0.4}, "internal force grown by 1.6 N, not ≤ 1.5"),
        ({"sag_m": 0.005}, "sag 0.005 m, not ≤ 0.004"),
        ({"moved_rad": 0.06}, "joints moved 0.06 rad, not ≤ 0.05"),
        ({"speed_rad_per_s": 0.8}, "fastest joint 0.8 rad/s, not ≤ 0.7"),
        ({"apart_rad": 0.03}, "arm and twin apart 0.03 rad, not ≤ 0.02"),
        ({"others_rad_per_s": 0.61}, "the others' fastest joint 0.61 rad/s, not ≤ 0.6"),
        ({"fall_m_per_s": 0.21}, "the object falls at 0.21 m/s, not ≤ 0.2"),
        ({"strayed_m": 0.007}, "the object moved by 0.007 m, not ≤ 0.006"),
        ({"strayed_m": float("nan")}, "the object moved by nan m, not ≤ 0.006"),
        ({"misled_rad": 0.011}, "a value used was off by 0.011 rad, not ≤ 0.01"),
    ],
)
def test_each_bound_is_missed_by_itself(change: dict[str, object], text: str) -> None:
    assert list(misses(replace(GOOD, **change), WITHIN)) == [text]


def test_only_who_must_stop_is_asked_and_who_is_gone_is_not() -> None:
    slow = replace(GOOD, stopped_s={"left": 0.02, "right": None})
    assert list(misses(slow, Within(reacted_s=0.05, who=("left",)))) == []
    assert list(misses(slow, Within(reacted_s=0.05, who=("right",)))) == ["right stopped never, not ≤ 0.05 s"]
    assert list(misses(replace(slow, ended={"left": "HOLD", "right": GONE}), Within(reacted_s=0.05))) == []


@pytest.mark.parametrize(("before_N", "after_N", "late"), [(1.0, 6.0, False), (1.0, 6.01, True), (0.0, 5.5, True)])
def test_a_late_reaction_is_as_good_where_the_force_has_not_grown(before_N: float, after_N: float, late: bool) -> None:
    slow = replace(GOOD, stopped_s={"left": 0.2}, internal_before_N=before_N, internal_N=after_N)
    told = ["left stopped after 0.2 s, not ≤ 0.15"] if late else []
    assert list(misses(slow, Within(reacted_s=0.15, or_grown_N=5.0))) == told
    assert list(misses(slow, Within(reacted_s=0.15))) == ["left stopped after 0.2 s, not ≤ 0.15"]


def test_a_motion_that_must_go_on_is_left_by_nobody() -> None:
    assert list(misses(GOOD, Within(goes_on=True))) == ["left and right left the motion: left: STALE"]
    one = replace(GOOD, stopped_s={"left": None, "right": 0.05})
    assert list(misses(one, Within(goes_on=True))) == ["right left the motion: left: STALE"]
    still = replace(GOOD, stopped_s={"left": None, "right": None})
    assert list(misses(still, Within(goes_on=True))) == []


def test_the_reaction_is_that_of_the_last_arm_that_lives() -> None:
    assert GOOD.reacted_s == 0.05
    assert replace(GOOD, stopped_s={"left": 0.02, "right": None}).reacted_s is None
    gone = replace(GOOD, stopped_s={"left": 0.02, "right": None}, ended={"left": "HOLD", "right": GONE})
    assert gone.reacted_s == 0.02
    assert gone.document()["reacted_s"] == 0.02
