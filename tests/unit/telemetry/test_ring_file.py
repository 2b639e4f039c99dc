"""The ring's file: what lies where, what is refused, and who gets a name that several want; every race by hand."""

from __future__ import annotations

import json
import os
import stat
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.telemetry.ring import file as ring_file
from agent.telemetry.ring.file import RingError, RingHeader, check_format, layout_hash, make_header
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.taken import writer_of
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

SLOTS = 4
WRITER, SUCCESSOR = 0, 1  # bytes that are locked


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def new_ring(path: Path, rows: int = 0, *, finished: bool = False) -> RingWriter:
    ring = RingWriter(path, AGENT_STATE, "left", slots=SLOTS)
    for _ in range(rows):
        ring.row["sequence"] = ring.written
        ring.commit()
    if finished:
        ring.finish()
    return ring


def ring_id(path: Path) -> int:
    with RingReader(path, AGENT_STATE) as reader:
        return reader.header.ring_id


def header(**changes: Any) -> RingHeader:
    made = make_header(PLANT_STATE, slots=SLOTS, name="plant", joints=(), created_ns=1)
    return replace(made, **changes)


# --- what lies where -------------------------------------------------------------------------------------------------


def test_the_file_is_laid_out_as_it_is_described(path: Path) -> None:
    row_bytes = AGENT_STATE.dtype.itemsize
    with new_ring(path, rows=3, finished=True) as ring, RingReader(path, AGENT_STATE, acknowledges=True) as reader:
        reader.acknowledge(2)
        data, last = path.read_bytes(), ring.row.tobytes()
    static = "<8sIIII32sQqI"
    magic, version, bytes_, stride, slots, layout, _, _, pid = struct.unpack_from(static, data)
    assert (magic, version, bytes_, slots, pid) == (b"COOPRING", 1, row_bytes, SLOTS, os.getpid())
    assert layout == layout_hash(AGENT_STATE)
    assert stride == (12 + row_bytes + 63) // 64 * 64
    crc, length = struct.unpack_from("<II", data, 76)
    label = data[84 : 84 + length]
    assert json.loads(label) == {"name": "left", "joints": []}
    assert crc == zlib.crc32(label, zlib.crc32(data[:76]))
    assert [struct.unpack_from("=Q", data, place)[0] for place in (1024, 1088, 1152)] == [3, 1, 2]
    slot = 4096 + 2 * stride
    assert struct.unpack_from("=QI", data, slot) == (3, zlib.crc32(last, 2))
    assert data[slot + 12 : slot + 12 + row_bytes] == last
    assert len(data) == 4096 + SLOTS * stride


def test_a_label_may_fill_its_place_and_no_more(path: Path) -> None:
    room = 1024 - 84
    name = "n" * (room - len(json.dumps({"name": "", "joints": ()})))
    packed = header(name=name).pack()
    assert len(packed) == 1024
    assert RingHeader.unpack(path, packed.ljust(4096, b"\0")).name == name
    with pytest.raises(RingError, match=f"ring label too long: found {room + 1} bytes, expected at most {room}"):
        header(name=name + "n").pack()


@pytest.mark.parametrize(("slots", "accepted"), [(1, False), (2, True)])
def test_a_ring_has_two_slots_or_more(slots: int, accepted: bool) -> None:
    assert fits(slots) == accepted


def test_a_ring_takes_a_gibibyte_at_most() -> None:
    stride = header().stride
    most = ((1 << 30) - 4096) // stride
    assert fits(most)
    assert header(slots=most).file_bytes <= 1 << 30
    assert not fits(most + 1)
    assert header(slots=most + 1).file_bytes > 1 << 30


def fits(slots: int) -> bool:
    try:
        return make_header(PLANT_STATE, slots=slots, name="plant", joints=(), created_ns=1).slots == slots
    except RingError:
        return False


def test_ring_ids_are_odd_numbers_of_eight_bytes() -> None:
    ids = {header().ring_id for _ in range(40)}
    assert len(ids) == 40
    assert all(number % 2 for number in ids)
    assert max(ids) >= 1 << 60


# --- what is refused -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Format:
    """A layout that the test makes up."""

    ros_name: str = "test/Row"
    definition: str = "uint8[100]\n"
    size: int = 100

    @property
    def dtype(self) -> np.dtype[np.void]:
        return np.dtype([("bytes", "u1", (self.size,))])


