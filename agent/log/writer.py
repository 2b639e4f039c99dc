"""Writes an MCAP file in batches: messages of constant size become records by array copies, many at a time.

The library's own writer makes several Python objects per message.  Here a batch is laid into the chunk as one array of
records; everything else in the file is written by the library's record classes.  Chunks are compressed (zstd), every
chunk has an index, and all checksums are there.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

CHUNK_BYTES: Final = 1 << 20
LEVEL: Final = 1  # of zstd: two thirds of the default's time for 3 % more bytes
COMPRESSION: Final = "zstd"
HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # of a message record; the message follows
RECORD_HEAD_BYTES: Final = 9  # opcode and length, which counts what is behind it
_CHUNK_HEAD: Final = struct.Struct("<BQQQQII4sQ")
_INDEX_HEAD: Final = struct.Struct("<BQHI")
_FOOTER: Final = struct.Struct("<BQQQ")

Records = NDArray[np.void]
Numbers = NDArray[np.integer[Any]]


class Message(NamedTuple):
    """One kind of message of constant size."""

    channel: int
    dtype: np.dtype[Any]
    template: bytes = b""  # encoded message whose numbers the caller fills in; empty: the caller gives every byte


class Group:
    """Messages that are written together, one of each kind at a time."""

    def __init__(self, messages: Sequence[Message]) -> None:
        """`messages`: at least one; all with a template, or a single one without."""
        fields: list[Any] = []
        template = b""
        for i, m in enumerate(messages):
            fields += [(f"head{i}", HEAD), (f"message{i}", m.dtype)]
            length = HEAD.itemsize - RECORD_HEAD_BYTES + m.dtype.itemsize
            head = struct.pack("<BQH", Opcode.MESSAGE, length, m.channel)
            template += head.ljust(HEAD.itemsize, b"\0") + m.template
        self.channels = tuple(m.channel for m in messages)
        self.dtype: np.dtype[np.void] = np.dtype(fields)
        self.template = np.frombuffer(template, np.uint8)  # the beginning of each record
        self.heads = tuple(f"head{i}" for i in range(len(messages)))
        self.names = tuple(f"message{i}" for i in range(len(messages)))
        assert self.dtype.fields is not None
        self.offsets = tuple(self.dtype.fields[head][1] for head in self.heads)


@dataclass(frozen=True, slots=True)
class _Part:
    """Where messages written together lie in a chunk: the first of each channel, and the distance to the next."""

    times: NDArray[np.uint64]
    first: tuple[tuple[int, int], ...]  # channel and place
    stride: int


class _Chunk:
    """The chunk in progress."""

    def __init__(self, chunk_bytes: int) -> None:
        self.buffer = np.empty(chunk_bytes, np.uint8)
        self.clear()

    def clear(self) -> None:
        self.size = 0
        self.parts: list[_Part] = []

    def reserve(self, size: int) -> NDArray[np.uint8]:
        """The next so many bytes; those before stay where they are."""
        if self.size + size > len(self.buffer):
            larger = np.empty(self.size + size, np.uint8)
            larger[: self.size] = self.buffer[: self.size]
            self.buffer = larger
        begin, self.size = self.size, self.size + size
        return self.buffer[begin : self.size]

    def index(self) -> dict[int, NDArray[np.uint64]]:
        """The entries (k, 2) of the message index by channel: time and place."""
        pieces: dict[int, list[NDArray[np.uint64]]] = {}
        for part in self.parts:
            distance = np.arange(0, part.stride * len(part.times), part.stride, dtype=np.uint64)
            for channel, first in part.first:
                pieces.setdefault(channel, []).append(np.stack([part.times, distance + np.uint64(first)], axis=1))
        return {channel: np.concatenate(own) for channel, own in pieces.items()}


class BatchWriter:
    """One file.  `write` takes bytes in their order; what it raises leaves the writer unusable."""

    def __init__(self, write: Callable[[bytes], object], *, chunk_bytes: int = CHUNK_BYTES, level: int = LEVEL) -> None:
        self._sink = write
        self._position = 0
        self._crc = 0
        self._chunk_bytes = chunk_bytes
        self._chunk = _Chunk(chunk_bytes)
        self._compressor = zstandard.ZstdCompressor(level=level)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: Counter[int] = Counter()  # messages by channel

    def start(self, profile: str, library: str) -> None:
        """Magic and header."""
        self._write(MAGIC)
        self._write(_encoded(Header(profile, library)))

    def add_attachment(self, attachment: Attachment) -> None:
        """Write a file into the log; goes out at once."""
        at = self._position
        length = self._write(_encoded(attachment))
        self._attachments.append(
            AttachmentIndex(
                offset=at, length=length, create_time=attachment.create_time, log_time=attachment.log_time,
                data_size=len(attachment.data), name=attachment.name, media_type=attachment.media_type,
            )
        )  # fmt: skip

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts; goes out at once."""
        at = self._position
        length = self._write(_encoded(Metadata(name=name, metadata=dict(values))))
        self._metadata.append(MetadataIndex(offset=at, length=length, name=name))

    def add_schema(self, schema: Schema) -> None:
        """Declare a schema; its number is the caller's, not 0."""
        self._schemas[schema.id] = schema
        self._add_record(_encoded(schema))

    def add_channel(self, channel: Channel) -> None:
        """Declare a channel of a schema declared before; its number is the caller's."""
        self._channels[channel.id] = channel
        self._add_record(_encoded(channel))

    @property
    def full(self) -> bool:
        """Whether the chunk in progress should end."""
        return self._chunk.size >= self._chunk_bytes

    def room(self, record_bytes: int) -> int:
        """How many records of that size make the chunk in progress full; at least 1."""
        return max(1, -(-(self._chunk_bytes - self._chunk.size) // record_bytes))

    def append(self, group: Group, sequences: Numbers, times: Numbers) -> Records:
        """Add one message of each channel of the group per time (k,); returns the records (k,).

        The caller fills the messages of the returned records before anything else is done with this writer.
        """
        begin = self._chunk.size
        raw = self._chunk.reserve(len(times) * group.dtype.itemsize)
        raw.reshape(len(times), -1)[:, : len(group.template)] = group.template
        records = raw.view(group.dtype)
        log_times = times.astype(np.uint64)
        for head in group.heads:
            heads = records[head]
            heads["sequence"], heads["log_time"], heads["publish_time"] = sequences, log_times, log_times
        places = tuple((channel, begin + offset) for channel, offset in zip(group.channels, group.offsets, strict=True))
        self._chunk.parts.append(_Part(log_times, places, group.dtype.itemsize))
        return records

    def append_records(self, records: Records) -> None:
        """Add message records (k,) of one channel, which begin with HEAD, as they are."""
        begin = self._chunk.size
        self._chunk.reserve(records.nbytes).view(records.dtype)[...] = records
        places = ((int(records["channel"][0]), begin),)
        self._chunk.parts.append(_Part(records["log_time"].astype(np.uint64), places, records.dtype.itemsize))

    def end_chunk(self) -> None:
        """Write the chunk in progress with its index, if there is a message in it."""
        chunk = self._chunk
        if not chunk.parts:
            return
        content = chunk.buffer[: chunk.size].data
        packed = self._compressor.compress(content)
        begin = min(int(part.times.min()) for part in chunk.parts)
        end = max(int(part.times.max()) for part in chunk.parts)
        at = self._position
        self._write(
            _CHUNK_HEAD.pack(
                Opcode.CHUNK, _CHUNK_HEAD.size - RECORD_HEAD_BYTES + len(packed), begin, end, chunk.size,
                zlib.crc32(content), len(COMPRESSION), COMPRESSION.encode(), len(packed),
            )
        )  # fmt: skip
        self._write(packed)
        index_at, offsets = self._position, {}
        for channel, entries in chunk.index().items():
            offsets[channel] = self._position
            self._counts[channel] += len(entries)
            self._write(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes))
            self._write(entries.tobytes())
        self._chunks.append(
            ChunkIndex(
                chunk_length=index_at - at, chunk_start_offset=at, compression=COMPRESSION, compressed_size=len(packed),
                message_start_time=begin, message_end_time=end, uncompressed_size=chunk.size,
                message_index_length=self._position - index_at, message_index_offsets=offsets,
            )
        )  # fmt: skip
        chunk.clear()

    def finish(self) -> None:
        """End the chunk in progress; write the summary and the closing magic."""
        self.end_chunk()
        self._write(_encoded(DataEnd(self._crc)))
        begin = self._position
        summary, offsets = b"", []
        for opcode, records in self._summary_groups():
            content = b"".join(_encoded(record) for record in records)
            if content:
                offsets.append(SummaryOffset(opcode, begin + len(summary), len(content)))
                summary += content
        offsets_at = begin + len(summary)
        summary += b"".join(_encoded(offset) for offset in offsets)
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, 20, begin, offsets_at), zlib.crc32(summary))
        self._write(summary)
        self._write(_encoded(Footer(begin, offsets_at, crc)))
        self._write(MAGIC)

    def _summary_groups(self) -> Iterable[tuple[int, Sequence[Any]]]:
        yield Opcode.SCHEMA, list(self._schemas.values())
        yield Opcode.CHANNEL, list(self._channels.values())
        yield Opcode.STATISTICS, [self._statistics()]
        yield Opcode.CHUNK_INDEX, self._chunks
        yield Opcode.ATTACHMENT_INDEX, self._attachments
        yield Opcode.METADATA_INDEX, self._metadata

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _add_record(self, encoded: bytes) -> None:
        """Into the chunk in progress, which holds what its messages need."""
        self._chunk.reserve(len(encoded))[...] = np.frombuffer(encoded, np.uint8)

    def _write(self, data: bytes) -> int:
        self._sink(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)
        return len(data)


def _encoded(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
