"""The ring: what is committed is read back byte for byte; what is not intact is never returned."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import numpy as np
import pytest

from agent.telemetry.ring import writer as writer_of_rings
from agent.telemetry.ring.file import ACKNOWLEDGED_WORD, MESSAGE_IN_SLOT, SLOTS_OFFSET, RingError
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter, RowsUntaken, file_bytes
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

SLOTS = 16


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


@pytest.fixture
def writer(path: Path):
    with RingWriter(path, AGENT_STATE, "left", ("shoulder", "elbow"), slots=SLOTS) as ring:
        yield ring


def write(ring: RingWriter, rows: int) -> None:
    for _ in range(rows):
        ring.row["sequence"] = ring.written
        ring.row["q"][:] = ring.written + np.arange(7)
        ring.commit()


def test_rows_come_back_byte_for_byte_and_in_order(path: Path, writer: RingWriter) -> None:
    sent = []
    with RingReader(path, AGENT_STATE) as reader:
        for _ in range(3 * SLOTS):
            write(writer, 1)
            sent.append(writer.row.tobytes())
            block = reader.read_new(8)
            assert (block.first, block.count, block.payload) == (len(sent) - 1, 1, sent[-1])
        assert reader.read_new(8).count == 0
        assert reader.missed == 0


def test_a_ring_holds_forty_seconds_at_200_Hz(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "plant.ring", PLANT_STATE, "plant") as ring:
        assert ring.header.slots == 8192


def test_how_large_a_ring_is_is_known_before_there_is_one(path: Path, writer: RingWriter) -> None:
    assert file_bytes(AGENT_STATE, SLOTS) == path.stat().st_size


def test_row_stays_the_same_memory_so_views_can_be_kept(path: Path, writer: RingWriter) -> None:
    t = writer.row["t"]
    writer.commit()
    t[()] = 2.5
    writer.commit()
    with RingReader(path, AGENT_STATE) as reader:
        assert AGENT_STATE.decode(reader.read_new(8).payload)["t"].tolist() == [0.0, 2.5]


def test_rows_are_aligned_wherever_their_memory_is() -> None:
    rows = [writer_of_rings.aligned_row(AGENT_STATE.dtype)[0] for _ in range(40)]
    assert len({row.ctypes.data % 144 for row in rows}) > 1
    assert {(row.ctypes.data + 4) % 8 for row in rows} == {0}


def test_payloads_are_aligned_to_eight_bytes_in_memory_and_in_the_file(writer: RingWriter) -> None:
    assert (writer.row.__array_interface__["data"][0] + 4) % 8 == 0
    assert (SLOTS_OFFSET + MESSAGE_IN_SLOT + 4) % 8 == 0
    assert writer.header.stride % 8 == 0


def test_header_carries_names_and_both_ends_agree(path: Path, writer: RingWriter) -> None:
    with RingReader(path, AGENT_STATE) as reader:
        assert reader.header == writer.header
        assert (reader.header.name, reader.header.joints) == ("left", ("shoulder", "elbow"))
        assert reader.header.pid == os.getpid()


def test_overwritten_rows_are_counted_not_returned(path: Path, writer: RingWriter) -> None:
    with RingReader(path, AGENT_STATE) as reader:
        write(writer, SLOTS + 5)
        block = reader.read_new(10 * SLOTS)
        assert reader.missed == 5
        assert AGENT_STATE.decode(block.payload)["sequence"].tolist() == list(range(5, SLOTS + 5))
        assert block.first == 5


def resident_bytes(path: Path) -> list[int]:
    """Of each mapping of that file in this process; one that got its name later stands under the name it had before."""
    maps = Path("/proc/self/smaps").read_text().split("\n")
    begins = [i for i, line in enumerate(maps) if str(path) in line]
    return [1024 * int(next(m for m in maps[i:] if m.startswith("Rss:")).split()[1]) for i in begins]


def test_the_writer_has_all_pages_of_a_ring_before_its_first_row(path: Path, writer: RingWriter) -> None:
    """A page that is missing costs the loop a microsecond and more; a reader maps none."""
    with RingReader(path, AGENT_STATE):
        assert resident_bytes(path) == [pytest.approx(writer.header.file_bytes, abs=4096)]


def test_rows_can_be_read_again_while_they_are_there(path: Path, writer: RingWriter) -> None:
    write(writer, SLOTS + 4)
    with RingReader(path, AGENT_STATE) as reader:
        reader.read_new(SLOTS)
        again = reader.read_at(6, 3)
        assert AGENT_STATE.decode(again.payload)["sequence"].tolist() == [6, 7, 8]
        gone = reader.read_at(0, 4)
        assert (gone.first, gone.count) == (4, 0)


@pytest.mark.parametrize("offset", [0, 8, MESSAGE_IN_SLOT, MESSAGE_IN_SLOT + AGENT_STATE.dtype.itemsize - 1])
def test_a_row_with_any_byte_changed_is_not_returned(path: Path, writer: RingWriter, offset: int) -> None:
    write(writer, 5)
    where = SLOTS_OFFSET + 2 * writer.header.stride + offset
    with path.open("r+b", buffering=0) as file:
        byte = os.pread(file.fileno(), 1, where)[0]
        os.pwrite(file.fileno(), bytes([byte ^ 0x10]), where)
    with RingReader(path, AGENT_STATE) as reader:
        rows = b"".join(reader.read_new(8).payload for _ in range(10))
        assert AGENT_STATE.decode(rows)["sequence"].tolist() == [0, 1, 3, 4]
        assert (reader.damaged, reader.missed) == (1, 0)


def test_a_row_that_its_writer_died_over_has_no_number(writer: RingWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the one that was there before, whose bytes are half overwritten."""
    slots = writer.header.slots
    write(writer, slots)

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_pack_slot_head", dies)
    assert writer._words[SLOTS_OFFSET // 8] == 1, "row 0"
    with pytest.raises(KeyboardInterrupt):
        writer.commit()
    assert writer._words[SLOTS_OFFSET // 8] == 0


@pytest.mark.fault("P5")
def test_a_second_writer_is_refused_and_the_first_goes_on(path: Path, writer: RingWriter) -> None:
    with pytest.raises(RingError, match="has a writer already"):
        RingWriter(path, AGENT_STATE, "left", slots=SLOTS)
    write(writer, 1)
    with RingReader(path, AGENT_STATE) as reader:
        assert reader.read_new(8).count == 1


@pytest.mark.parametrize("there", [False, True])
def test_of_many_writers_that_start_at_once_one_wins(path: Path, there: bool) -> None:
    if there:
        RingWriter(path, AGENT_STATE, "left", slots=SLOTS).close()
    gate, winners, losers = threading.Barrier(8), [], []

    def start() -> None:
        gate.wait()
        try:
            winners.append(RingWriter(path, AGENT_STATE, "left", slots=SLOTS))
        except RingError:
            losers.append(None)

    threads = [threading.Thread(target=start) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(winners), len(losers)) == (1, 7)
    with RingReader(path, AGENT_STATE) as reader:
        assert reader.header == winners[0].header
        assert reader.writer_alive
    winners[0].close()
    assert list(path.parent.iterdir()) == [path]


def test_only_owner_and_group_can_read(path: Path, writer: RingWriter) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_end_and_death_of_the_writer_can_be_told_apart(path: Path, writer: RingWriter) -> None:
    with RingReader(path, AGENT_STATE) as reader:
        assert reader.writer_alive
        assert not reader.finished
        writer.finish()
        assert reader.finished
        writer.close()
        writer.close()
        assert not reader.writer_alive


def test_a_dead_ring_never_seems_alive_while_it_is_being_replaced(path: Path) -> None:
    RingWriter(path, AGENT_STATE, "left").close()
    for _ in range(10):
        with RingReader(path, AGENT_STATE) as dead:
            successor = threading.Thread(target=lambda: RingWriter(path, AGENT_STATE, "left").close())
            successor.start()
            while successor.is_alive():
                assert not dead.writer_alive
            assert dead.replaced


def test_an_unfinished_ring_is_kept_as_the_black_box(path: Path) -> None:
    with RingWriter(path, AGENT_STATE, "left", slots=SLOTS) as crashed:
        write(crashed, 3)
    with RingReader(path, AGENT_STATE) as reader:
        assert not reader.replaced
        with RingWriter(path, AGENT_STATE, "left", slots=SLOTS) as restarted:
            assert reader.replaced
            assert restarted.header.ring_id != crashed.header.ring_id
            write(restarted, 1)
            restarted.finish()
    with RingReader(path.with_name("left.ring.previous"), AGENT_STATE) as reader:
        assert reader.read_new(8).count == 3
    with (
        RingWriter(path, AGENT_STATE, "left", slots=SLOTS),
        RingReader(path.with_name("left.ring.previous"), AGENT_STATE) as r,
    ):
        assert r.header.ring_id == crashed.header.ring_id  # a finished ring does not displace a black box


def test_lockstep_waits_for_the_reader_and_says_when_it_is_missing(path: Path, writer: RingWriter) -> None:
    write(writer, SLOTS // 2 - 1)
    writer.wait_for_space(0.0)
    write(writer, 1)
    with pytest.raises(RowsUntaken, match="does not keep up") as untaken:
        writer.wait_for_space(0.01)
    assert untaken.value.exit_code == 4, "a run has begun, and its log is what fails"
    with RingReader(path, AGENT_STATE, acknowledges=True) as reader:
        later = threading.Timer(0.05, reader.acknowledge, [1])
        later.start()
        writer.wait_for_space(60.0)
        later.join()


def test_who_is_asked_for_something_else_waits_for_no_reader(writer: RingWriter) -> None:
    write(writer, SLOTS // 2)
    looks = iter((False, True))
    writer.asked = lambda: next(looks)
    writer.wait_for_space(60.0)
    assert next(looks, None) is None
    writer.commit()
    assert writer.written == SLOTS // 2 + 1


def test_a_reader_that_does_not_acknowledge_cannot_write(path: Path, writer: RingWriter) -> None:
    with RingReader(path, AGENT_STATE) as reader, pytest.raises(OSError, match="Bad file descriptor"):
        reader.acknowledge(1)
    assert writer._words[ACKNOWLEDGED_WORD] == 0


def change(path: Path, offset: int, data: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(data)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: p.unlink(), "cannot open the telemetry ring"),
        (lambda p: (p.unlink(), p.mkdir()), "found Is a directory, expected the file an agent made"),
        (lambda p: (p.unlink(), os.mkfifo(p)), "found Illegal seek, expected the file an agent made"),
        (lambda p: p.write_bytes(b""), "is not a telemetry ring"),
        (lambda p: change(p, 0, b"NOTARING"), "is not a telemetry ring"),
        (lambda p: change(p, 8, b"\x63"), "has another version"),
        (lambda p: change(p, 40, b"\x00\x01\x02"), "has a damaged header"),
        (lambda p: os.truncate(p, SLOTS_OFFSET + 100), "is cut short"),
    ],
)
def test_what_is_not_a_ring_is_refused(path: Path, writer: RingWriter, damage, message: str) -> None:
    writer.close()
    damage(path)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(RingError, match=message) as refusal:
        RingReader(path, AGENT_STATE)
    assert refusal.value.remedy
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_another_layout_is_refused(path: Path, writer: RingWriter) -> None:
    with pytest.raises(RingError, match="has another layout"):
        RingReader(path, PLANT_STATE)


def test_a_ring_that_cannot_be_made_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(RingError, match="cannot create the telemetry ring"):
        RingWriter(tmp_path / "missing" / "left.ring", AGENT_STATE, "left")
    with pytest.raises(RingError, match="size out of bounds"):
        RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", slots=10_000_000)
    with pytest.raises(RingError, match="label too long"):
        RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", ("j" * 1000,), slots=SLOTS)
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".new")]
