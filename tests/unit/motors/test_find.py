"""Which ID a reply in pieces is of, where it may come late; tests/process/motors has the servos themselves."""

from __future__ import annotations

from collections.abc import Set
from types import SimpleNamespace
from typing import cast

import pytest

from agent.motors.find import Answers, shared_ids
from drivers.dynamixel.errors import Heard, NoReplyError
from drivers.dynamixel.line.bus import Bus, Ping

BAUD = 1_000_000


class LateBus:
    """Two servos share each of `shared`.

    The first reply to one of `late` comes while the next ID is asked, that to one of `lasting` until then.
    """

    def __init__(self, shared: Set[int], late: Set[int], lasting: Set[int] = frozenset()) -> None:
        self.shared, self.late, self.lasting = shared, set(late), lasting
        self.on_the_way = False
        self.asked: list[int] = []
        self.port = SimpleNamespace(set_baud=lambda _: None)

    def ping(self, servo_id: int, attempts: int) -> Ping:
        assert attempts == 1
        self.asked.append(servo_id)
        came, is_late = self.on_the_way, servo_id in self.late
        self.late.discard(servo_id)
        self.on_the_way = is_late or servo_id in self.lasting
        destroyed = came or (servo_id in self.shared and not is_late)
        heard = Heard.DAMAGED if destroyed else Heard.NOTHING
        raise NoReplyError(servo_id, "ping", attempts=1, heard=heard)

    def settle(self) -> None:
        self.on_the_way = False


@pytest.mark.parametrize(
    ("shared", "late"),
    [({5}, set()), ({5}, {5}), ({1}, {1}), ({5, 6}, {5}), ({5, 9}, {5, 9}), ({252}, set()), ({0}, set())],
)
def test_the_id_is_that_whose_replies_destroy_each_other_though_one_comes_late(
    shared: set[int], late: set[int]
) -> None:
    bus = LateBus(shared, late)
    assert shared_ids(cast(Bus, bus), Answers(BAUD, (), damaged=len(shared))) == sorted(shared)


def test_a_reply_that_lasts_makes_its_neighbours_share_no_id() -> None:
    bus = LateBus({5}, set(), lasting={5})
    assert shared_ids(cast(Bus, bus), Answers(BAUD, (), damaged=2)) == [5]


def test_an_id_that_answered_is_not_asked_again_and_nobody_is_behind_the_last_one_that_shares() -> None:
    bus, heard = LateBus({5}, set()), tuple(Ping(servo_id, 1020, 45) for servo_id in (2, 3, 3))
    assert shared_ids(cast(Bus, bus), Answers(BAUD, heard, damaged=1)) == [3, 5]
    assert not {2, 3} & set(bus.asked)
    assert max(bus.asked) == 5


def test_without_replies_in_pieces_nobody_is_asked() -> None:
    bus = LateBus({5}, set())
    assert shared_ids(cast(Bus, bus), Answers(BAUD, (), damaged=0)) == []
    assert bus.asked == []
