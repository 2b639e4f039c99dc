"""The ring's file: header, geometry, lock; a file that is not such a ring is refused.

    0     static header: magic, version, geometry, layout hash, ring id, writer pid, creation time, CRC32, label (JSON)
    1024  rows written          \\
    1088  finished flag          > one cache line each, native 64-bit words
    1152  rows acknowledged     /
    4096  slots: row index + 1 (u8), CRC32 (u4), message; the message's payload lies on a multiple of 8 bytes
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from agent.telemetry.ring.taken import writer_of
from drivers.interface import Refusal

MAGIC: Final = b"COOPRING"
VERSION: Final = 1
SLOTS_OFFSET: Final = 4096
WRITTEN_WORD: Final = 1024 // 8
FINISHED_WORD: Final = 1088 // 8
ACKNOWLEDGED_WORD: Final = 1152 // 8
MESSAGE_IN_SLOT: Final = 12  # index (8) + CRC (4); with a 4-byte encapsulation header the payload starts at 16
MAX_FILE_BYTES: Final = 1 << 30
WRITTEN_MAX: Final = (1 << 62) - 1  # as much as the network's header takes

_STATIC: Final = struct.Struct("<8sIIII32sQqI")  # magic version row_bytes stride slots layout ring_id created_ns pid
_LABEL_OFFSET: Final = _STATIC.size + 8  # CRC32 and label length lie between
_LABEL_MAX: Final = 1024 - _LABEL_OFFSET
_CACHE_LINE: Final = 64
_WRITER, _SUCCESSOR = 0, 1  # bytes whose locks say: I write this ring; I am about to replace it (no data there)


class RingError(Refusal):
    """The ring file cannot be used as it is."""


class RowFormat(Protocol):
    """What a ring needs to know of its rows; `sample.Layout` is one."""

    @property
    def ros_name(self) -> str:
        """Name of the message."""
        ...

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Packed dtype of one row, a 4-byte encapsulation header first."""
        ...

    @property
    def definition(self) -> str:
        """Text that changes whenever the layout does."""
        ...


def layout_hash(row_format: RowFormat) -> bytes:
    """SHA-256 (32 bytes) of the name and definition of a layout: equal exactly when rows are exchangeable."""
    return hashlib.sha256(f"{row_format.ros_name}\n{row_format.definition}".encode()).digest()


@dataclass(frozen=True, slots=True)
class RingHeader:
    """The static part of the file, written once before the file gets its name."""

    row_bytes: int
    stride: int
    slots: int
    layout: bytes
    ring_id: int  # random; tells two runs of the same agent apart
    created_ns: int  # UTC
    pid: int
    name: str  # arm, or "plant"
    joints: tuple[str, ...]

    @property
    def file_bytes(self) -> int:
        """Size of the whole file."""
        return SLOTS_OFFSET + self.slots * self.stride

    def pack(self) -> bytes:
        """The bytes of the header.  Raises RingError when the label is too long."""
        static = _STATIC.pack(
            MAGIC, VERSION, self.row_bytes, self.stride, self.slots,
            self.layout, self.ring_id, self.created_ns, self.pid,
        )  # fmt: skip
        label = json.dumps({"name": self.name, "joints": self.joints}).encode()
        if len(label) > _LABEL_MAX:
            raise RingError(
                "ring label too long", found=f"{len(label)} bytes", expected=f"at most {_LABEL_MAX}",
                remedy="use shorter joint names",
            )  # fmt: skip
        return static + struct.pack("<II", zlib.crc32(label, zlib.crc32(static)), len(label)) + label

    @classmethod
    def unpack(cls, path: Path, data: bytes) -> RingHeader:
        """Header of `data`, the first bytes of the file.  Raises RingError on anything that is not a ring of ours."""
        if len(data) < SLOTS_OFFSET or data[:8] != MAGIC:
            raise RingError(
                f"{path} is not a telemetry ring",
                found=f"{len(data)} bytes starting {data[:8]!r}",
                expected=f"{MAGIC!r}",
                remedy="give the path the agent printed at its start",
            )
        _, version, row_bytes, stride, slots, layout, ring_id, created_ns, pid = _STATIC.unpack_from(data)
        crc, label_bytes = struct.unpack_from("<II", data, _STATIC.size)
        label = data[_LABEL_OFFSET : _LABEL_OFFSET + min(label_bytes, _LABEL_MAX)]
        if version != VERSION:
            raise RingError(
                f"{path} has another version", found=version, expected=VERSION,
                remedy="run agent and telemetry from one release",
            )  # fmt: skip
        try:
            if zlib.crc32(label, zlib.crc32(data[: _STATIC.size])) != crc:
                raise ValueError("checksum")
            described = json.loads(label)
            name, joints = str(described["name"]), tuple(str(joint) for joint in described["joints"])
        except (ValueError, KeyError, TypeError) as error:
            raise RingError(
                f"{path} has a damaged header",
                found=repr(error),
                expected="the header of a ring",
                remedy="restart the agent",
            ) from error
        return cls(row_bytes, stride, slots, layout, ring_id, created_ns, pid, name, joints)


