"""What is there to publish: the rows of a ring, or the texts of a process, by number and as long as they are kept."""

from __future__ import annotations

from collections import deque
from typing import Final, Protocol

from agent.telemetry.link.wire import BATCH_BYTES_MAX, End
from agent.telemetry.ring.reader import RingReader, RowBlock

TEXTS_KEPT: Final = 10_000
HEALTH_KEPT: Final = 600  # ten minutes


class Source(Protocol):
    """Numbered messages, of which the oldest may vanish."""

    source_id: int
    batch_max: int  # messages per publication

    @property
    def written(self) -> int:
        """How many messages there have been."""
        ...

    @property
    def oldest(self) -> int:
        """Number of the oldest message that may still be there."""
        ...

    @property
    def end(self) -> End:
        """Whether more will come; asked before `written`, never after."""
        ...

    def read(self, first: int, count: int) -> RowBlock:
        """First run of messages that are still there among `count` from `first`."""
        ...


class RowSource:
    """The rows of a ring.  A writer that died counts as an end: its ring is the black box."""

    def __init__(self, reader: RingReader, batch_bytes: int = BATCH_BYTES_MAX) -> None:
        """`batch_bytes`: of one publication at most, but for a row that is larger."""
        self._reader = reader
        self.source_id = reader.header.ring_id
        self.batch_max = max(1, batch_bytes // reader.header.row_bytes)

    @property
    def written(self) -> int:
        """How many rows were committed."""
        return self._reader.written

    @property
    def oldest(self) -> int:
        """Oldest row in the ring."""
        return self._reader.oldest

    @property
    def end(self) -> End:
        """FINISHED when the agent said so, DIED when its lock is free without that."""
        if self._reader.finished:
            return End.FINISHED
        return End.OPEN if self._reader.writer_alive or self._reader.finished else End.DIED

    def read(self, first: int, count: int) -> RowBlock:
        """Intact rows from `first` on; new rows in order, so that a row on its way from another core is waited for."""
        if first == self._reader.next_index:
            return self._reader.read_new(count)
        return self._reader.read_at(first, count)


class TextSource:
    """The last texts of this process; each is a publication of its own."""

    batch_max = 1

    def __init__(self, source_id: int, kept: int = TEXTS_KEPT) -> None:
        self.source_id = source_id
        self.end = End.OPEN
        self._texts: deque[bytes] = deque(maxlen=kept)
        self.written = 0

    @property
    def oldest(self) -> int:
        """Number of the oldest text kept."""
        return self.written - len(self._texts)

    def append(self, text: bytes) -> None:
        """Add a text."""
        self._texts.append(text)
        self.written += 1

    def read(self, first: int, count: int) -> RowBlock:
        """The text of that number, if it is still there."""
        if count <= 0 or not self.oldest <= first < self.written:
            return RowBlock(max(first, self.oldest), 0, b"")
        return RowBlock(first, 1, self._texts[first - self.oldest])
