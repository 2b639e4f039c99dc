"""How telemetry asks the recorder what it has: one question at a time, and not for ever the same."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh

from agent.telemetry.link import status
from agent.telemetry.link.status import StatusQuery


class Silent:
    """A question that Zenoh neither answers nor ends, or ends at once."""

    def __init__(self, *, ends: bool) -> None:
        self._ends = ends

    def try_recv(self) -> None:
        if self._ends:
            raise zenoh.ZError("closed")


class Session:
    def __init__(self, *, ends: bool = False) -> None:
        self.asked, self._ends = 0, ends

    def get(self, *_: Any, **__: Any) -> Silent:
        self.asked += 1
        return Silent(ends=self._ends)


@pytest.fixture(autouse=True)
def linked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "has_link", lambda _: True)


def test_a_question_that_is_never_ended_is_given_up_after_twice_its_time_and_asked_again() -> None:
    session = Session()
    query = StatusQuery(session, "paper", b"", 0.25)  # type: ignore[arg-type]
    asked = []
    for tick in range(100):
        assert query.poll(100.0 + 0.1 * tick) is None
        asked.append(session.asked)
    assert asked[0] == asked[40] == 1
    assert asked[41] == asked[81] == 2
    assert asked[83] == 3


def test_one_that_is_ended_is_asked_again_after_its_period() -> None:
    session = Session(ends=True)
    query = StatusQuery(session, "paper", b"", 0.25)  # type: ignore[arg-type]
    for tick in range(11):
        query.poll(100.0 + 0.1 * tick)
    assert session.asked == 4
