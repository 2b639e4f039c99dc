"""The file under the recorder: on the disk at once, never overwritten, ended at a good chunk when the disk fails."""

from __future__ import annotations

import errno
import os
import resource
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from agent.log.file import LogFile, LogFileError, LogInTheWay
from agent.log.read import read_log
from agent.log.scan import LogScan
from agent.log.writer import CHUNK_BYTES
from agent.telemetry.row.topics import PLANT
from tests.support.telemetry.log_maker import RUN_JSON, LogMaker, make_log
from tests.support.telemetry.telemetry_cell import ARMS, make_rows


def create(path: Path, min_free_bytes: int = 0) -> LogFile:
    return LogFile(path, [], {}, created_ns=1, min_free_bytes=min_free_bytes)


def test_attachments_and_metadata_are_in_the_file_before_the_first_message(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap")
    found = list(LogScan(BytesIO((tmp_path / "run.mcap").read_bytes())))
    assert any(getattr(record, "data", None) == RUN_JSON for record in found)
    assert any(getattr(record, "metadata", None) == {"host": "bench"} for record in found)
    maker.finish()


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    rows = make_log(tmp_path / "run.mcap")
    with pytest.raises(LogInTheWay, match="exists already: found a file"):
        create(tmp_path / "run.mcap")
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == rows["left"].tobytes()


def test_a_second_recorder_on_the_same_file_is_refused(tmp_path: Path) -> None:
    first = create(tmp_path / "run.mcap")
    with pytest.raises(LogInTheWay, match="another recorder is writing"):
        create(tmp_path / "run.mcap")
    assert first.finish({})


def test_a_folder_that_is_missing_full_or_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogFileError, match=r"cannot write .*mkdir"):
        create(tmp_path / "missing" / "run.mcap")
    (tmp_path / "file").write_text("")
    with pytest.raises(LogFileError, match="cannot write"):
        create(tmp_path / "file" / "run.mcap")
    with pytest.raises(LogFileError, match="no room"):
        create(tmp_path / "run.mcap", min_free_bytes=1 << 60)
    assert not (tmp_path / "run.mcap").exists()


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The kernel refuses to write beyond `size`, with a real OSError, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, old)


@pytest.mark.parametrize("room", [1, 3_000, 50_000])
@pytest.mark.fault("D1")
def test_a_full_disk_ends_the_file_at_its_last_good_chunk_and_raises_nothing(tmp_path: Path, room: int) -> None:
    rows = make_rows("left", 400)
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", rows[:200])
    maker.flush()
    with largest_file((tmp_path / "run.mcap").stat().st_size + room):
        for i in range(200, 400, 20):
            maker.write("left", rows[i : i + 20])
            maker.flush()
    assert maker.file.failure
    assert not maker.finish()
    log = read_log(tmp_path / "run.mcap")
    kept = len(log.agents["left"])
    assert log.agents["left"].tobytes() == rows[:kept].tobytes()
    assert kept >= 200
    assert maker.channels.rows_lost() == {"left": 400 - kept, "right": 0}
    assert log.problems == ("the file ends without its index",)


@pytest.mark.fault("D1")
def test_a_disk_that_is_full_of_what_waited_for_the_flush_ends_the_file_and_nothing_else(tmp_path: Path) -> None:
    """A recorder hands over what it has just before; its descriptor was used again once it was closed."""
    rows = make_rows("left", 900)
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", rows[:10])
    maker.flush()
    maker.file.before_flush = lambda: maker.write("left", rows[10:])
    with largest_file((tmp_path / "run.mcap").stat().st_size + 1):
        maker.flush()
    assert maker.file.failure == "File too large"
    maker.file.before_flush = lambda: None
    assert not maker.finish()
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == rows[:10].tobytes()
    assert maker.channels.rows_lost()["left"] == 890


