"""What a recorder keeps is judged by what two hours of it would add."""

from __future__ import annotations

from tests.soak.hours import BLOCKS_MAX, LOGS_MIN, MEMORY_MAX_MB, Taken, judged


def taken(blocks_each: float, memory_each: float = 0.0, logs: int = 100) -> Taken:
    """So much more at each log."""
    numbers = [float(i) for i in range(logs)]
    return Taken(numbers, [1e5 + blocks_each * i for i in numbers], [50.0 + memory_each * i for i in numbers])


def test_blocks_are_judged_by_what_the_hours_left_out_would_add() -> None:
    """From the middle of the settled window to that of the last one, half of the logs go by."""
    per_log = BLOCKS_MAX / 12.0 / 50.0
    assert judged(taken(0.9 * per_log), 12.0) == []
    (complaint,) = judged(taken(1.1 * per_log), 12.0)
    assert "blocks of memory more in 7200 s" in complaint
    assert judged(taken(1.1 * per_log), 6.0) == []


def test_memory_is_judged_as_it_was() -> None:
    assert judged(taken(0.0, 0.9 * MEMORY_MAX_MB / 50.0), 12.0) == []
    assert judged(taken(0.0, 1.1 * MEMORY_MAX_MB / 50.0), 12.0) == ["memory rose by 3.3 MB, at most 3"]


def test_a_few_logs_say_nothing() -> None:
    assert len(judged(taken(0.0, logs=LOGS_MIN - 1), 1.0)) == 1
    assert judged(taken(0.0, logs=LOGS_MIN), 1.0) == []
