"""What is played of a log is what the log has, wherever the stretches that are in memory end."""

from __future__ import annotations

import pytest

from agent.log.columns import Table
from agent.telemetry.link.play import _STRETCH_ROWS, _Messages
from tests.support.telemetry.telemetry_cell import make_rows

COUNT = 2 * _STRETCH_ROWS + 300


@pytest.mark.parametrize("batch", [1, 20, 1000, _STRETCH_ROWS + 7])
def test_messages_are_the_rows_in_their_order_and_again_after_a_rewind(batch: int) -> None:
    rows = make_rows("left", COUNT)
    messages = _Messages(Table.of(rows))
    for _ in range(2):
        played = b"".join(messages(at, min(COUNT, at + batch)) for at in range(0, COUNT, batch))
        assert played == rows.tobytes()


def test_nothing_is_no_message() -> None:
    assert _Messages(Table.of(make_rows("left", 0)))(0, 0) == b""
