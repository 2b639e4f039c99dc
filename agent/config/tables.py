"""The tables of a TOML text; the last few texts are remembered, for a cell's are read again and again."""

from __future__ import annotations

import tomllib
from functools import lru_cache
from typing import Any, Final

LARGEST_REMEMBERED: Final = 100_000  # characters


def tables(text: str) -> dict[str, Any]:
    """The document, whose receiver may change it.  Raises as `tomllib.loads`: ValueError, RecursionError."""
    return _copied(_remembered(text)) if len(text) <= LARGEST_REMEMBERED else tomllib.loads(text)


def says(text: str, document: dict[str, Any]) -> bool:
    """Whether this is the document of the text.  Raises as `tables`."""
    return (_remembered(text) if len(text) <= LARGEST_REMEMBERED else tomllib.loads(text)) == document


def _copied(node: Any) -> Any:
    """Tables and arrays anew; nothing else that TOML knows can be changed."""
    if isinstance(node, dict):
        return {key: _copied(each) for key, each in node.items()}
    return [_copied(each) for each in node] if isinstance(node, list) else node


@lru_cache(maxsize=32)  # a cell, its arms' files and some changes of them
def _remembered(text: str) -> dict[str, Any]:
    return tomllib.loads(text)
