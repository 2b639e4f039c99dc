"""A log as tables for other programs: CSV, or Parquet with pyarrow; every file is whole when it has its name.

One file per arm, one of the plant, the events, and `columns.csv`, which says what each column means.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import tempfile
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.atomic import WriteError, make_folder, place_of
from agent.log.columns import BLOCK_ROWS, Column, Table
from agent.log.flat import FlatColumn, flat_columns, flatten
from agent.log.read import ColumnLog, LogError
from agent.log.run import MissingPackage, NoSuchField, member_names, members_of, on_one_time
from agent.log.runinfo import read_info
from agent.log.when import trajectory_time
from agent.telemetry.row.sample import Field

COLUMNS_FILE: Final = "columns.csv"
EVENTS_FILE: Final = "events.csv"
INTERNAL: Final = ("memory",)  # left out unless it is asked for: what an agent carries, a hundred numbers without names
_LIST_COLUMNS: Final = ("table", "column", "unit", "field", "meaning")
_MEMBER: Final = re.compile(r"[a-z][a-z0-9_]*")
_EVENT_COLUMNS: Final = ("utc_ns", "t_s", "source", "level", "text", "data")


class Format(StrEnum):
    """Kinds of files."""

    CSV = "csv"
    PARQUET = "parquet"


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: rows by file."""

    folder: Path
    rows: dict[str, int]


@dataclass(frozen=True, slots=True)
class Choice:
    """What of a log is wanted; everything by itself."""

    members: tuple[str, ...] = ()  # arms, or the plant
    fields: tuple[str, ...] = ()  # of the rows; all but the internal ones without it
    from_s: float = -math.inf  # time of the trajectory
    to_s: float = math.inf

    def of(self, table: Table) -> Table:
        """The rows of that time."""
        if math.isinf(self.from_s) and math.isinf(self.to_s):
            return table
        t = table["t"]
        return table[(t >= self.from_s) & (t < self.to_s)]


def export(log: ColumnLog, folder: Path, kind: Format, choice: Choice, *, replace: bool) -> Exported:
    """Write the log's tables into a folder.

    replace: files of these names that are there; tables of an earlier export go with it.
    Raises LogError, WriteError, and MissingPackage for Parquet without pyarrow.
    """
    if kind is Format.PARQUET:
        _require_pyarrow()
    log = on_one_time(log)
    tables, names = _chosen(log, choice), member_names(log, read_info(log))
    columns = {name: flat_columns(_fields(log, name, choice), name, names) for name in tables}
    if not replace:
        _keep(folder)
    with _Draft(folder) as draft:
        rows = {}
        for name, table in tables.items():
            file = _file_of(name, kind)
            _WRITERS[kind](draft.path / file, table, columns[name])
            rows[file] = len(table)
        events = _events(log, choice)
        _write_csv(draft.path / EVENTS_FILE, _EVENT_COLUMNS, events)
        rows[EVENTS_FILE] = len(events)
        lines = [(name, c.name, c.unit, c.field, c.doc) for name, own in columns.items() for c in own]
        _write_csv(draft.path / COLUMNS_FILE, _LIST_COLUMNS, lines)
        draft.keep(_listed(folder))
    return Exported(folder, rows)


def _file_of(member: str, kind: Format) -> str:
    """The name of its table; an arm's that is called as a file beside it has a hyphen, which no name of an arm has."""
    name = f"{member}.{kind.value}"
    return f"{member}-arm.{kind.value}" if name in (EVENTS_FILE, COLUMNS_FILE) else name


def _chosen(log: ColumnLog, choice: Choice) -> dict[str, Table]:
    tables, members = members_of(log), choice.members
    for name in members:
        if name not in tables:
            raise NoSuchField(
                f"log {log.path}", found=repr(name), expected=f"one of {', '.join(tables)}", remedy="name one of them"
            )
    found = {name: table for name, table in tables.items() if not members or name in members}
    _refuse_unknown(log, found, choice)
    found = {name: choice.of(table) for name, table in found.items() if _fields(log, name, choice)}
    if not any(len(table) for table in found.values()):
        raise LogError(
            f"nothing to export of {log.path}",
            found="no row",
            expected="rows",
            remedy="name another time or another arm",
        )
    return found


def _fields(log: ColumnLog, member: str, choice: Choice) -> list[Field]:
    """The wanted fields that the rows of this member have, and the time of the rows before them."""
    own = log.layouts[member].fields
    if not choice.fields:
        return [f for f in own if f.name not in INTERNAL]
    known = {f.name: f for f in own}
    wanted = [known[name] for name in dict.fromkeys(choice.fields) if name in known]
    return wanted if not wanted or "t" in choice.fields else [known["t"], *wanted]


def _refuse_unknown(log: ColumnLog, members: Iterable[str], choice: Choice) -> None:
    """Raise NoSuchField for a field that none of these members has."""
    known = list(dict.fromkeys(f.name for member in members for f in log.layouts[member].fields))
    for name in choice.fields:
        if name not in known:
            raise NoSuchField(
                f"rows of {log.path}", found=repr(name), expected=f"one of {', '.join(known)}",
                remedy="name another field",
            )  # fmt: skip