@pytest.mark.parametrize(("size", "stride"), [(20, 64), (52, 64), (53, 128), (116, 128), (117, 192)])
def test_slots_are_whole_cache_lines(size: int, stride: int) -> None:
    row_format = Format(size=size)
    assert make_header(row_format, slots=2, name="plant", joints=(), created_ns=1).stride == stride


def format_refusal(header: RingHeader, row_format: Format, file_bytes: int) -> str:
    try:
        check_format(Path("ring"), header, row_format, file_bytes)
    except RingError as error:
        return str(error)
    return ""


def test_a_file_of_whole_slots_of_the_format_is_accepted() -> None:
    made = make_header(Format(), slots=SLOTS, name="a", joints=(), created_ns=1)
    assert format_refusal(made, Format(), made.file_bytes) == ""
    assert format_refusal(replace(made, slots=1), Format(), made.file_bytes) == ""


@pytest.mark.parametrize("other", [Format(definition="int8[100]\n"), Format(ros_name="test/Other"), Format(size=101)])
def test_another_name_definition_or_size_alone_is_another_layout(other: Format) -> None:
    made = make_header(Format(), slots=SLOTS, name="a", joints=(), created_ns=1)
    assert "has another layout" in format_refusal(made, other, made.file_bytes)


@pytest.mark.parametrize("change", [{"stride": 127}, {"stride": 129}, {"stride": 256}, {"slots": 0}])
def test_a_header_whose_slots_are_not_those_of_such_rows_is_refused(change: dict[str, int]) -> None:
    made = make_header(Format(), slots=SLOTS, name="a", joints=(), created_ns=1)
    refused = format_refusal(replace(made, **change), Format(), 2 * made.file_bytes)
    assert "ring has another geometry: found" in refused
    assert "expected slots of 128 bytes" in refused


def test_a_file_shorter_by_a_byte_is_refused() -> None:
    made = make_header(Format(), slots=SLOTS, name="a", joints=(), created_ns=1)
    assert "is cut short" in format_refusal(made, Format(), made.file_bytes - 1)


def test_the_beginning_of_a_ring_is_no_ring(path: Path) -> None:
    new_ring(path).close()
    data = path.read_bytes()
    for length in (0, 8, 100, 4095):
        with pytest.raises(RingError, match=f"is not a telemetry ring: found {length} bytes"):
            RingHeader.unpack(path, data[:length])


