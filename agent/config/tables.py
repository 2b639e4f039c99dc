"""The tables of a TOML text; the last few texts are remembered, for a cell's are read again and again."""

from __future__ import annotations

import tomllib
from copy import deepcopy
from functools import lru_cache
from typing import Any, Final

LARGEST_REMEMBERED: Final = 100_000  # characters


def tables(text: str) -> dict[str, Any]:
    """The document, whose receiver may change it.  Raises as `tomllib.loads`: ValueError, RecursionError."""
    return deepcopy(_remembered(text)) if len(text) <= LARGEST_REMEMBERED else tomllib.loads(text)


@lru_cache(maxsize=32)  # a cell, its arms' files and some changes of them
def _remembered(text: str) -> dict[str, Any]:
    return tomllib.loads(text)
