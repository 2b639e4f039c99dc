"""Which numbers of a stream are there: a set of whole numbers kept as ranges."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence

Range = tuple[int, int]  # first and last number, both in it


class Coverage:
    """A set of non-negative numbers as sorted, separate ranges.  Adding at the end, the usual case, is cheap."""

    def __init__(self, ranges: Iterable[Range] = ()) -> None:
        self._first: list[int] = []
        self._last: list[int] = []
        for first, last in ranges:
            self.add(first, last)

    @property
    def ranges(self) -> list[Range]:
        """The ranges, ascending."""
        return list(zip(self._first, self._last, strict=True))

    @property
    def count(self) -> int:
        """How many numbers are there."""
        return sum(self._last) - sum(self._first) + len(self._first)

    @property
    def end(self) -> int:
        """One more than the largest number, 0 when empty."""
        return self._last[-1] + 1 if self._last else 0

    def add(self, first: int, last: int) -> list[Range]:
        """Add `first` to `last`; return the ranges that were not there before."""
        new = self.missing(first, last)
        low = bisect_left(self._last, first - 1)
        high = bisect_right(self._first, last + 1)
        if low < high:
            first, last = min(first, self._first[low]), max(last, self._last[high - 1])
        self._first[low:high] = [first]
        self._last[low:high] = [last]
        return new

    def missing(self, first: int, last: int) -> list[Range]:
        """Ranges between `first` and `last` that are not there."""
        gaps = []
        for i in range(bisect_left(self._last, first), len(self._first)):
            if self._first[i] > last:
                break
            if self._first[i] > first:
                gaps.append((first, self._first[i] - 1))
            first = self._last[i] + 1
        if first <= last:
            gaps.append((first, last))
        return gaps


def count_of(ranges: Sequence[Range]) -> int:
    """How many numbers the ranges hold together."""
    return sum(last - first + 1 for first, last in ranges)
