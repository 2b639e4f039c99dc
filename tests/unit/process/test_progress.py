"""What somebody who watches a run is told of its newest row."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.process import progress
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


def test_time_speed_and_error_of_the_newest_row_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.process.progress.time.monotonic", lambda: 104.0)
    watching = Watching()
    with (
        RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", slots=8) as writer,
        RingReader(tmp_path / "left.ring", AGENT_STATE) as rows,
    ):
        progress.show(rows, watching, began_s=100.0, duration_s=20.0)
        assert watching.told == [], "there is no row yet"
        for t in (1.0, 2.0):
            writer.row["t"] = t
            writer.row["e_p"] = (3e-3, 0.0, 4e-3)
            writer.commit()
        progress.show(rows, watching, began_s=100.0, duration_s=20.0)
    ((t_s, duration_s, speed, error_mm),) = watching.told
    assert (t_s, duration_s, speed) == (2.0, 20.0, 0.5)
    assert error_mm == pytest.approx(5.0)
