"""What somebody who watches a run is told of its newest row."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.process.progress import HowFar
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE


class Watching:
    def __init__(self) -> None:
        self.told: list[tuple[float, float, float, float | None]] = []

    def phase(self, what: str, **_: object) -> None:
        raise AssertionError(what)

    def note(self, text: str) -> None:
        raise AssertionError(text)

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        self.told.append((t_s, duration_s, speed, error_mm))


def test_time_pace_and_error_of_the_newest_row_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("agent.process.progress.time.monotonic", lambda: now_s)
    watching = Watching()
    with (
        RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", slots=8) as writer,
        RingReader(tmp_path / "left.ring", AGENT_STATE) as rows,
    ):
        how_far = HowFar(rows, watching, 20.0)
        how_far.look()
        assert watching.told == [], "there is no row yet"
        for t, at_s in ((-3.0, 101.0), (-1.0, 140.0), (0.5, 142.0), (2.5, 146.0)):
            writer.row["t"], now_s = t, at_s
            writer.row["e_p"] = (3e-3, 0.0, 4e-3)
            writer.commit()
            how_far.look()
    assert [told[:3] for told in watching.told] == [
        (-3.0, 20.0, 0.0), (-1.0, 20.0, 0.0), (2.5, 20.0, 0.5)
    ], "the wait for a start says nothing about the pace"  # fmt: skip
    assert watching.told[-1][3] == pytest.approx(5.0)
