"""A table drawn as rich draws it where nothing needs folding or colours, in a twentieth of the time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

_NARROW: Final = (("\x00", "\u0300"), ("\u0370", "\u0483"), ("\u2010", "\u2500"))  # one column each, if printable


def boxed(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str | None:
    """The table, as wide as its cells; None where a character may take other than one column."""
    columns = [*zip(header, *rows, strict=True)]
    if not all(_narrow(text) for column in (*columns, [title]) for text in column):
        return None
    widths = [max(map(len, column)) for column in columns]
    head, *body = ([text.ljust(n) for text, n in zip(row, widths, strict=True)] for row in (header, *rows))
    bars = [n + 2 for n in widths]
    above = [title, _ruled("┏━┳┓", bars), _joined("┃", head), _ruled("┡━╇┩", bars)]
    return "\n".join([*above, *(_joined("│", row) for row in body), _ruled("└─┴┘", bars)])


def _narrow(text: str) -> bool:
    """Whether each character takes one column."""
    return text.isprintable() and (text.isascii() or all(map(_in_range, text)))


def _in_range(character: str) -> bool:
    return any(low <= character < high for low, high in _NARROW)


def _ruled(characters: str, bars: Iterable[int]) -> str:
    left, line, between, right = tuple(characters)
    return left + between.join(line * n for n in bars) + right


def _joined(bar: str, cells: Iterable[str]) -> str:
    return f"{bar} " + f" {bar} ".join(cells) + f" {bar}"
