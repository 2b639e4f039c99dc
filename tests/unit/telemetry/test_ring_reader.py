"""What a reader of the ring believes, waits for, and counts as missed or damaged; every race by hand."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.telemetry.ring.file import SLOTS_OFFSET, RingError
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

SLOTS = 8
MESSAGE = 12  # in a slot


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


@pytest.fixture
def writer(path: Path) -> Iterator[RingWriter]:
    with RingWriter(path, AGENT_STATE, "left", slots=SLOTS) as ring:
        yield ring


@pytest.fixture
def reader(path: Path, writer: RingWriter) -> Iterator[RingReader]:
    with RingReader(path, AGENT_STATE) as ring:
        yield ring


def row_of(index: int) -> bytes:
    """A row without a zero byte, different for every index."""
    noise = np.random.default_rng(index).integers(1, 256, AGENT_STATE.dtype.itemsize, np.uint8)
    return noise.tobytes()


def write(ring: RingWriter, count: int) -> None:
    for _ in range(count):
        ring._staged[:] = row_of(ring.written)
        ring.commit()


def spoil(path: Path, ring: RingWriter, index: int, offset: int = MESSAGE + 100) -> None:
    """Change one byte of a row's slot; twice brings it back."""
    where = SLOTS_OFFSET + index % SLOTS * ring.header.stride + offset
    with path.open("r+b", buffering=0) as file:
        byte = os.pread(file.fileno(), 1, where)[0]
        os.pwrite(file.fileno(), bytes([byte ^ 0x10]), where)


def read(reader: RingReader, times: int) -> list[tuple[int, int]]:
    """First row and number of rows of so many reads; what they bring is what was written."""
    found = []
    for _ in range(times):
        block = reader.read_new(100)
        assert block.payload == b"".join(row_of(i) for i in range(block.first, block.first + block.count))
        found.append((block.first, block.count))
    return found


def meanwhile(reader: RingReader, monkeypatch: pytest.MonkeyPatch, happens: Callable[[], Any]) -> None:
    """Let something happen once between the reader's look at the count and its copy of the rows."""
    original = reader.read_at

    def late(first: int, count: int) -> Any:
        monkeypatch.setattr(reader, "read_at", original)
        happens()
        return original(first, count)

    monkeypatch.setattr(reader, "read_at", late)


# --- what is there ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("written", "oldest"), [(0, 0), (1, 0), (SLOTS, 0), (SLOTS + 1, 1), (3 * SLOTS + 2, 2 * SLOTS + 2)]
)
def test_the_oldest_row_is_as_old_as_the_ring_is_long(
    reader: RingReader, writer: RingWriter, written: int, oldest: int
) -> None:
    write(writer, written)
    assert (reader.written, reader.oldest) == (written, oldest)


def test_every_row_that_the_ring_holds_is_whole_at_any_turn(reader: RingReader, writer: RingWriter) -> None:
    for _ in range(5 * SLOTS):
        write(writer, 1)
        block = reader.read_at(reader.oldest, SLOTS)
        assert block.count == min(writer.written, SLOTS)


@pytest.mark.parametrize("beyond", [1 << 31, 1 << 32])
def test_rows_are_numbered_on_beyond_four_thousand_million(writer: RingWriter, reader: RingReader, beyond: int) -> None:
    writer.written = beyond - 3
    write(writer, 6)
    block = reader.read_at(beyond - 3, 6)
    assert (block.first, block.count) == (beyond - 3, 6)


def test_a_read_of_nothing_is_empty_and_stays_where_it_was(reader: RingReader, writer: RingWriter) -> None:
    write(writer, 2)
    assert read(reader, 2) == [(0, 2), (2, 0)]
    assert (reader.read_at(1, 0).first, reader.read_at(1, 0).count) == (1, 0)


# --- what is not whole -----------------------------------------------------------------------------------------------


def test_a_damaged_row_is_looked_at_four_times_and_passed_over(
    path: Path, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 7)
    spoil(path, writer, 2)
    spoil(path, writer, 5)
    assert read(reader, 11) == [(0, 2), *[(2, 0)] * 3, (3, 2), *[(5, 0)] * 3, (6, 1), *[(7, 0)] * 2]
    assert (reader.damaged, reader.missed, reader.next_index) == (2, 0, 7)


