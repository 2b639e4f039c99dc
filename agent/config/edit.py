"""Changes single values in the text of a TOML file and keeps every other byte, comments and line ends too.

Comments between the lines of a value are part of it and go with it; the one behind a value stays behind the new one.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from agent.config.tables import says, tables
from drivers.interface import Refusal

_LINE = re.compile(r"[^\n]*\n|[^\n]+")
_HEADER = re.compile(r"\s*\[\[?\s*(?P<name>[A-Za-z0-9_.-]+)\s*\]?\]\s*(#.*)?$")


class EditError(Refusal):
    """The text is not written so that a single value can be changed in it."""


@dataclass(frozen=True, slots=True)
class Change:
    """A new value for one key of a table, or of the one table of an array whose `name` is given."""

    table: str  # "controller", or "arms" with a name; "" for what stands before the first header
    key: str
    toml: str  # the value as it stands in the file; a comment behind it comes before the one that is there
    name: str | None = None


def lines_of(text: str) -> list[str]:
    """The lines with their ends, of which TOML knows two, \\n and \\r\\n: `str.splitlines` cuts within comments too."""
    return _LINE.findall(text)


def newline_of(text: str) -> str:
    """The end of its first line, which added ones get too."""
    return "\r\n" if text.partition("\n")[0].endswith("\r") else "\n"


def apply(text: str, changes: Sequence[Change]) -> str:
    """The text with these values changed; a key that is not there yet becomes the last of its table.

    A table within another ("controller.observer") that is not there yet comes behind that one.  Raises EditError where
    a table is written in another way (inline, dotted keys) than under a header of its own.
    """
    newline, is_ended = newline_of(text), text.endswith("\n")
    lines = lines_of(text if is_ended else text + newline)
    for change in changes:
        _make_room(lines, change, newline)
        begin, end = _section(lines, change)
        at = _key(lines, change.key, begin, end)
        before, behind = _around("".join(lines[slice(*at)]), change.key, newline)
        lines[slice(*at)] = [f"{before}{change.toml}{behind}"]
    edited = "".join(lines) if is_ended else "".join(lines).removesuffix(newline)
    wanted = tables(text)
    for change in changes:
        _table(wanted, change)[change.key] = tomllib.loads(f"value = {change.toml}")["value"]
    try:
        same = says(edited, wanted)
    except tomllib.TOMLDecodeError:  # the table is there, inline or by dotted keys
        same = False
    if not same:
        raise _refusal(changes[0], "an unusual way of writing it")
    return edited


def _make_room(lines: list[str], change: Change, newline: str) -> None:
    """A header behind the table that this one is in, where it has none yet."""
    parent, dot, _ = change.table.rpartition(".")
    headers = [match["name"] for line in lines if (match := _HEADER.match(line))]
    if dot and change.table not in headers and parent in headers:
        at = _last(lines, *_section(lines, Change(parent, "", "")))
        lines[at:at] = [newline, f"[{change.table}]{newline}"]


def _section(lines: Sequence[str], change: Change) -> tuple[int, int]:
    """Lines of the table: those after its header, up to the next header."""
    headers = [i for i, line in enumerate(lines) if _HEADER.match(line)]
    if not change.table:
        return 0, headers[0] if headers else len(lines)
    for i, header in enumerate(headers):
        match = _HEADER.match(lines[header])
        if match is None or match["name"] != change.table:
            continue
        begin, end = header + 1, headers[i + 1] if i + 1 < len(headers) else len(lines)
        if change.name is None or any(_is_name(line, change.name) for line in lines[begin:end]):
            return begin, end
    raise _refusal(change, "no such header")


def _is_name(line: str, name: str) -> bool:
    return re.match(rf"\s*name\s*=\s*[\"']{re.escape(name)}[\"']", line) is not None


def _key(lines: Sequence[str], key: str, begin: int, end: int) -> tuple[int, int]:
    """Lines of a key with its value, or the empty place for a new one."""
    for i in range(begin, end):
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[i]):
            for stop in range(i + 1, end + 1):
                if _complete("".join(lines[i:stop])):
                    return i, stop
    last = _last(lines, begin, end)
    return last, last


def _around(text: str, key: str, newline: str) -> tuple[str, str]:
    """What stands before and behind the value in these lines of one key; where there are none, what a new one gets."""
    begins = re.match(rf"\s*{re.escape(key)}\s*=[ \t]*", text)
    if begins is None:
        return f"{key} = ", newline
    line = text[text.rstrip("\r\n").rfind("\n") + 1 :]  # the value ends in the last one
    signs = (match.start() for match in re.finditer("#", line))
    comment = next((i for i in signs if _complete(text[: len(text) - len(line) + i])), len(line))  # outside of a string
    return begins[0], line[len(line[:comment].rstrip()) :]


def _last(lines: Sequence[str], begin: int, end: int) -> int:
    """Line behind the last one that is neither empty nor a comment."""
    meant = (i + 1 for i in reversed(range(begin, end)) if lines[i].strip() and not lines[i].lstrip().startswith("#"))
    return next(meant, begin)


def _complete(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _table(document: dict[str, Any], change: Change) -> dict[str, Any]:
    found: Any = document
    for part in change.table.split(".") if change.table else ():
        found = found.setdefault(part, {})
    if change.name is not None:
        found = next((entry for entry in found if entry.get("name") == change.name), {})
    if not isinstance(found, dict):
        raise _refusal(change, "no table")
    return found


def _refusal(change: Change, found: str) -> EditError:
    where = f"[{change.table}]" if change.name is None else f"[[{change.table}]] with name = {change.name!r}"
    return EditError(
        f"{change.key} under {where}" if change.table else f"{change.key} before the first header",
        found=found,
        expected="the table under a header of its own" if change.table else f"{change.key} = and its value",
        remedy="write it like the files that ship, or change the value by hand",
    )
