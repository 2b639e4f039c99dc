"""What a run was set to, key by key, so that two runs can be told apart: the cell file, and how it was run."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from rich import box
from rich.markup import escape
from rich.table import Table as RichTable

from agent.host.info import CELL_FILE, RUN_FILE
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.log.read import AnyLog

ABSENT: Final = "–"
_OF_RUN: Final = ("driver", "seed", "versions", "host")  # of run.json; the rest of it follows from the cell file
_OWN_WORDS: Final = (RUN_FILE, CELL_FILE)


@dataclass(frozen=True, slots=True)
class Setting:
    """One key and what each run had there; ABSENT where a run does not set it."""

    key: str
    values: tuple[str, ...]


def settings_of(log: AnyLog) -> dict[str, str]:
    """Every key of a log's cell file, arms by their names, and how it was run; what cannot be read is left out."""
    found: dict[str, str] = {}
    try:
        found |= _flat(tomllib.loads(log.attachments[CELL_FILE].decode()))
    except (KeyError, ValueError):
        found["cell file"] = "not in the log, or not readable"
    try:
        run = log.run_info()
        found |= _flat({key: run[key] for key in _OF_RUN if key in run}, "run.")
    except Refusal:
        found[RUN_FILE] = "not in the log, or not readable"
    for name, content in log.attachments.items():
        if name not in _OWN_WORDS:
            found[f"file {name}"] = f"sha256 {hashlib.sha256(content).hexdigest()[:12]}"
    return found


def different(settings: Sequence[Mapping[str, str]]) -> list[Setting]:
    """The keys at which not all runs have the same, in the order of the first run that has them."""
    keys = dict.fromkeys(key for one in settings for key in one)
    rows = [Setting(key, tuple(one.get(key, ABSENT) for one in settings)) for key in keys]
    return [row for row in rows if len(set(row.values)) > 1]


def settings_table(settings: Sequence[Mapping[str, str]]) -> RichTable:
    """The same for the terminal."""
    table = RichTable(title="different settings", title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("setting", *(chr(ord("A") + number) for number in range(len(settings)))):
        table.add_column(heading, overflow="fold")
    for row in different(settings) or [Setting("none", ())]:
        table.add_row(*map(escape, (row.key, *row.values)))
    return table


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    return dict(_walk(tree, prefix))


def _walk(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _walk(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) and "name" in v for v in value):
            for one in value:
                rest = {k: v for k, v in one.items() if k != "name"}
                yield from _walk(rest, f"{prefix}{key}.{one['name']}.")
        else:
            yield f"{prefix}{key}", f"{value:.9g}" if isinstance(value, float) else str(value)