def test_a_row_that_comes_late_from_another_core_is_waited_for(
    path: Path, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 3)
    spoil(path, writer, 0)
    assert read(reader, 2) == [(0, 0)] * 2
    spoil(path, writer, 0)
    assert read(reader, 1) == [(0, 3)]
    assert (reader.damaged, reader.missed) == (0, 0)
    write(writer, 1)
    spoil(path, writer, 3)
    assert read(reader, 4) == [(3, 0)] * 3 + [(4, 0)], "each row has attempts of its own"


def test_rows_overwritten_while_they_are_read_are_missed_and_not_waited_for(
    writer: RingWriter, reader: RingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(writer, SLOTS)
    meanwhile(reader, monkeypatch, lambda: write(writer, 3))
    assert read(reader, 2) == [(3, SLOTS - 3), (SLOTS, 3)]
    assert (reader.missed, reader.damaged) == (3, 0)


def test_rows_overwritten_just_after_they_were_copied_are_not_believed(
    writer: RingWriter, reader: RingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The copy is whole, by its checksums; it is the count of a slot that must not change under a reader."""
    write(writer, SLOTS)
    copies = os.preadv

    def late(*given: Any) -> int:
        monkeypatch.setattr(os, "preadv", copies)
        done: int = copies(*given)
        write(writer, 3)
        return done

    monkeypatch.setattr(os, "preadv", late)
    block = reader.read_at(0, SLOTS)
    assert (block.first, block.count) == (3, SLOTS - 3)


def test_all_rows_may_be_overwritten_while_they_are_read(
    writer: RingWriter, reader: RingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(writer, 4)
    meanwhile(reader, monkeypatch, lambda: write(writer, 3 * SLOTS))
    assert read(reader, 1) == [(4, 0)]
    assert (reader.missed, reader.damaged, reader.next_index) == (4, 0, 4)
    assert read(reader, 1) == [(4 + 2 * SLOTS, SLOTS)]
    assert reader.missed == 4 + 2 * SLOTS


def test_the_row_that_a_killed_writer_was_about_to_overwrite_is_missed(
    writer: RingWriter, reader: RingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(writer, SLOTS + 5)

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_pack_slot_head", killed)
    with pytest.raises(KeyboardInterrupt):
        write(writer, 1)
    assert read(reader, 4) == [(5, 0)] * 3 + [(6, SLOTS - 1)]
    assert (reader.missed, reader.damaged) == (5 + 1, 0)


def test_a_row_that_is_only_damaged_is_not_called_missed(path: Path, writer: RingWriter, reader: RingReader) -> None:
    write(writer, SLOTS + 5)
    assert read(reader, 1) == [(5, SLOTS)]
    write(writer, 2)
    spoil(path, writer, SLOTS + 5)
    assert read(reader, 4) == [(SLOTS + 5, 0)] * 3 + [(SLOTS + 6, 1)]
    assert (reader.missed, reader.damaged) == (5, 1)


@pytest.mark.parametrize(
    ("bad", "first", "count"),
    [
        ((), 8, 5), ((10,), 11, 2), ((9, 11), 12, 1), ((12,), 8, 4), ((8, 11, 12), 9, 2), ((7,), 8, 5),
        (range(8, 13), 13, 0),
    ],
)  # fmt: skip
def test_the_last_rows_are_those_behind_a_damaged_one(
    path: Path, writer: RingWriter, reader: RingReader, bad: tuple[int, ...], first: int, count: int
) -> None:
    write(writer, SLOTS + 5)
    for index in bad:
        spoil(path, writer, index)
    block = reader.read_last(5)
    assert (block.first, block.count) == (first, count)
    assert block.payload == b"".join(row_of(i) for i in range(first, first + count))
    assert reader.next_index == 0


def test_the_last_rows_of_a_ring_are_no_more_than_it_has(writer: RingWriter, reader: RingReader) -> None:
    assert (reader.read_last(5).first, reader.read_last(5).count) == (0, 0)
    write(writer, 2)
    assert (reader.read_last(5).first, reader.read_last(5).count) == (0, 2)
    write(writer, SLOTS)
    assert (reader.read_last(3 * SLOTS).first, reader.read_last(3 * SLOTS).count) == (2, SLOTS)


@pytest.mark.parametrize(("place", "missed", "damaged"), [(0, 6, 0), (1, 6, 1), (2, 5, 1)])
def test_of_a_full_ring_only_its_oldest_row_may_be_about_to_be_overwritten(
    path: Path, writer: RingWriter, reader: RingReader, place: int, missed: int, damaged: int
) -> None:
    """place: of the damaged row, and with 1 of the one before it too."""
    write(writer, SLOTS + 5)
    for bad in {1: (0, 1)}.get(place, (place,)):
        spoil(path, writer, 5 + bad)
    while reader.next_index < writer.written:
        read(reader, 1)
    assert (reader.missed, reader.damaged) == (missed, damaged)


@pytest.mark.fault("P14")
@pytest.mark.parametrize("left", [0, 7, 1024, SLOTS_OFFSET + 3 * 4096])
def test_rows_of_a_file_that_is_cut_are_damaged_and_the_process_lives(
    path: Path, writer: RingWriter, reader: RingReader, left: int
) -> None:
    write(writer, SLOTS - 1)
    assert (reader.written, reader.cut) == (SLOTS - 1, "")
    os.truncate(path, left)
    assert reader.cut == f"{left} of {writer.header.file_bytes} bytes"
    while reader.next_index < reader.written:
        read(reader, 1)
    whole = max(0, left - SLOTS_OFFSET) // writer.header.stride
    assert (reader.written, reader.missed + reader.damaged) == (SLOTS - 1, SLOTS - 1 - whole)
    assert (reader.finished, reader.writer_alive) == (False, True)


def test_a_count_of_rows_that_cannot_be_is_refused_whenever_it_comes(
    path: Path, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 2)
    for count in ((1 << 62) - 1, 1 << 62, (1 << 63) + 5, (1 << 64) - 1):
        os.pwrite(writer.fileno(), count.to_bytes(8, "little"), 1024)
        if count < 1 << 62:
            assert reader.written == count
            continue
        for looks in (lambda: reader.written, lambda: reader.read_new(3), lambda: RingReader(path, AGENT_STATE)):
            with pytest.raises(RingError, match=f"has a damaged count of rows: found {count}, expected at most"):
                looks()


# --- opening and closing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acknowledges", [False, True])
def test_only_a_reader_that_acknowledges_opens_the_file_for_writing(
    path: Path, writer: RingWriter, acknowledges: bool
) -> None:
    with RingReader(path, AGENT_STATE, acknowledges=acknowledges) as reader:
        mode = fcntl.fcntl(reader._fd, fcntl.F_GETFL) & os.O_ACCMODE
    assert mode == (os.O_RDWR if acknowledges else os.O_RDONLY)


def test_both_ends_give_back_what_they_opened_and_closing_twice_is_fine(tmp_path: Path) -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    def mappings() -> int:
        return Path("/proc/self/maps").read_text().count(str(tmp_path))

    before = descriptors()
    with RingWriter(tmp_path / "r", AGENT_STATE, "left", slots=SLOTS) as writer:
        with RingReader(tmp_path / "r", AGENT_STATE) as reader:
            pass
        assert mappings() == 1
        with pytest.raises(RingError, match="has another layout"):
            RingReader(tmp_path / "r", PLANT_STATE)
        reader.close()
    writer.close()
    assert descriptors() == before
    assert mappings() == 0


def test_a_ring_that_was_removed_is_not_called_replaced(path: Path, reader: RingReader) -> None:
    assert reader.replaced is False
    path.unlink()
    assert reader.replaced is False


def test_a_writer_in_lockstep_gives_up_at_its_deadline(writer: RingWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    write(writer, SLOTS)
    now = iter([10.0, 10.5, 12.0])
    monkeypatch.setattr("agent.telemetry.ring.writer.time.monotonic", lambda: next(now))
    with pytest.raises(RingError, match=f"found {SLOTS} rows waiting for 2 s, expected fewer than {SLOTS // 2}"):
        writer.wait_for_space(2.0)
    assert next(now, None) is None, "the last look was the one at the deadline"


def test_a_reader_that_is_left_keeps_nothing_open(path: Path, writer: RingWriter) -> None:
    assert writer.written == 0
    with RingReader(path, AGENT_STATE) as reader:
        kept = reader._fd
        assert os.fstat(kept).st_ino == path.stat().st_ino
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(kept)
