"""What follows from a cell alone, worked out once for as long as that cell lives."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from agent.config.cell import Cell

T = TypeVar("T")


def once_per_cell(find: Callable[[Cell], T]) -> Callable[[Cell], T]:
    """`find`, asked once of each cell (the object: cells with the same files count as two); what it raises is not kept.

    For what nobody changes: who asks again gets the same object.
    """
    kept: dict[int, tuple[weakref.ref[Cell], T]] = {}

    @wraps(find)
    def found(cell: Cell) -> T:
        mine = id(cell)
        if mine not in kept:
            value = find(cell)
            kept[mine] = weakref.ref(cell, lambda _: kept.pop(mine)), value
        return kept[mine][1]

    return found