def _require_pyarrow() -> None:
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415 (optional)
    except ImportError as error:
        raise MissingPackage(
            "Parquet", found="no pyarrow", expected="it beside widowx-coop",
            remedy="pip install 'widowx-coop[analysis]', or export CSV",
        ) from error  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------- files


class _Draft:
    """A folder beside the place of the result, which becomes the result when everything in it is on the disk."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        make_folder(folder.parent)

    def __enter__(self) -> _Draft:
        try:
            self._temporary = tempfile.TemporaryDirectory(prefix=".export-", dir=self._folder.parent)
        except OSError as error:
            raise _refusal(self._folder, error) from error
        self.path = Path(self._temporary.name)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._temporary.cleanup()
        if isinstance(error, OSError):
            raise _refusal(self._folder, error) from error

    def keep(self, before: Collection[str]) -> None:
        """Move every file to its place, whole, and remove those of before that are not written anew.

        The list of tables comes last: where this is cut off, the earlier one still names what is to go.
        """
        files = sorted(self.path.iterdir(), key=lambda file: file.name == COLUMNS_FILE)
        for file in files:
            with file.open("rb") as written:
                os.fsync(written.fileno())
        make_folder(self._folder)
        for file in files:
            place_of(self._folder / file.name)
        for name in set(before) - {file.name for file in files}:
            (self._folder / name).unlink(missing_ok=True)
        for file in files:
            file.replace(self._folder / file.name)


def _listed(folder: Path) -> set[str]:
    """The names that tables of an earlier export into this folder may have, by its list of columns."""
    try:
        with (folder / COLUMNS_FILE).open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
    except (OSError, ValueError, csv.Error):
        return set()
    if tuple(head) != _LIST_COLUMNS:
        return set()
    return {_file_of(row[0], kind) for row in rows for kind in Format if row and _MEMBER.fullmatch(row[0])}


def _keep(folder: Path) -> None:
    """Raise WriteError when there is something in the folder, or something else of its name."""
    if os.path.lexists(folder) and not (folder.is_dir() and not any(folder.iterdir())):
        raise WriteError(
            f"folder {folder}", found="something there", expected="no folder of that name, or an empty one",
            remedy="name another with --out, or give --force",
        )  # fmt: skip


def _refusal(folder: Path, error: OSError) -> WriteError:
    return WriteError(
        f"tables not written to {folder}", found=error.strerror or str(error),
        expected="a folder that can be written, with room for the tables", remedy="name another, or make room",
    )  # fmt: skip


def _write_table_csv(path: Path, table: Table, columns: Sequence[FlatColumn]) -> None:
    blocks = (flatten(part, columns) for part in table.blocks(BLOCK_ROWS))
    rows = (row for block in blocks for row in zip(*map(_plain, block.values()), strict=True))
    _write_csv(path, [c.name for c in columns], rows)


def _plain(column: Column) -> list[Any]:
    """Numbers that read back as the same; what is not a number is empty."""
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f":
        for i in np.flatnonzero(np.isnan(column)).tolist():
            values[i] = None
    return values


def _write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)


def _events(log: ColumnLog, choice: Choice) -> list[tuple[Any, ...]]:
    """The events of the chosen members and time; one whose time of the trajectory nobody knows is of any."""
    found = []
    for event in log.events:
        t = trajectory_time(event, log.agents.get(event.source))
        if (not choice.members or event.source in choice.members) and not (t < choice.from_s or t >= choice.to_s):
            data = json.dumps(event.data, ensure_ascii=False)
            when = None if math.isnan(t) else round(t, 9)
            found.append((event.utc_ns, when, event.source, event.level.name, event.text, data))
    return found


def _write_table_parquet(path: Path, table: Table, columns: Sequence[FlatColumn]) -> None:
    import pyarrow as pa  # noqa: PLC0415 (optional)
    from pyarrow import parquet  # noqa: PLC0415

    empty: dict[str, NDArray[Any]] = flatten(table[:0], columns)
    told = {c.name: {b"unit": c.unit.encode(), b"meaning": c.doc.encode()} for c in columns}
    fields = [pa.field(name, pa.from_numpy_dtype(x.dtype), metadata=told[name]) for name, x in empty.items()]
    schema = pa.schema(fields)
    split = [name for name, x in empty.items() if x.dtype.kind == "f"]
    options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": split}
    with parquet.ParquetWriter(path, schema, **options) as writer:
        for part in table.blocks(16 * BLOCK_ROWS):
            arrays = [pa.array(np.ascontiguousarray(x)) for x in flatten(part, columns).values()]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))


_WRITERS: Final[dict[Format, Callable[[Path, Table, Sequence[FlatColumn]], None]]] = {
    Format.CSV: _write_table_csv,
    Format.PARQUET: _write_table_parquet,
}
