"""The order in which workers begin the tests: what waits runs all along beside what computes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from itertools import groupby, islice
from typing import TypeVar

Test = TypeVar("Test")


def dealt(
    tests: Sequence[Test], workers: int, waits: Callable[[Test], bool], file: Callable[[Test], Hashable]
) -> list[Test]:
    """The same tests; those that wait stand at the head of the shares of half of the workers, file by file in turn.

    xdist gives each worker an equal share of the list, in its order, and what one has left to whoever is done.
    """
    if workers < 2:
        return list(tests)
    heads: list[list[Test]] = [[] for _ in range(workers // 2)]
    for k, (_, of_file) in enumerate(groupby(filter(waits, tests), file)):
        heads[k % len(heads)].extend(of_file)
    others = (test for test in tests if not waits(test))
    order: list[Test] = []
    for k in range(workers):
        head = heads[k] if k < len(heads) else []
        share = (len(tests) - len(order)) // (workers - k)
        order += head
        order += islice(others, max(0, share - len(head)))
    return [*order, *others]
