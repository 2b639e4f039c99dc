"""Writes an MCAP file in batches: messages of constant size become records by array copies, many at a time.

The library's own writer makes several Python objects per message.  Here a batch is laid into the chunk as one array of
records; everything else in the file is written by the library's record classes.  Chunks are compressed (zstd), every
chunk has an index, and all checksums are there.  The second chunk declares the channels once more: of a log without its
end that has lost the first one, the others can be read.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

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

from agent.log.chunk import RECORD_HEAD_BYTES, WHEN, Chunk, Group, Part, RecordCopy

CHUNK_BYTES: Final = 1 << 20
LEVEL: Final = 1  # of zstd: two thirds of the default's time for 3 % more bytes
HASH_LOG: Final = 12  # of its table, 2¹² places, which stays in a first cache that others use too: 2 % more bytes
COMPRESSION: Final = "zstd"
_CHUNK_HEAD: Final = struct.Struct("<BQQQQII4sQ")
_INDEX_HEAD: Final = struct.Struct("<BQHI")
_FOOTER: Final = struct.Struct("<BQQQ")

Records = NDArray[np.void]
Numbers = NDArray[np.integer[Any]]


class BatchWriter:
    """One file.  `write` takes bytes in their order; what it raises leaves the writer unusable."""

    def __init__(self, write: Callable[[bytes | bytearray], object], *, chunk_bytes: int = CHUNK_BYTES) -> None:
        self._sink = write
        self._position = 0
        self._crc = 0
        self._chunk_bytes = chunk_bytes
        self._chunk = Chunk(chunk_bytes)
        parameters = zstandard.ZstdCompressionParameters.from_level(LEVEL, hash_log=HASH_LOG)
        self._compressor = zstandard.ZstdCompressor(compression_params=parameters)
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
        records: Records = np.ndarray(len(times), group.dtype, raw)  # a view would compare the types, field by field
        log_times = times.astype(np.uint64)
        when = np.empty(len(times), WHEN)
        when["sequence"], when["log_time"], when["publish_time"] = sequences, log_times, log_times
        for name in group.whens:
            records[name] = when
        places = tuple((channel, begin + offset) for channel, offset in zip(group.channels, group.offsets, strict=True))
        self._chunk.parts.append(Part(log_times, places, group.dtype.itemsize))
        return records

    def append_copy(self, copy: RecordCopy) -> None:
        """Add message records, at least one, as they are."""
        begin = np.uint64(self._chunk.size)
        self._add_record(copy.content)
        self._chunk.copies.append(replace(copy, content=b"", offsets=copy.offsets + begin))

    def end_chunk(self) -> None:
        """Write the chunk in progress with its index, if there is a message in it."""
        chunk = self._chunk
        times = [*(part.times for part in chunk.parts), *(copy.times for copy in chunk.copies)]
        if not times:
            return
        content = chunk.buffer[: chunk.size].data
        packed = self._compressor.compress(content)
        every = np.concatenate(times)
        begin, end = int(every.min()), int(every.max())
        at = self._position
        self._write(
            _CHUNK_HEAD.pack(
                Opcode.CHUNK, _CHUNK_HEAD.size - RECORD_HEAD_BYTES + len(packed), begin, end, chunk.size,
                zlib.crc32(content), len(COMPRESSION), COMPRESSION.encode(), len(packed),
            )
        )  # fmt: skip
        self._write(packed)
        index_at, index, offsets = self._position, bytearray(), {}
        for channel, entries in chunk.index().items():
            offsets[channel] = index_at + len(index)
            self._counts[channel] += len(entries)
            index += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
            index += entries.tobytes()
        self._write(index)
        self._chunks.append(
            ChunkIndex(
                chunk_length=index_at - at, chunk_start_offset=at, compression=COMPRESSION, compressed_size=len(packed),
                message_start_time=begin, message_end_time=end, uncompressed_size=chunk.size,
                message_index_length=self._position - index_at, message_index_offsets=offsets,
            )
        )  # fmt: skip
        chunk.clear()
        if len(self._chunks) == 1:
            for record in (*self._schemas.values(), *self._channels.values()):
                self._add_record(_encoded(record))

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

    def _write(self, data: bytes | bytearray) -> int:
        self._sink(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)
        return len(data)


def _encoded(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
