"""One key of the recorder: what it tells a publisher of a log that has ended."""

from __future__ import annotations

import pytest

from agent.telemetry.link.stream import Stream
from agent.telemetry.link.wire import BatchHeader, End
from agent.telemetry.row.topics import Address, Kind


@pytest.mark.parametrize(
    ("lost", "have"),
    [
        (0, ((0, 9), (20, 24))), (1, ((0, 9), (20, 23))), (4, ((0, 9), (20, 20))), (5, ((0, 9),)), (6, ((0, 8),)),
        (14, ((0, 0),)), (15, ()), (99, ()),
    ],
)  # fmt: skip
def test_a_log_that_ended_without_the_last_rows_has_the_others(lost: int, have: tuple[tuple[int, int], ...]) -> None:
    stream = Stream(Address("paper", "left", Kind.STATE))
    stream.turn_to(42)
    stream.note(BatchHeader(42, 0, 30, 0), 10)
    stream.note(BatchHeader(42, 20, 30, 0, End.FINISHED), 5)
    told = stream.kept(lost)
    assert (told.source, told.have, told.ended) == (42, have, True)
    assert stream.status.have == ((0, 9), (20, 24))
