"""The order in which workers begin the tests: what waits runs all along beside what computes, and files that build
something for all of their tests are not torn apart."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from itertools import groupby, islice
from typing import TypeVar

Test = TypeVar("Test")


def dealt(
    tests: Sequence[Test],
    workers: int,
    waits: Callable[[Test], bool],
    builds: Callable[[Test], bool],
    file: Callable[[Test], Hashable],
) -> list[Test]:
    """The same tests; those that wait stand at the head of the shares of half of the workers, file by file in turn.

    Those of files that build something stand at the head of the shares of the others.  xdist gives each worker an
    equal share of the list, in its order, and what one has left, from the end, to whoever is done.
    """
    if workers < 2:
        return list(tests)
    half = workers // 2
    heads: list[list[Test]] = [[] for _ in range(workers)]
    for of_kind, places in ((waits, range(half)), (builds, range(half, workers))):
        for k, (_, of_file) in enumerate(groupby(filter(of_kind, tests), file)):
            heads[places[k % len(places)]].extend(of_file)
    others = (test for test in tests if not waits(test) and not builds(test))
    order: list[Test] = []
    for k, head in enumerate(heads):
        share = (len(tests) - len(order)) // (workers - k)
        order += head
        order += islice(others, max(0, share - len(head)))
    return [*order, *others]