def test_a_disk_that_fills_up_is_told_of_while_there_is_room_to_finish(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap")
    maker.write("left", make_rows("left", 10))
    maker.flush()
    assert not maker.file.nearly_full
    maker.file._min_free = 1 << 60
    maker.flush()
    assert maker.file.nearly_full
    assert maker.finish(complete=False)
    maker.write("left", make_rows("left", 10))
    assert maker.channels.rows_lost()["left"] == 10
    assert len(read_log(tmp_path / "run.mcap").agents["left"]) == 10


def test_a_folder_that_is_moved_takes_the_whole_log_with_it(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    rows = make_rows("left", 20)
    maker = LogMaker(tmp_path / "here" / "run.mcap", has_plant=False, arms={"left": ARMS["left"]})
    maker.write("left", rows[:10])
    maker.flush()
    (tmp_path / "here").rename(tmp_path / "there")
    maker.write("left", rows[10:])
    maker.flush()
    assert maker.finish()
    log = read_log(tmp_path / "there" / "run.mcap")
    assert log.complete
    assert log.agents["left"].tobytes() == rows.tobytes()


def test_a_log_that_is_removed_while_it_is_written_has_failed(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap")
    (tmp_path / "run.mcap").unlink()
    maker.flush()
    assert maker.file.failure == "somebody has removed it"
    assert not maker.finish()


@pytest.mark.fault("D2")
def test_a_disk_that_takes_its_time_to_sync_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, release = threading.Event(), threading.Event()

    def slow(fd: int) -> None:
        entered.set()
        release.wait()

    monkeypatch.setattr("os.fdatasync", slow)
    maker = LogMaker(tmp_path / "run.mcap")
    assert entered.wait(60)
    maker.write("left", make_rows("left", 10))
    maker.flush()
    assert len(read_log(tmp_path / "run.mcap").agents["left"]) == 10
    release.set()
    assert maker.finish()


@pytest.mark.fault("D3")
def test_a_disk_that_is_gone_is_noticed_at_the_next_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered = threading.Event()

    def broken(fd: int) -> None:
        entered.set()
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("os.fdatasync", broken)
    maker = LogMaker(tmp_path / "run.mcap")
    maker.write("left", make_rows("left", 10))
    maker.flush()
    assert entered.wait(60)
    maker.file._syncer._thread.join()
    maker.flush()
    assert maker.file.failure == "Input/output error"
    assert len(read_log(tmp_path / "run.mcap").agents["left"]) == 10


@pytest.mark.parametrize("number", [errno.EROFS, errno.EIO])
@pytest.mark.fault("D3")
def test_a_disk_that_refuses_every_call_ends_the_file_raises_nothing_and_leaves_no_descriptor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    before = set(Path("/proc/self/fd").iterdir()), threading.active_count()
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", make_rows("left", 10))
    maker.flush()
    descriptor = maker.file._fd

    def refusing(real: Callable[..., object]) -> Callable[..., object]:
        def call(fd: int, *rest: object) -> object:
            if fd == descriptor:
                raise OSError(number, os.strerror(number))
            return real(fd, *rest)

        return call

    maker.write("left", make_rows("left", 30)[10:])
    with monkeypatch.context() as gone:
        for name in ("write", "fstat", "ftruncate", "fsync"):
            gone.setattr(os, name, refusing(getattr(os, name)))
        maker.flush()
        assert maker.file.failure == os.strerror(number)
        assert not maker.finish()
    assert maker.channels.rows_lost()["left"] == 20
    assert (set(Path("/proc/self/fd").iterdir()), threading.active_count()) == before
    assert len(read_log(tmp_path / "run.mcap").agents["left"]) == 10


@pytest.mark.fault("D3")
def test_a_log_that_cannot_be_begun_on_a_dead_disk_is_refused_with_the_first_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(Path("/proc/self/fd").iterdir())

    def broken(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("os.fsync", broken)
    monkeypatch.setattr(Path, "unlink", broken)
    with pytest.raises(LogFileError, match="Input/output error"):
        create(tmp_path / "run.mcap")
    assert set(Path("/proc/self/fd").iterdir()) == before


def test_no_descriptor_and_no_thread_is_left(tmp_path: Path) -> None:
    before = set(Path("/proc/self/fd").iterdir()), threading.active_count()
    for i in range(3):
        assert create(tmp_path / f"{i}.mcap").finish({})
    assert (set(Path("/proc/self/fd").iterdir()), threading.active_count()) == before


def test_of_rows_that_come_two_chunks_at_most_are_not_on_the_disk(tmp_path: Path) -> None:
    rows, maker = make_rows("left", 900), LogMaker(tmp_path / "run.mcap", has_plant=False)
    for i in range(0, 900, 20):
        maker.write("left", rows[i : i + 20])
    kept = read_log(tmp_path / "run.mcap").agents["left"]
    assert (900 - len(kept)) * rows.itemsize <= 2 * CHUNK_BYTES
    assert maker.finish()


def test_a_log_says_the_same_however_many_rows_come_at_a_time(tmp_path: Path) -> None:
    said = []
    for batch in (1, 7, 120):
        maker = LogMaker(tmp_path / f"{batch}.mcap")
        rows = {member: make_rows(member, 120) for member in ("left", "right", PLANT)}
        for i in range(0, 120, batch):
            for member, own in rows.items():
                maker.write(member, own[i : i + batch])
        assert maker.finish()
        with (tmp_path / f"{batch}.mcap").open("rb") as file:
            found = make_reader(file, validate_crcs=True).iter_messages()
            said.append(sorted((c.topic, m.log_time, m.sequence, m.data) for _, c, m in found))
    assert said[0] == said[1] == said[2]
    assert len({topic for topic, *_ in said[0]}) > 8


def test_rows_that_wait_for_a_disk_that_is_full_are_counted(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    with largest_file((tmp_path / "run.mcap").stat().st_size):
        maker.write("left", make_rows("left", 50))
        assert not maker.finish()
    assert maker.channels.rows_lost() == {"left": 50, "right": 0}