# --- a name that is taken --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content", [b"", b"COOPRING", b"COOPRING" + bytes(4087)], ids=["empty", "only the magic", "header cut short"]
)
def test_what_never_became_a_ring_is_replaced_and_not_kept_as_a_black_box(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    new_ring(path).close()
    assert list(path.parent.iterdir()) == [path]
    assert ring_id(path)


@pytest.mark.parametrize("content", [b"notes", b"COOPRINK", b"\1" * 4096, b"COOPRIN"], ids=repr)
def test_somebodys_own_file_is_refused_and_left_alone(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(
        RingError, match=r"is not a telemetry ring: found a file starting .*, expected a ring, or no file"
    ):
        new_ring(path)
    assert path.read_bytes() == content
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("rows", "finished"), [(0, False), (2, True)])
def test_a_ring_without_rows_or_with_an_end_is_no_black_box(path: Path, rows: int, finished: bool) -> None:
    new_ring(path, rows, finished=finished).close()
    new_ring(path).close()
    assert list(path.parent.iterdir()) == [path]


def test_the_black_box_is_the_last_ring_that_did_not_end(path: Path) -> None:
    crashed = []
    for _ in range(3):
        with new_ring(path, rows=1) as ring:
            crashed.append(ring.header.ring_id)
    assert ring_id(path.with_name("left.ring.previous")) == crashed[1]


def test_one_who_is_about_to_replace_a_ring_keeps_others_off_and_does_not_seem_to_write(path: Path) -> None:
    new_ring(path).close()
    fd = os.open(path, os.O_RDWR)
    try:
        assert ring_file.lock(fd, SUCCESSOR) is True
        with RingReader(path, AGENT_STATE) as reader:
            assert not reader.writer_alive
        with pytest.raises(RingError, match="has a writer already"):
            new_ring(path)
    finally:
        os.close(fd)
    new_ring(path).close()


def test_a_second_writer_is_told_who_made_the_ring_and_of_a_guard_where_there_may_be_one(path: Path) -> None:
    comm = Path("/proc/self/comm").read_text().strip()
    for name, ends in (("plant", "stop it first"), ("left", "a guard that holds the arm after its agent ends with")):
        with RingWriter(path, AGENT_STATE, name, slots=8), pytest.raises(RingError) as refused:
            new_ring(path)
        told = str(refused.value)
        assert f"another process; it was made by process {os.getpid()} ({comm}), expected one writer; stop it" in told
        assert ends in told
        assert ("coop release" in told) == (name == "left")
    assert writer_of("plant", 2**22 + 1)[0].endswith("it was made by process 4194305, which has ended")


def test_of_a_ring_that_was_cut_short_under_its_writer_nobody_is_named(path: Path) -> None:
    path.touch()
    fd = os.open(path, os.O_RDWR)
    try:
        assert ring_file.lock(fd)
        with pytest.raises(RingError, match="has a writer already: found its lock held by another process, expected"):
            new_ring(path)
    finally:
        os.close(fd)


def test_a_lock_that_another_holds_is_not_taken(path: Path) -> None:
    with new_ring(path):
        fd = os.open(path, os.O_RDWR)
        assert ring_file.lock(fd) is False
        assert ring_file.is_locked(fd) is True
        os.close(fd)


# --- races, one step at a time ---------------------------------------------------------------------------------------


def before(monkeypatch: pytest.MonkeyPatch, where: Any, name: str, happens: Callable[[], None]) -> None:
    """Let something happen once, just before the next call of a function."""
    original = getattr(where, name)

    def late(*arguments: Any, **named: Any) -> Any:
        monkeypatch.setattr(where, name, original)
        happens()
        return original(*arguments, **named)

    monkeypatch.setattr(where, name, late)


def test_a_ring_that_appears_at_the_last_moment_is_not_overwritten(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    others: list[RingWriter] = []
    before(monkeypatch, os, "link", lambda: others.append(new_ring(path)))
    open_before = descriptors()
    with pytest.raises(RingError, match="has a writer already"):
        new_ring(path)
    assert descriptors() == open_before + 2, "the other's file and its mapping"
    assert ring_id(path) == others[0].header.ring_id
    others[0].close()
    assert list(path.parent.iterdir()) == [path]


def test_a_ring_that_was_replaced_by_a_living_writer_in_between_is_left_to_it(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new_ring(path).close()
    others: list[RingWriter] = []
    before(monkeypatch, ring_file, "lock", lambda: others.append(new_ring(path)))
    with pytest.raises(RingError, match="has a writer already"):
        new_ring(path)
    assert ring_id(path) == others[0].header.ring_id
    others[0].close()


def test_a_ring_that_was_removed_in_between_is_made_anew(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    new_ring(path, rows=1).close()
    before(monkeypatch, ring_file, "lock", path.unlink)
    with new_ring(path) as ring:
        assert ring_id(path) == ring.header.ring_id
    assert list(path.parent.iterdir()) == [path]


def test_a_ring_that_was_replaced_and_left_in_between_is_replaced_again(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new_ring(path).close()
    before(monkeypatch, ring_file, "lock", lambda: new_ring(path, rows=1).close())
    with new_ring(path) as ring:
        assert ring_id(path) == ring.header.ring_id
    assert path.with_name("left.ring.previous").exists(), "the one in between had no end"


def test_memory_that_is_not_there_is_refused_and_leaves_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    open_before = descriptors()
    with pytest.raises(RingError, match=r"cannot create the telemetry ring .*: found No space left on device"):
        new_ring(path)
    assert descriptors() == open_before
    assert list(path.parent.iterdir()) == []


def test_nothing_stays_open_after_rings_that_replaced_each_other(path: Path) -> None:
    new_ring(path).close()
    open_before = descriptors()
    for _ in range(3):
        new_ring(path, rows=1).close()
    assert descriptors() == open_before


def test_the_group_may_read_whatever_the_umask_says(path: Path) -> None:
    mask = os.umask(0o077)
    try:
        new_ring(path).close()
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_whether_a_ring_is_there_is_said_or_why_it_cannot_be_seen(path: Path) -> None:
    assert not ring_file.exists(path)
    new_ring(path).close()
    assert ring_file.exists(path)
    with pytest.raises(RingError, match=r"File name too long.*a folder that can be searched"):
        ring_file.exists(path.parent / ("x" * 300))
