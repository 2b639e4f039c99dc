"""Repair keeps everything intact, gives a finished file, and never costs what was there."""

from __future__ import annotations

import errno
import os
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import numpy as np
import pytest
from mcap.reader import make_reader

from agent.log import locks, scan
from agent.log.chunk import LIBRARY
from agent.log.file import LogFileError, LogInTheWay
from agent.log.messages import Messages
from agent.log.read import LogError, read_log
from agent.log.recover import recover, repair_leftovers
from tests.support.telemetry.log_maker import LogMaker, make_log


def test_an_unfinished_log_becomes_a_finished_one_with_every_row(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rows = make_log(path, finish=False)
    with path.open("ab") as file:
        file.write(b"\x06\xff\xff")  # the beginning of a chunk
    before = read_log(path)
    report = recover(path)
    assert report.repaired
    log = read_log(path)
    assert log.agents["left"].tobytes() == rows["left"].tobytes()
    assert (log.attachments, log.problems) == (before.attachments, ())
    assert not log.complete
    assert "ends without its index, 3 bytes" in log.metadata["recovery"]["problems"]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().library == LIBRARY
        assert reader.get_summary().statistics.message_count == report.messages
        assert sum(1 for _ in reader.iter_messages()) == report.messages
    assert list(tmp_path.iterdir()) == [path]


def test_a_finished_log_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_log(path)
    before = path.read_bytes()
    assert not recover(path).repaired
    assert path.read_bytes() == before


def test_two_logs_one_behind_the_other_are_not_mended_into_the_first(tmp_path: Path) -> None:
    path, second = tmp_path / "run.mcap", tmp_path / "second.mcap"
    rows = make_log(path)
    make_log(second, 7)
    at, more = path.stat().st_size, second.read_bytes()
    with path.open("ab") as file:
        file.write(more)
    both = path.read_bytes()
    log = read_log(path)
    assert log.agents["left"].tobytes() == rows["left"].tobytes()
    assert (log.complete, log.problems) == (
        False, (f"{len(more)} bytes behind its end are another log, which is not read",)
    )  # fmt: skip
    with pytest.raises(LogError, match=rf"two logs .*`head -c {at}`, `tail -c \+{at + 1}`"):
        recover(path)
    assert path.read_bytes() == both
    assert both[at:] == more, "`tail` counts from 1"


@pytest.mark.parametrize(("cut", "piece"), [(0, 1 << 20), (1, 1 << 20), (8, 1 << 20), (300, 7), (5000, 1 << 20)])
def test_a_log_behind_an_unfinished_one_is_not_mended_into_it(
    tmp_path: Path, cut: int, piece: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """cut: bytes that the first one lacks of its last whole chunk, or 0; piece: that are read at a time."""
    monkeypatch.setattr(scan, "_PIECE", piece)
    first, second, path = (tmp_path / f"{name}.mcap" for name in ("first", "second", "run"))
    make_log(first)
    make_log(second, 7)
    with first.open("rb") as file:
        chunk_ends = 0
        for record in scan.LogScan(file):
            chunk_ends = file.tell() if isinstance(record, Messages) else chunk_ends
    begun, more = first.read_bytes()[: chunk_ends - cut], second.read_bytes()
    first.write_bytes(begun)
    path.write_bytes(begun + more)
    problems = read_log(path).problems
    assert problems[-1].endswith("another log, which is not read")
    assert read_log(path).agents["left"].tobytes() == read_log(first).agents["left"].tobytes()
    with pytest.raises(LogError, match=rf"two logs .*`head -c {len(begun)}`, `tail -c \+{len(begun) + 1}`"):
        recover(path)
    assert path.read_bytes() == begun + more


def test_what_is_no_log_behind_the_end_is_told_and_taken_away(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rows = make_log(path)
    with path.open("ab") as file:
        file.write(b"hello")
    assert read_log(path).problems == ("5 bytes behind its end are no part of it",)
    before = path.read_bytes()
    done = recover(path)
    assert (done.repaired, done.damaged, done.original) == (True, True, tmp_path / "run.mcap.damaged")
    assert done.original.read_bytes() == before
    assert read_log(path).agents["left"].tobytes() == rows["left"].tobytes()


@pytest.mark.parametrize(("name", "found"), [("none", "No such file"), ("folder", "Is a directory")])
def test_what_cannot_be_read_is_no_log(tmp_path: Path, name: str, found: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match=f"cannot open .*{name}: found {found}"):
        recover(tmp_path / name)


CHUNKS = 5  # of the logs here; the first has schemas and channels too


@cache
def five_chunks(*, finish: bool) -> tuple[np.ndarray, bytes]:
    """Rows of the arm left, and the log."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        return make_log(path, finish=finish)["left"], path.read_bytes()


def places(data: bytes) -> list[tuple[int, int]]:
    """Where the chunks of a log begin, and their bytes."""
    found, at = [], len(scan.MAGIC)
    while at + 9 <= len(data) and data[at] != 15:
        length = 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        found += [(at, length)] if data[at] == 6 else []
        at += length
    assert len(found) == CHUNKS
    return found


def change(data: bytearray, kind: str, chunk: int) -> None:
    """Damage a chunk of a log."""
    at, length = places(data)[chunk]
    if kind == "a length out of the file":
        data[at + 4] ^= 0x40
    elif kind == "a length too large":
        data[at + 2] ^= 0x10
    elif kind == "a length too small":
        data[at + 1] ^= 1 << (data[at + 1].bit_length() - 1)
    elif kind == "another kind":
        data[at] ^= 1
    elif kind == "no kind":
        data[at] ^= 0x40
    elif kind == "a bit":
        data[at + length // 2] ^= 1
    elif kind == "zeros":
        data[at : at + length // 2] = bytes(length // 2)
    else:
        del data[at + 20 : at + 20 + length // 2]


HEADS = ("a length out of the file", "a length too large", "a length too small", "another kind", "no kind")
CONTENTS = ("a bit", "zeros", "a piece gone")


@pytest.mark.parametrize("ends", ["finished", "killed"])
@pytest.mark.parametrize("chunk", [0, 2, CHUNKS - 1])
@pytest.mark.parametrize("kind", [*HEADS, *CONTENTS])
def test_behind_a_damaged_record_everything_is_found(tmp_path: Path, kind: str, chunk: int, ends: str) -> None:
    path = tmp_path / "run.mcap"
    rows, made = five_chunks(finish=ends == "finished")
    data = bytearray(made)
    change(data, kind, chunk)
    path.write_bytes(data)
    if (kind, chunk, ends) == ("a piece gone", CHUNKS - 1, "killed"):
        cut = len(data) - places(made)[-1][0]  # as if the recorder had been killed while it wrote
        assert recover(path).problems == (f"the file ends without its index, {cut} bytes of a record cut",)
        return
    log = read_log(path)
    lost = () if kind in HEADS else ((20 * chunk, 20 * chunk + 19),)
    kept = [row for i, row in enumerate(rows) if not any(first <= i <= last for first, last in lost)]
    assert log.agents["left"].tobytes() == b"".join(row.tobytes() for row in kept)
    assert not log.complete
    assert log.problems[0].startswith("damaged at byte")
    done = recover(path)
    assert (done.repaired, done.damaged) == (ends == "killed", True)
    if done.repaired:
        assert done.original == tmp_path / "run.mcap.damaged"
        assert done.original.read_bytes() == data
        mended = read_log(path)
        assert (mended.agents["left"].tobytes(), mended.problems) == (log.agents["left"].tobytes(), ())
        assert int(mended.metadata["recovery"]["damaged"]) == (kind in CONTENTS)
    else:
        assert path.read_bytes() == data
        assert list(tmp_path.iterdir()) == [path]


def test_of_a_log_without_its_end_the_first_two_chunks_say_what_the_others_hold(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    data = bytearray(five_chunks(finish=False)[1])
    for chunk in (0, 1):
        change(data, "a bit", chunk)
    path.write_bytes(data)
    with pytest.raises(LogError, match="holds no rows"):
        read_log(path)


def test_a_damaged_finished_log_is_mended_when_forced_and_stays_marked(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_log(path)
    data = bytearray(path.read_bytes())
    change(data, "a bit", 2)
    path.write_bytes(data)
    (tmp_path / "run.mcap.damaged").write_text("an older one")
    done = recover(path, force=True)
    assert (done.repaired, done.original) == (True, tmp_path / "run.mcap.damaged1")
    assert done.original.read_bytes() == data
    assert (tmp_path / "run.mcap.damaged").read_text() == "an older one"
    log = read_log(path)
    assert log.problems == ()
    assert not log.complete
    assert log.metadata["recovery"]["damaged"] == "1"


@pytest.mark.parametrize("opcode", [9, 12])
def test_an_attachment_or_a_text_of_which_the_length_alone_is_wrong_is_read(tmp_path: Path, opcode: int) -> None:
    path = tmp_path / "run.mcap"
    make_log(path)
    whole = read_log(path)
    data, at = bytearray(path.read_bytes()), len(scan.MAGIC)
    while data[at] != opcode:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at + 2] ^= 0x40
    path.write_bytes(data)
    log = read_log(path)
    assert (log.attachments, log.metadata) == (whole.attachments, whole.metadata)
    assert len(log.problems) == 1
    assert log.problems[0].endswith("; what it holds is whole")


@pytest.mark.parametrize("tail", [bytes(4096), b"\xff" * 300])
def test_what_was_never_a_record_at_the_end_is_no_record_cut_and_is_kept(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "run.mcap"
    rows = make_log(path, finish=False)
    with path.open("ab") as file:
        file.write(tail)
    done = recover(path)
    assert (done.damaged, done.original) == (True, tmp_path / "run.mcap.damaged")
    assert [problem.partition(" ")[0] for problem in done.problems] == ["damaged", "the"], "and nothing whole in it"
    assert read_log(path).agents["left"].tobytes() == rows["left"].tobytes()


def test_where_the_damaged_original_cannot_be_kept_nothing_is_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)
    with path.open("ab") as file:
        file.write(bytes(4096))
    before = path.read_bytes()

    def none(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "hardlink_to", none)
    with pytest.raises(LogFileError, match=r"cannot keep the damaged original of .*No space left"):
        recover(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "expected room for a copy of it; make room"),
        (errno.EDQUOT, "expected room for a copy of it; make room"),
        (errno.EACCES, "expected a folder in which a copy of it can be written; repair it as a user who may write"),
        (errno.EROFS, "expected a folder in which a copy of it can be written; repair it as a user who may write"),
    ],
)
def test_a_place_that_takes_no_copy_is_said_to_lack_room_where_it_does_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)
    before = path.read_bytes()

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(locks, "open_closed", refuse)
    with pytest.raises(LogFileError, match=f"cannot repair .*: found {os.strerror(number)}, {said}"):
        recover(path)
    assert path.read_bytes() == before


def test_a_log_that_is_being_written_is_refused(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap")
    with pytest.raises(LogInTheWay, match="is being written"):
        recover(tmp_path / "run.mcap")
    maker.finish()


def test_what_is_no_log_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("not a log")
    with pytest.raises(LogError, match="is no MCAP file"):
        recover(path)
    assert path.read_text() == "not a log"
    with pytest.raises(LogError, match="cannot open"):
        recover(tmp_path / "missing.mcap")


def test_a_repair_that_is_stopped_leaves_the_log_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_log(path, finish=False)
    before = path.read_bytes()
    assert not recover(path, stop=lambda: True).repaired
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_of_a_log_behind_a_link_the_log_itself_is_mended(tmp_path: Path) -> None:
    path, link = tmp_path / "disk" / "run.mcap", tmp_path / "latest.mcap"
    path.parent.mkdir()
    rows = make_log(path, finish=False)
    link.symlink_to(path)
    assert recover(link).repaired
    assert link.is_symlink()
    assert list(path.parent.iterdir()) == [path]
    log = read_log(path)
    assert (log.agents["left"].tobytes(), log.problems) == (rows["left"].tobytes(), ())


def test_leftovers_beside_what_is_no_file_or_cannot_be_read_are_repaired(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.mcap").mkdir()
    (tmp_path / "b.mcap").symlink_to("nothing")
    os.mkfifo(tmp_path / "c.mcap")
    (tmp_path / "theirs.mcap").touch()
    make_log(tmp_path / "z.mcap", finish=False)

    def open_file(path: Path) -> BinaryIO:
        if path.name == "theirs.mcap":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return scan.open_file(path)

    monkeypatch.setattr("agent.log.recover.open_file", open_file)
    repaired, failed = repair_leftovers(tmp_path, but=tmp_path / "mine.mcap")
    assert [done.path for done in repaired] == [tmp_path / "z.mcap"]
    assert len(failed) == 1
    assert "theirs.mcap: found Permission denied" in failed[0]


def test_leftovers_of_ours_are_repaired_and_nothing_else_is_touched(tmp_path: Path) -> None:
    rows = make_log(tmp_path / "a.mcap", finish=False)
    make_log(tmp_path / "b.mcap")
    make_log(tmp_path / "mine.mcap", finish=False)
    being_written = LogMaker(tmp_path / "c.mcap")
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "foreign.mcap").write_bytes(
        (tmp_path / "a.mcap").read_bytes().replace(LIBRARY.encode(), b"somebody-el")
    )
    untouched = {p: p.read_bytes() for p in tmp_path.iterdir() if p.name != "a.mcap"}
    repaired, failed = repair_leftovers(tmp_path, but=tmp_path / "mine.mcap")
    assert [done.path for done in repaired] == [tmp_path / "a.mcap"]
    assert len(failed) == 1
    assert "is being written" in failed[0]
    assert {p: p.read_bytes() for p in untouched} == untouched
    assert read_log(tmp_path / "a.mcap").agents["left"].tobytes() == rows["left"].tobytes()
    being_written.finish()
