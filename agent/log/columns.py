"""Rows of a log by column: a column is in memory while somebody uses it, and before that in a temporary file.

A row holds a few hundred numbers, an analysis wants a few of them at a time.  The rows of a long log are turned into
columns once, block by block; a number that does not change within a block takes no room.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, Self, overload

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Refusal

BLOCK_ROWS: Final = 2048
_WORD: Final = 8  # bytes
_PAD: Final = 4  # bytes before a message: behind its encapsulation header fields then lie on multiples of their size

Column = NDArray[Any]
Index = NDArray[np.bool_] | NDArray[np.integer[Any]]


class Source(Protocol):
    """Where columns come from."""

    def __len__(self) -> int:
        """How many rows there are."""
        ...

    def column(self, name: str, rows: slice, part: slice | None) -> Column:
        """Field `name` of a stretch of the rows, (k,) or (k, length); `part`: these numbers of an array alone.

        Raises KeyError for a field that the rows do not have.
        """
        ...

    def messages(self, rows: slice) -> NDArray[np.uint8]:
        """A stretch of the rows as they are encoded, (k, size)."""
        ...


class Table:
    """Rows (k,): `table[name]` is a column, `table[which]` a table of those rows, as with a structured array."""

    def __init__(
        self,
        source: Source,
        index: slice | NDArray[np.intp] | None = None,
        replaced: Mapping[str, Column] | None = None,
    ) -> None:
        """`index`: the rows of the source, all without it; `replaced`: columns of other values, for the rows chosen."""
        self._source = source
        self._index = slice(0, len(source)) if index is None else index
        self._replaced = dict(replaced or {})

    @classmethod
    def of(cls, rows: Table | NDArray[np.void]) -> Table:
        """The same rows; an array stays where it is."""
        return rows if isinstance(rows, Table) else cls(_Array(rows))

    def __len__(self) -> int:
        return self._index.stop - self._index.start if isinstance(self._index, slice) else len(self._index)

    @overload
    def __getitem__(self, key: str) -> Column: ...

    @overload
    def __getitem__(self, key: slice | Index) -> Table: ...

    def __getitem__(self, key: str | slice | Index) -> Column | Table:
        if isinstance(key, str):
            return self.column(key)
        replaced = {name: column[key] for name, column in self._replaced.items()}
        return Table(self._source, _chosen(self._index, key), replaced)

    def column(self, name: str, part: slice | None = None) -> Column:
        """Column (k,) or (k, length); `part`: of an array only these numbers, (k, …)."""
        if name in self._replaced:
            return self._replaced[name] if part is None else self._replaced[name][:, part]
        if isinstance(self._index, slice):
            return self._source.column(name, self._index, part)
        return self._source.column(name, slice(0, len(self._source)), part)[self._index]

    def messages(self) -> NDArray[np.uint8]:
        """The rows as they are encoded, (k, size), whatever columns were replaced."""
        if isinstance(self._index, slice):
            return self._source.messages(self._index)
        if not len(self._index):
            return self._source.messages(slice(0, 0))
        first = int(self._index.min())
        return self._source.messages(slice(first, int(self._index.max()) + 1))[self._index - first]

    def with_column(self, name: str, values: Column) -> Table:
        """The same rows with other values (k, …) of one column."""
        return Table(self._source, self._index, {**self._replaced, name: values})

    def blocks(self, rows: int) -> Iterator[Table]:
        """The same rows in stretches of at most so many."""
        return (self[begin : begin + rows] for begin in range(0, len(self), rows))


def _chosen(index: slice | NDArray[np.intp], key: slice | Index) -> slice | NDArray[np.intp]:
    """Which rows of the source the rows `key` of those of `index` are; a stretch stays a slice."""
    every = np.arange(index.start, index.stop) if isinstance(index, slice) else index
    where = every[key]
    if len(where) and where[-1] - where[0] == len(where) - 1 and np.all(np.diff(where) == 1):
        return slice(int(where[0]), int(where[-1]) + 1)
    return where if len(where) else slice(0, 0)


class _Array:
    """Rows that are in memory."""

    def __init__(self, rows: NDArray[np.void]) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def column(self, name: str, rows: slice, part: slice | None) -> Column:
        if name not in (self._rows.dtype.names or ()):
            raise KeyError(name)
        whole: Column = self._rows[name][rows]
        return whole if part is None else whole[:, part]

    def messages(self, rows: slice) -> NDArray[np.uint8]:
        chosen = np.ascontiguousarray(self._rows[rows])
        return chosen.view(np.uint8).reshape(len(chosen), chosen.dtype.itemsize)


# -------------------------------------------------------------------------------------------------- in a temporary file


class ColumnFileError(Refusal):
    """There is no room for the columns of a log, or they are gone."""


class ColumnFile:
    """A temporary file without a name, for the time of a `with` block.  Raises ColumnFileError."""

    def __init__(self, folder: Path | None = None) -> None:
        """`folder`: where it lies; /var/tmp without it, which is a disk where /tmp is memory, or where TMPDIR says."""
        self._folder = Path(_scratch()) if folder is None else folder
        try:
            self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115 (closed by __exit__)
        except OSError as error:
            raise self._refusal(error) from error
        self.bytes_written = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, data: NDArray[Any]) -> int:
        """Add the bytes of a contiguous array; returns where they are."""
        at, view = self.bytes_written, data.reshape(-1).view(np.uint8).data
        try:
            while view:
                count = os.pwrite(self._file.fileno(), view, self.bytes_written)
                self.bytes_written += count
                view = view[count:]
        except OSError as error:
            raise self._refusal(error) from error
        return at

    def read(self, at: int, length: int) -> bytes:
        """Bytes that were added before.  Raises ColumnFileError once the file is closed."""
        if self._file.closed:
            raise ColumnFileError(
                "rows of a log", found="a run that has been closed", expected="one that is open",
                remedy="use its rows within the `with` block, or load the log again",
            )  # fmt: skip
        return os.pread(self._file.fileno(), length, at)

    def _refusal(self, error: OSError) -> ColumnFileError:
        return ColumnFileError(
            f"cannot keep the columns of a log in {self._folder}",
            found=error.strerror,
            expected="a folder that can be written, with room for twice the log",
            remedy="make room, or name another folder in TMPDIR",
        )


def _scratch() -> str:
    told = tempfile.gettempdir()
    return "/var/tmp" if told == "/tmp" and os.access("/var/tmp", os.W_OK) else told


@dataclass(frozen=True, slots=True)
class _Block:
    """BLOCK_ROWS rows, or fewer in the last one: the words that vary, one column behind the other."""

    rows: int
    at: int  # of the first column in the file
    place: NDArray[np.int32]  # of each word among the columns, −1 for a constant one
    constant: NDArray[np.uint64]


class StoredRows:
    """Rows of one layout in a ColumnFile: first added, then read."""

    def __init__(self, file: ColumnFile, dtype: np.dtype[np.void]) -> None:
        self._file = file
        self._dtype = dtype
        self._staged = np.zeros((BLOCK_ROWS, -(-(_PAD + dtype.itemsize) // _WORD)), np.uint64)
        self._staged_count = 0
        self._blocks: list[_Block] = []

    def __len__(self) -> int:
        return sum(block.rows for block in self._blocks) + self._staged_count

    def add(self, messages: NDArray[np.uint8]) -> None:
        """Add complete messages (k, size)."""
        raw = self._staged.view(np.uint8)[:, _PAD : _PAD + self._dtype.itemsize]
        while len(messages):
            count = min(len(messages), BLOCK_ROWS - self._staged_count)
            raw[self._staged_count : self._staged_count + count] = messages[:count]
            self._staged_count += count
            messages = messages[count:]
            if self._staged_count == BLOCK_ROWS:
                self._end_block()

    def finish(self) -> None:
        """No row will follow."""
        if self._staged_count:
            self._end_block()
        self._staged = self._staged[:0].copy()

    def column(self, name: str, rows: slice, part: slice | None) -> Column:
        """Field `name` of the rows, as `Source` has it."""
        base, first, count, is_array = self._place(name)
        words = range(first // _WORD, first // _WORD + count)[part or slice(None)]
        within, step = first % _WORD // base.itemsize, _WORD // base.itemsize
        out = np.empty((max(0, rows.stop - rows.start), len(words)), base)
        for block, of, to in self._blocks_of(rows):
            for j, values in enumerate(self._read(block, words.start, len(words))):
                chosen = values.view(base)[within::step]
                out[to, j] = chosen[of] if len(chosen) > 1 else chosen
        return out if is_array else out[:, 0]

    def messages(self, rows: slice) -> NDArray[np.uint8]:
        """A stretch of the rows as they are encoded."""
        out = np.empty((max(0, rows.stop - rows.start), self._staged.shape[1]), np.uint64)
        for block, of, to in self._blocks_of(rows):
            for word, values in enumerate(self._read(block, 0, out.shape[1])):
                out[to, word] = values[of] if len(values) > 1 else values
        return out.view(np.uint8)[:, _PAD : _PAD + self._dtype.itemsize]

    def _blocks_of(self, rows: slice) -> Iterator[tuple[_Block, slice, slice]]:
        """Blocks that have some of the rows; which of the block's they are, and which of `rows`."""
        begin = 0
        for block in self._blocks:
            low, high = max(rows.start, begin), min(rows.stop, begin + block.rows)
            if low < high:
                yield block, slice(low - begin, high - begin), slice(low - rows.start, high - rows.start)
            begin += block.rows

    def _place(self, name: str) -> tuple[np.dtype[Any], int, int, bool]:
        """Type, first byte, how many numbers, and whether they are an array.  Raises KeyError."""
        fields = self._dtype.fields
        assert fields is not None
        dtype, offset = fields[name][:2]
        base, shape = dtype.subdtype or (dtype, ())
        if shape and base.itemsize < _WORD:
            raise KeyError(name)
        return base, _PAD + offset, shape[0] if shape else 1, bool(shape)

    def _read(self, block: _Block, word: int, width: int) -> list[NDArray[np.uint64]]:
        """So many words of a block, each (rows,) or, when it does not vary, (1,)."""
        place = block.place[word : word + width]
        varying = place[place >= 0]
        if not len(varying):
            return [block.constant[w : w + 1] for w in range(word, word + width)]
        first, count = int(varying[0]), len(varying)  # words that vary stand in their order
        data = self._file.read(block.at + first * block.rows * _WORD, count * block.rows * _WORD)
        columns = np.frombuffer(data, np.uint64).reshape(count, block.rows)
        return [
            columns[p - first] if p >= 0 else block.constant[word + j : word + j + 1]
            for j, p in enumerate(place.tolist())
        ]

    def _end_block(self) -> None:
        count, self._staged_count = self._staged_count, 0
        words = np.ascontiguousarray(self._staged[:count].T)
        varies = np.any(words[:, 1:] != words[:, :1], axis=1)
        place = np.where(varies, np.cumsum(varies) - 1, -1).astype(np.int32)
        at = self._file.append(words[varies])
        self._blocks.append(_Block(count, at, place, words[:, 0].copy()))