def stride_of(row_bytes: int) -> int:
    """Bytes from one slot to the next."""
    return -(-(MESSAGE_IN_SLOT + row_bytes) // _CACHE_LINE) * _CACHE_LINE


def make_header(
    row_format: RowFormat, *, slots: int, name: str, joints: tuple[str, ...], created_ns: int
) -> RingHeader:
    """Header for a new ring of `slots` rows.  Raises RingError when the size is out of bounds."""
    row_bytes = row_format.dtype.itemsize
    stride = stride_of(row_bytes)
    if not 2 <= slots <= (MAX_FILE_BYTES - SLOTS_OFFSET) // stride:
        raise RingError(
            "ring size out of bounds", found=f"{slots} slots",
            expected=f"2 to {(MAX_FILE_BYTES - SLOTS_OFFSET) // stride}", remedy="change the number of slots",
        )  # fmt: skip
    ring_id = int.from_bytes(os.urandom(8), "little") | 1  # never 0, which means "none" on the wire
    return RingHeader(row_bytes, stride, slots, layout_hash(row_format), ring_id, created_ns, os.getpid(), name, joints)


def check_format(path: Path, header: RingHeader, row_format: RowFormat, file_bytes: int) -> None:
    """Raise RingError unless the file holds whole slots of exactly this format."""
    if header.layout != layout_hash(row_format) or header.row_bytes != row_format.dtype.itemsize:
        raise RingError(
            f"{path} has another layout",
            found=f"{header.layout.hex()[:12]}, {header.row_bytes} bytes",
            expected=f"{layout_hash(row_format).hex()[:12]}, {row_format.dtype.itemsize} bytes ({row_format.ros_name})",
            remedy="run agent and telemetry from one release",
        )
    if header.stride != stride_of(header.row_bytes) or header.slots < 1:
        raise RingError(
            f"{path} has another geometry",
            found=f"{header.slots} slots of {header.stride} bytes",
            expected=f"slots of {stride_of(header.row_bytes)} bytes",
            remedy="run agent and telemetry from one release",
        )
    if file_bytes < header.file_bytes:
        raise RingError(
            f"{path} is cut short",
            found=f"{file_bytes} bytes",
            expected=f"{header.file_bytes}",
            remedy="free memory where the ring lies and restart the agent",
        )


def exists(path: Path) -> bool:
    """Whether the ring is there.  Raises RingError when that cannot be seen."""
    try:
        return path.exists()
    except OSError as error:
        raise RingError(
            f"telemetry ring {path}", found=error.strerror, expected="a folder that can be searched",
            remedy="start telemetry as a user of the agent's group",
        ) from error  # fmt: skip


def claim(path: Path, header: RingHeader) -> int:
    """Descriptor of a new, locked, ready ring that already has its name.  Raises RingError, OSError."""
    while True:
        try:
            old = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            fd = _create_as(path, header, os.link)
            if fd is not None:
                return fd
            continue
        try:
            if not lock(old, _SUCCESSOR) or is_locked(old):
                raise _taken(path, old)
            if not _is_file(path, old):
                continue  # replaced between open and lock: look again at what is there now
            _refuse_other_file(path, old)
            if _is_unfinished(old):
                path.with_name(path.name + ".previous").unlink(missing_ok=True)
                os.link(path, path.with_name(path.name + ".previous"))
            fd = _create_as(path, header, os.replace)
            assert fd is not None, "replacing does not mind what is there"
            return fd
        finally:
            os.close(old)


def _taken(path: Path, fd: int) -> RingError:
    try:
        header = RingHeader.unpack(path, os.pread(fd, SLOTS_OFFSET, 0))
        found, remedy = writer_of(header.name, header.pid)
    except RingError:  # cut short under its writer
        found, remedy = "its lock held by another process", "stop it first"
    return RingError(f"{path} has a writer already", found=found, expected="one writer", remedy=remedy)


def lock(fd: int, byte: int = _WRITER) -> bool:
    """Take the writer's lock; False when another process holds it.  The kernel frees it when its holder dies."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _lock_request(fcntl.F_WRLCK, byte))
    except BlockingIOError:
        return False
    return True


def is_locked(fd: int) -> bool:
    """Whether a writer holds the lock.  Asks without taking it, so it cannot disturb a writer that starts."""
    answer: bytes = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _lock_request(fcntl.F_RDLCK, _WRITER))
    return int(struct.unpack_from("h", answer)[0]) != fcntl.F_UNLCK


def _lock_request(kind: int, byte: int) -> bytes:
    return struct.pack("hhqqi4x", kind, os.SEEK_SET, byte, 1, 0)  # struct flock on 64-bit Linux


def _create_as(path: Path, header: RingHeader, put_in_place: Callable[[Path, Path], None]) -> int | None:
    """Write a new ring beside `path` and give it that name whole, so that no reader sees half a header.

    None when `put_in_place` finds a file there that must not be replaced.
    """
    temporary = path.with_name(f"{path.name}.{header.ring_id:x}.new")
    fd = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)
    try:
        os.fchmod(fd, 0o640)
        os.posix_fallocate(fd, 0, header.file_bytes)  # full memory is an error here, not a SIGBUS in the loop
        os.pwrite(fd, header.pack(), 0)
        if not lock(fd):
            raise AssertionError("nobody else knows this file")
        put_in_place(temporary, path)
    except FileExistsError:
        os.close(fd)
        return None
    except BaseException:
        os.close(fd)
        raise
    finally:
        temporary.unlink(missing_ok=True)
    return fd


def _is_file(path: Path, fd: int) -> bool:
    try:
        return path.stat().st_ino == os.fstat(fd).st_ino
    except FileNotFoundError:
        return False


def _refuse_other_file(path: Path, fd: int) -> None:
    """Raise RingError for a file with contents that no ring has: somebody's own, under the name we were given."""
    head = os.pread(fd, len(MAGIC), 0)
    if head not in (b"", MAGIC):
        raise RingError(
            f"{path} is not a telemetry ring",
            found=f"a file starting {head!r}",
            expected="a ring, or no file",
            remedy="give a path that nothing else uses",
        )


def _is_unfinished(fd: int) -> bool:
    head = os.pread(fd, SLOTS_OFFSET, 0)
    if len(head) < SLOTS_OFFSET or head[:8] != MAGIC:
        return False
    written, finished = (struct.unpack_from("=Q", head, 8 * word)[0] for word in (WRITTEN_WORD, FINISHED_WORD))
    return bool(written and not finished)
