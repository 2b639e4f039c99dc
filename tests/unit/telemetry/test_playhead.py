"""What the keys of a player do to where it stands, and which keys they are."""

from __future__ import annotations

import pytest

from agent.cli.keys import KEYS, orders_of
from agent.telemetry.link.playhead import PACE, SEEK_S, SPEED_MAX, SPEED_MIN, Order, Playhead


def head(at_s: float = 12.0, speed: float = 1.0) -> Playhead:
    return Playhead(20.0, speed, at_s)


def test_time_passes_at_the_pace_unless_it_is_paused() -> None:
    h = head(speed=4.0)
    h.pass_time(0.5)
    assert h.at_s == 14.0
    assert h.take(Order.PAUSE, None) is False
    h.pass_time(0.5)
    assert (h.at_s, h.paused) == (14.0, True)
    h.take(Order.PAUSE, None)
    h.pass_time(0.5)
    assert (h.at_s, h.paused) == (16.0, False)


@pytest.mark.parametrize("speed", [10.0, 1e308])
def test_time_passes_to_the_end_at_most_however_fast(speed: float) -> None:
    h = head(speed=speed)
    for _ in range(2):
        h.pass_time(10.0)
        assert h.at_s == h.length_s


def test_a_step_goes_to_the_next_message_and_stays() -> None:
    h = head()
    assert h.take(Order.STEP, 12.005) is False
    assert (h.at_s, h.paused) == (12.005, True)
    h.take(Order.STEP, None)
    assert h.at_s == 12.005, "there is none behind the last"


@pytest.mark.parametrize(
    ("order", "at_s", "to_s"),
    [
        (Order.BACK, 12.0, 12.0 - SEEK_S),
        (Order.BACK, 2.0, 0.0),
        (Order.AHEAD, 12.0, 12.0 + SEEK_S),
        (Order.AHEAD, 18.0, 20.0),
        (Order.BEGIN, 12.0, 0.0),
    ],
)
def test_a_seek_stays_within_the_log_and_is_told_of(order: Order, at_s: float, to_s: float) -> None:
    h = head(at_s)
    assert h.take(order, 12.005) is True
    assert (h.at_s, h.paused) == (to_s, False)


def test_the_pace_has_limits_that_one_asked_for_at_the_start_may_exceed() -> None:
    h = head()
    h.take(Order.FASTER, None)
    assert h.speed == PACE
    for _ in range(40):
        h.take(Order.FASTER, None)
    assert h.speed == SPEED_MAX
    for _ in range(80):
        h.take(Order.SLOWER, None)
    assert h.speed == SPEED_MIN
    fast = head(speed=5000.0)
    fast.take(Order.FASTER, None)
    assert fast.speed == 5000.0


def test_quit_ends_it() -> None:
    h = head()
    h.take(Order.QUIT, None)
    assert h.quit


def test_every_order_has_a_key_and_keys_come_in_any_pieces() -> None:
    assert set(KEYS.values()) == set(Order)
    typed = b"".join(KEYS)
    for cut in range(len(typed) + 1):
        first, rest = orders_of(typed[:cut])
        second, nothing = orders_of(rest + typed[cut:])
        assert first + second == list(KEYS.values())
        assert nothing == b""


@pytest.mark.parametrize("typed", [b"x", b"\x1b[A", b"\xff\xfe", b"\x1b\x1b", b"\n"])
def test_a_key_without_a_meaning_is_left_out(typed: bytes) -> None:
    found, rest = orders_of(typed + b" ")
    assert found == [Order.PAUSE]
    assert rest == b""
