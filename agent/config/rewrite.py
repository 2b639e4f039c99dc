"""Puts values that a command line gives (`--set`) into a cell's text, whose other bytes stay as `edit` keeps them.

A value within an inline table is changed with the whole of that table, which is written anew in its place; a
file in which a value cannot be changed in its place is written anew as a whole.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

import tomli_w

from agent.config.edit import Change, EditError, apply, newline_of
from agent.config.reading import override
from agent.config.tables import says, tables


def rewritten(text: str, overrides: Sequence[str]) -> str:
    """The text of a TOML file with these values, each "key.path=value".  Raises ConfigError, as `override` does.

    Where one stands in a way in which it cannot be changed in its place (dotted keys, a table of an inline array) the
    whole file is written anew, without comments, but with the line ends that it has.
    """
    for given in overrides:
        document = tables(text)
        path = override(document, given)
        edited = next(_edited(text, document, path), None)
        text = tomli_w.dumps(document).replace("\n", newline_of(text)) if edited is None else edited
    return text


def _edited(text: str, wanted: dict[str, Any], path: Sequence[str]) -> Iterator[str]:
    """The text that says what is wanted, the smallest change first."""
    newline = newline_of(text)
    for change in _changes(tables(text), wanted, path):
        header = f"{newline}[{change.table}]{newline}"
        for room in ("", header if text.endswith("\n") else newline + header):  # for a table that is not there yet
            if room and (change.name is not None or not change.table):
                continue
            try:
                edited = apply(text + room, [change])
            except (EditError, tomllib.TOMLDecodeError):
                continue
            if says(edited, wanted):
                yield edited


def _changes(had: dict[str, Any], wanted: dict[str, Any], path: Sequence[str]) -> Iterator[Change]:
    """The value by itself in its table, then the tables around it, inline: the deepest first.

    had: what the text says now; an entry of an array goes by the name that it has there.
    """
    before: Any = had
    node: Any = wanted
    found: list[Change] = []
    table, name = "", None
    for part in path:
        if isinstance(node, list):
            at = next(i for i, x in enumerate(before) if isinstance(x, dict) and x.get("name") == part)
            before, node, name = before[at], node[at], part
            continue
        before, node = before.get(part, {}) if isinstance(before, dict) else {}, node[part]
        if not isinstance(node, list) or part == path[-1]:
            found.append(Change(table, part, _inline(node), name))
        if name is not None and isinstance(node, dict):
            break  # what is within an entry of an array stands there inline
        table = f"{table}.{part}" if table else part
    yield from reversed(found)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_plain({key: 0})[:-4]} = {_inline(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(each) for each in value) + "]"
    return _plain({"value": value}).removeprefix("value = ")


def _plain(document: dict[str, Any]) -> str:
    return tomli_w.dumps(document).strip()
