"""What an MCAP record says of itself: how long it is by what it holds, and what a chunk holds.

The length in a record's head is the one number that all behind it hangs on, and no checksum covers it.  What the record
holds says it again: where the two differ one of them is damaged.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from typing import Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk
from mcap.stream_reader import get_chunk_data_stream

CHUNK_BYTES_MAX: Final = 1 << 28
RECORD_HEAD: Final = struct.Struct("<BQ")
BAD_RECORD: Final = (ValueError, RuntimeError, OverflowError, McapError, struct.error, zstandard.ZstdError)
_CHUNK_HEAD: Final = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_TEXT, _LONG = "text", "long"  # what follows a length of 4 bytes (texts, tables), and of 8
_PARTS: Final[dict[int, tuple[int | str, ...]]] = {  # of a record, in their order; a number: so many bytes
    Opcode.HEADER: (_TEXT, _TEXT),
    Opcode.FOOTER: (20,),
    Opcode.SCHEMA: (2, _TEXT, _TEXT, _TEXT),
    Opcode.CHANNEL: (4, _TEXT, _TEXT, _TEXT),
    Opcode.CHUNK: (28, _TEXT, _LONG),
    Opcode.MESSAGE_INDEX: (2, _TEXT),
    Opcode.CHUNK_INDEX: (32, _TEXT, 8, _TEXT, 16),
    Opcode.ATTACHMENT: (16, _TEXT, _TEXT, _LONG, 4),
    Opcode.ATTACHMENT_INDEX: (40, _TEXT, _TEXT),
    Opcode.STATISTICS: (42, _TEXT),
    Opcode.METADATA: (_TEXT, _TEXT),
    Opcode.METADATA_INDEX: (16, _TEXT),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}


def length_by_content(opcode: int, read: Callable[[int, int], bytes]) -> int | None:
    """Bytes of a record behind its head, by what it holds; None for kinds that do not say.

    read(at, size): bytes of it from `at` on, none where nothing is.
    """
    parts, at = _PARTS.get(opcode), 0
    for part in parts or ():
        if isinstance(part, int):
            at += part
        else:
            width = 4 if part == _TEXT else 8
            at += width + int.from_bytes(read(at, width), "little")
    return at if parts else None


def stream_of(body: bytes | memoryview) -> ReadDataStream:
    """The body of a record, for the library's readers."""
    return ReadDataStream(BytesIO(body))


def uncompressed(body: bytes) -> bytes:
    """Content of a chunk.  Raises one of BAD_RECORD when it is too large or its checksum is wrong."""
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    if size > CHUNK_BYTES_MAX:
        raise ValueError(f"a chunk of {size} bytes")
    name_at = _CHUNK_HEAD.size
    packed_at = name_at + name_length + 8
    if body[name_at : name_at + name_length] != b"zstd":
        stream, length = get_chunk_data_stream(Chunk.read(stream_of(body)), validate_crc=True)
        return stream.read(length)
    packed = memoryview(body)[packed_at : packed_at + int.from_bytes(body[packed_at - 8 : packed_at], "little")]
    if zstandard.frame_content_size(packed) not in (-1, size):
        raise ValueError("a chunk of another size than it says")
    data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("a chunk with a wrong checksum")
    return data


def attachment(body: bytes) -> Attachment:
    """Raises one of BAD_RECORD when its checksum is wrong."""
    if zlib.crc32(memoryview(body)[:-4]) != struct.unpack("<I", body[-4:])[0]:
        raise ValueError("attachment with a wrong checksum")
    found: Attachment = Attachment.read(stream_of(body))
    return found
