"""The ring of a writer that died, gone on with: also where its file is cut, written over, or takes nothing any more."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from agent.telemetry.ring import words
from agent.telemetry.ring.file import FINISHED_WORD, SLOTS_OFFSET, WRITTEN_WORD, RingError
from agent.telemetry.ring.heir import RingHeir
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE

SLOTS = 8


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


@pytest.fixture
def writer(path: Path) -> Iterator[RingWriter]:
    with RingWriter(path, AGENT_STATE, "left", ("waist",), slots=SLOTS) as ring:
        yield ring


@pytest.fixture
def heir(writer: RingWriter) -> Iterator[RingHeir]:
    with RingHeir(os.dup(writer.fileno()), AGENT_STATE) as ring:
        yield ring


def write(ring: RingWriter, count: int) -> None:
    for _ in range(count):
        ring.row["sequence"] = ring.written
        ring.commit()


def rows_of(ring: RingWriter, sequences: range) -> list[bytes]:
    found = []
    for sequence in sequences:
        ring.row["sequence"] = sequence
        found.append(bytes(ring._staged))
    return found


def read(reader: RingReader) -> list[int]:
    payload = b""
    while reader.next_index < reader.written:
        payload += reader.read_new(SLOTS).payload
    found: list[int] = np.frombuffer(payload, AGENT_STATE.dtype)["sequence"].tolist()
    return found


def test_another_process_goes_on_with_the_ring_of_one_that_died(
    path: Path, writer: RingWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(writer, 3)
    heir = RingHeir(os.dup(writer.fileno()), AGENT_STATE)
    with RingReader(path, AGENT_STATE) as reader:
        write(writer, 1)  # between the passing on and the death
        writer.close()
        assert reader.writer_alive, "the lock is the file's: readers notice nothing"
        assert heir.header == reader.header
        assert heir.written == 3
        assert (heir.catch_up(), heir.damage) == (4, "")
        heir.wait_for_space()
        write(heir, SLOTS)
        rows = np.frombuffer(reader.read_new(SLOTS).payload, AGENT_STATE.dtype)
        assert rows["sequence"].tolist() == list(range(4, 4 + SLOTS))
        assert set(rows["encapsulation"].tolist()) == {CDR_LITTLE_ENDIAN}
        assert not reader.finished
        heir.finish()
        assert reader.finished
        heir.close()
        closed: list[int] = []
        monkeypatch.setattr(os, "close", closed.append)
        heir.close()
        assert closed == []
        monkeypatch.undo()
        assert not reader.writer_alive


def test_what_is_no_ring_is_not_gone_on_with(tmp_path: Path) -> None:
    (tmp_path / "other").write_bytes(b"\0" * 8192)
    fd = os.open(tmp_path / "other", os.O_RDWR)
    with pytest.raises(RingError, match="is not a telemetry ring"):
        RingHeir(fd, AGENT_STATE)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)


def test_a_ring_of_other_rows_and_one_cut_short_are_not_gone_on_with(path: Path, writer: RingWriter) -> None:
    with pytest.raises(RingError, match="another layout"):
        RingHeir(os.dup(writer.fileno()), PLANT_STATE)
    short = path.with_name("short")
    short.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RingError, match="cut short"):
        RingHeir(os.open(short, os.O_RDWR), AGENT_STATE)


@pytest.mark.fault("P14")
@pytest.mark.parametrize(
    ("happens", "damage"),
    [
        (lambda path: os.truncate(path, 0), "cut to 0 of {} bytes"),
        (lambda path: os.truncate(path, SLOTS_OFFSET + 5000), f"cut to {SLOTS_OFFSET + 5000} of {{}} bytes"),
        (lambda path: path.write_bytes(b"x" * 50_000), "written over"),
    ],
)
def test_a_file_that_is_none_any_more_is_mended_and_who_reads_it_goes_on(
    path: Path, writer: RingWriter, heir: RingHeir, happens: Callable[[Path], object], damage: str
) -> None:
    write(writer, 5)
    heir.catch_up()
    before, size = path.read_bytes(), path.stat().st_size
    with RingReader(path, AGENT_STATE) as reader:
        assert read(reader) == [0, 1, 2, 3, 4]
        happens(path)
        assert heir.damage == damage.format(size)
        assert heir.catch_up() == 5, "as was seen before"
        heir.mend(rows_of(heir, range(3, 5)))
        assert (heir.damage, path.stat().st_size) == ("", max(size, 50_000 if damage == "written over" else 0))
        with RingReader(path, AGENT_STATE) as another:
            assert read(another)[-2:] == [3, 4], "before the next row, too"
        write(heir, 2)
        assert (read(reader), reader.missed, reader.damaged) == ([5, 6], 0, 0)
    assert path.read_bytes()[:1024] == before[:1024]
    with RingReader(path, AGENT_STATE) as another:
        assert read(another)[-4:] == [3, 4, 5, 6]


@pytest.mark.fault("P14")
@pytest.mark.parametrize(
    ("happens", "damage"),
    [
        (lambda path: os.truncate(path, 0), "cut to 0 of {} bytes"),
        (lambda path: path.write_bytes(b"x" * 50_000), "written over"),
    ],
)
def test_a_file_that_is_cut_again_while_rows_are_written_is_made_anew_with_the_next_one(
    path: Path, writer: RingWriter, heir: RingHeir, happens: Callable[[Path], object], damage: str
) -> None:
    told: list[str] = []
    heir.failed = told.append
    write(writer, 2)
    heir.catch_up()
    write(heir, 2)
    size = path.stat().st_size
    with RingReader(path, AGENT_STATE) as reader:
        assert read(reader) == [0, 1, 2, 3]
        for _ in range(2):
            happens(path)
            first = heir.written
            write(heir, 2)
            assert read(reader) == [first, first + 1], "who has read it goes on"
            with RingReader(path, AGENT_STATE) as another:
                assert read(another)[-2:] == [first, first + 1], "and who comes later reads it"
    assert told == [f"the file was {damage.format(size)}, and is made anew"]


@pytest.mark.parametrize("word", [WRITTEN_WORD, FINISHED_WORD])
def test_a_count_that_cannot_be_is_not_taken_over(path: Path, writer: RingWriter, heir: RingHeir, word: int) -> None:
    write(writer, 2)
    assert heir.catch_up() == 2
    os.pwrite(writer.fileno(), b"\xff" * 8, 8 * word)
    assert heir.catch_up() == 2
    os.pwrite(writer.fileno(), bytes(8), 8 * word)
    assert heir.catch_up() == 2


@pytest.mark.fault("P14")
def test_rows_that_cannot_be_written_are_lost_told_once_and_end_nothing(
    writer: RingWriter, heir: RingHeir, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    heir.failed = told.append

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as disk:
        for call in ("pwrite", "pwritev", "ftruncate"):
            disk.setattr(os, call, full)
        write(heir, 2)
        heir.finish()
        os.truncate(heir.fileno(), 0)
        heir.mend(rows_of(heir, range(2)))
    assert told == ["No space left on device"]
    assert heir.written == 2
    heir.mend([])
    write(heir, 1)
    assert told == ["No space left on device"]


@pytest.mark.parametrize(
    ("call", "does"),
    [
        ("pwritev", lambda heir: heir.commit()),
        ("pwrite", lambda heir: heir.finish()),
        ("ftruncate", lambda heir: (os.truncate(f"/proc/self/fd/{heir.fileno()}", 0), heir.mend([]))),
    ],
)
def test_each_call_that_fails_is_told_of(
    heir: RingHeir, monkeypatch: pytest.MonkeyPatch, call: str, does: Callable[[RingHeir], object]
) -> None:
    told: list[str] = []
    heir.failed = told.append

    def fails(*_: object) -> int:
        raise OSError("an odd one")

    monkeypatch.setattr(os, call, fails)
    does(heir)
    assert told == ["an odd one"]


def test_a_word_of_the_head_leaves_the_next_one(tmp_path: Path) -> None:
    (tmp_path / "head").write_bytes(b"\xff" * 64)
    with (tmp_path / "head").open("r+b") as file:
        words.put_word(file.fileno(), 2, 1)
        assert words.word_at(file.fileno(), 16) == 1
    assert (tmp_path / "head").read_bytes()[24:] == b"\xff" * 40


def test_both_give_back_what_they_opened(tmp_path: Path, writer: RingWriter) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    mapped = Path("/proc/self/maps").read_text().count(str(tmp_path))
    with closing(RingHeir(os.dup(writer.fileno()), AGENT_STATE)):
        assert Path("/proc/self/maps").read_text().count(str(tmp_path)) == mapped, "it maps nothing"
    assert len(list(Path("/proc/self/fd").iterdir())) == before
