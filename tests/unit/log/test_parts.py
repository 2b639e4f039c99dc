"""When a log is followed by the next one, what that is called, and which logs make room for it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from agent.log import parts
from agent.log.parts import Limits, make_room, next_path
from agent.log.read import read_log
from agent.log.recover import recover
from tests.support.telemetry.log_maker import make_log


@pytest.mark.parametrize(
    ("limits", "size", "age_s", "reached"),
    [
        (Limits(), 1 << 60, 1e9, False),
        (Limits(part_bytes=100), 99, 1e9, False),
        (Limits(part_bytes=100), 100, 0.0, True),
        (Limits(part_s=60.0), 1 << 60, 59.9, False),
        (Limits(part_s=60.0), 0, 60.0, True),
        (Limits(part_bytes=100, part_s=60.0), 100, 1.0, True),
    ],
)
def test_a_log_ends_at_its_size_or_age_whichever_comes_first(
    limits: Limits, size: int, age_s: float, reached: bool
) -> None:
    assert limits.reached(size, age_s) == reached


def test_the_next_log_has_the_next_free_name(tmp_path: Path) -> None:
    first = tmp_path / "run.mcap"
    assert next_path(first).name == "run_2.mcap"
    (tmp_path / "run_2.mcap").touch()
    assert next_path(first) == tmp_path / "run_3.mcap"
    (tmp_path / "run_3.mcap").symlink_to("nothing")
    assert next_path(first) == tmp_path / "run_4.mcap"


def test_a_log_that_nobody_has_mended_yet_makes_no_room_and_counts(tmp_path: Path) -> None:
    rows = make_log(tmp_path / "killed.mcap", finish=False)
    make_log(tmp_path / "older.mcap", 50)
    os.utime(tmp_path / "killed.mcap", ns=(1, 1))
    sizes = {name: (tmp_path / name).stat().st_size for name in ("killed.mcap", "older.mcap")}
    assert make_room(tmp_path, sizes["killed.mcap"] + sizes["older.mcap"] - 1) == (tmp_path / "older.mcap",)
    assert read_log(tmp_path / "killed.mcap").agents["left"].tobytes() == rows["left"].tobytes()
    recover(tmp_path / "killed.mcap")
    assert make_room(tmp_path, 0) == (tmp_path / "killed.mcap",)


@pytest.mark.parametrize("asked", [1, 2])
def test_a_log_that_somebody_else_removes_meanwhile_stops_nobody_and_counts_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: int
) -> None:
    """asked: how often the oldest log was looked at before it was gone."""
    for k, name in enumerate(("a", "b", "c")):
        make_log(tmp_path / f"{name}.mcap", 50)
        os.utime(tmp_path / f"{name}.mcap", ns=(k, k))
    looked, is_written = [0], parts.is_written
    size = (tmp_path / "c.mcap").stat().st_size

    def is_ours(path: Path) -> bool:
        gone(path, 1)
        return True

    def gone(path: Path, times: int) -> None:
        if path.name == "a.mcap" and asked == times:
            looked[0] += 1
            path.unlink()

    def written(fd: int) -> bool:
        gone(Path(f"/proc/self/fd/{fd}").readlink(), 2)
        return is_written(fd)

    monkeypatch.setattr(parts, "_is_ours", is_ours)
    monkeypatch.setattr(parts, "is_written", written)
    assert make_room(tmp_path, 2 * size) == ()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.mcap", "c.mcap"]
    assert looked == [1]
