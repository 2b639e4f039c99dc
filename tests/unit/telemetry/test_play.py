"""What is played of a log is what the log has, wherever the stretches that are in memory end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.log.columns import Table
from agent.log.read import LogError, RunLog
from agent.telemetry.link import play
from agent.telemetry.link.play import _STRETCH_ROWS, PlayOptions, _Messages, _Player, _tracks
from agent.telemetry.link.playhead import Order
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.topics import Address, Kind
from tests.support.telemetry.synthetic_run import as_log, run_file
from tests.support.telemetry.telemetry_cell import make_rows
from tests.support.view_run import view_log

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


def played(log: RunLog, **options: object) -> dict[str, list[int]]:
    """UTC, ns, at which each track plays."""
    columns = replace(log, agents={name: Table.of(rows) for name, rows in log.agents.items()})
    tracks = _tracks(PlayOptions(path=log.path, **options), columns)  # type: ignore[arg-type]
    return {track.key: track.times.tolist() for track in tracks}


def told(utc_ns: int) -> Event:
    return Event(utc_ns, "left", Level.INFO, f"at {utc_ns}")


def test_what_was_told_before_the_first_row_and_after_the_last_comes_with_these(tmp_path: Path) -> None:
    """How a run ended is told behind its last row, and was not played."""
    rows = view_log(1.0).agents["left"]
    first, last = int(rows["utc_ns"][0]), int(rows["utc_ns"][-1])
    middle = (first + last) // 2
    log = replace(
        as_log(tmp_path / "run.mcap", {"left": rows}, None, run_file()),
        events=[*map(told, (first - 9, middle, last + 9))],
    )
    key = Address(log.cell, "left", Kind.EVENT).replay_key
    assert played(log)[key] == [first, middle, last]
    assert played(log, start_s=0.1)[key] == [middle, last]
    assert played(log, stop_s=0.4)[key] == [first, middle]


def test_seconds_in_which_nothing_is_are_refused(tmp_path: Path) -> None:
    log = as_log(tmp_path / "run.mcap", {"left": view_log(1.0).agents["left"]}, None, run_file())
    with pytest.raises(LogError, match=r"nothing to play of .*: found nothing from 0\.0012 s to 0\.0013 s"):
        played(log, start_s=0.0012, stop_s=0.0013)


def player(log: RunLog, orders: Sequence[Order], seen: list[float]) -> _Player:
    """One to whom these are given, one a cycle."""
    given = iter(orders)
    options = PlayOptions(
        path=log.path,
        orders=lambda: [order] if (order := next(given, None)) else [],
        show=lambda head: seen.append(head.at_s),
    )
    columns = replace(log, agents={name: Table.of(rows) for name, rows in log.agents.items()})
    return _Player(_tracks(options, columns), options)


class Nobody(dict[str, Any]):
    """Publishers of whom nobody hears."""

    def __missing__(self, key: str) -> SimpleNamespace:
        return SimpleNamespace(put=lambda *_, **__: None)


def test_a_play_that_is_paused_stays_at_its_end_until_it_is_ended(tmp_path: Path) -> None:
    log = as_log(tmp_path / "run.mcap", {"left": view_log(1.0).agents["left"]}, None, run_file())
    seen = list[float]()
    player(log, [Order.PAUSE, Order.AHEAD, Order.BACK, Order.AHEAD, Order.QUIT], seen).play_once(
        Nobody(), lambda: False
    )
    assert seen[1:4] == pytest.approx([seen[1], 0.0, seen[1]])
    assert seen[1] > 0.4


def test_a_play_that_was_suspended_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = as_log(tmp_path / "run.mcap", {"left": view_log(8.0).agents["left"]}, None, run_file())
    now, seen = iter([0.0, 0.1, 100.1, 100.2]), list[float]()
    monkeypatch.setattr(play.time, "monotonic", lambda: next(now))
    made = player(log, [], seen)
    made.play_once(Nobody(), lambda: len(seen) >= 3)
    assert seen == pytest.approx([0.1, 1.1, 1.2])
