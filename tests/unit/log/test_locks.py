"""Who may only read a log cannot take it from who writes, mends or removes it; two who mend do not meet."""

from __future__ import annotations

import fcntl
import os
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agent.log import locks, recover
from agent.log.file import LogInTheWay, remove_log
from agent.log.locks import alone_with, create_written, is_named, is_written, lock, lock_path, note_path, open_closed
from agent.log.parts import make_room, only_recorder
from agent.telemetry.ring import file as ring_file
from tests.support.telemetry.log_maker import LogMaker, make_log


@contextmanager
def reader_that_locks(path: Path) -> Iterator[None]:
    """All that a descriptor for reading lets anybody do to the locks of a file."""
    fd = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0))
        yield
    finally:
        os.close(fd)


def test_a_reader_s_locks_keep_nobody_from_mending_a_log(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)
    with reader_that_locks(path):
        assert recover.recover(path).repaired
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_s_locks_keep_no_log_where_room_is_made_or_a_run_begins_anew(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        make_log(tmp_path / name)
    with reader_that_locks(tmp_path / "a.mcap"), reader_that_locks(tmp_path / "b.mcap"):
        assert make_room(tmp_path, 0) == (tmp_path / "a.mcap", tmp_path / "b.mcap")
    make_log(tmp_path / "run.mcap")
    with reader_that_locks(tmp_path / "run.mcap"):
        remove_log(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_is_written_says_so_to_who_may_only_read_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    being_written = LogMaker(path)
    with path.open("rb") as file:
        assert is_written(file.fileno())
        with pytest.raises(LogInTheWay, match="is being written"):
            remove_log(path)
        being_written.finish()
        assert not is_written(file.fileno())
    assert list(tmp_path.iterdir()) == [path]


def test_a_log_is_closed_to_others_until_it_is_locked_and_then_as_readable_as_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes = list[int]()

    def locked(fd: int) -> bool:
        modes.append(stat.S_IMODE(os.fstat(fd).st_mode))
        return True

    monkeypatch.setattr(locks.ring_file, "lock", locked)
    before = os.umask(0o027)
    try:
        os.close(create_written(tmp_path / "run.mcap"))
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)
    assert modes == [0o600]
    assert stat.S_IMODE((tmp_path / "run.mcap").stat().st_mode) == 0o640
    with pytest.raises(FileExistsError):
        create_written(tmp_path / "run.mcap")


def test_nobody_else_can_open_what_keeps_a_second_recorder_away_and_all_can_read_its_note(tmp_path: Path) -> None:
    lock_path(tmp_path, "paper").touch(mode=0o644)
    with only_recorder(tmp_path, "paper") as note:
        note(b"told")
    modes = [stat.S_IMODE(path(tmp_path, "paper").stat().st_mode) for path in (lock_path, note_path)]
    assert modes[0] == 0o600
    assert modes[1] & 0o400
    assert note_path(tmp_path, "paper").read_bytes() == b"told"


def test_a_file_that_is_closed_to_others_is_so_from_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError("a file system without modes")

    monkeypatch.setattr(locks.os, "fchmod", refused)
    before = os.umask(0o022)
    try:
        os.close(open_closed(tmp_path / "closed"))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "closed").stat().st_mode) == 0o600


def test_one_at_a_time_mends_or_removes_a_log_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)
    with alone_with(path) as first, alone_with(path) as second:
        assert first is not None
        assert second is None
        with pytest.raises(LogInTheWay, match="is being mended"):
            recover.recover(path)
        with pytest.raises(LogInTheWay, match="is being written: found its recorder, or who mends it"):
            remove_log(path)
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / f"run.mcap{locks.SUFFIX}").write_bytes(b"left by one that was killed" * path.stat().st_size)
    path.chmod(0o640)
    assert recover.recover(path).repaired
    assert list(tmp_path.iterdir()) == [path]
    assert not recover.is_unfinished(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640, "as it was, and not closed as the copy"


def test_who_opened_the_copy_before_it_became_the_log_gets_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"old")

    def replaced_meanwhile(fd: int) -> bool:
        os.write(fd, b"mended")
        (tmp_path / f"run.mcap{locks.SUFFIX}").replace(path)
        return True

    monkeypatch.setattr(locks, "lock", replaced_meanwhile)
    with alone_with(path) as nothing:
        assert nothing is None
    assert path.read_bytes() == b"mended"


def test_a_log_that_was_replaced_while_it_was_read_is_not_replaced_by_what_was_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)

    @contextmanager
    def later(log: Path) -> Iterator[int | None]:
        log.unlink()
        make_log(log, 7)
        with alone_with(log) as alone:
            yield alone

    monkeypatch.setattr(recover, "alone_with", later)
    with pytest.raises(LogInTheWay, match="is being mended"):
        recover.recover(path)
    assert not recover.is_unfinished(path)


def test_a_file_keeps_its_name_until_another_one_has_it(tmp_path: Path) -> None:
    fd = open_closed(tmp_path / "a")
    assert is_named(tmp_path / "a", fd)
    (tmp_path / "a").rename(tmp_path / "b")
    assert not is_named(tmp_path / "a", fd)
    (tmp_path / "a").touch()
    assert not is_named(tmp_path / "a", fd)
    assert lock(fd)
    assert not ring_file.is_locked(fd)
    os.close(fd)
