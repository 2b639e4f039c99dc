"""Finished runs of a study on disk, one line each, so that a study that was stopped goes on where it was."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, Self

from pydantic import TypeAdapter

from agent.atomic import WriteError, make_folder
from agent.host.flock import holder, lock
from agent.log.disk import require_a_name
from agent.study.measure import RunResult
from agent.study.plan import Plan, Task, seed_of
from drivers.interface import Refusal

RUNS_FILE: Final = "runs.jsonl"
_LINE: Final = TypeAdapter(RunResult)

Key = tuple[int, int]  # cell's place in the study, run's in the cell


class StudyError(Refusal):
    """The study cannot be carried out as asked."""


def has_begun(folder: Path) -> bool:
    """Whether a study may have written results there: before them it writes what study its runs are of.

    A file of runs that is empty, or whose first line was cut off, says of nobody's results that they may go.
    """
    path = folder / RUNS_FILE
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.readline().endswith(b"\n")
    except OSError:
        return False  # where it cannot be read at all, `Store` says so


class Store:
    """The file of finished runs: a line that says what study they are of, then one line for each.

    A line that was cut off when the machine went down counts as none; the first one only where it is the begin of this
    study's.  One study at a time has the file.  Use as a context.
    """

    def __init__(self, folder: Path, plan: Plan, *, anew: bool = False) -> None:
        """Make the folder where it is not there; `anew` forgets the runs in it.

        Raises WriteError, and StudyError where it holds another study or one that goes on.
        """
        self.path = folder / RUNS_FILE
        self._made = [path for path in (self.path, folder, *folder.parents) if not path.exists()]
        make_folder(folder)
        self._plan, self._identity = plan, json.loads(json.dumps(plan.identity()))
        self.results: dict[Key, RunResult] = {}
        try:
            self._file: BinaryIO = self.path.open("a+b")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            self._lock()
            if anew:
                self._file.truncate(0)
            self._read()
        except OSError as error:
            self._close()
            raise self._unwritable(error) from error
        except StudyError:
            self._close()
            raise

    def _lock(self) -> None:
        if not lock(self._file.fileno()):
            raise StudyError(
                f"study in {self.path.parent}",
                found=f"another `coop study` that writes there, or a reader's lock{holder(self._file.fileno())}",
                expected="one at a time",
                remedy="wait for it, or name another --out",
            )

    def _unwritable(self, error: OSError) -> WriteError:
        if isinstance(error, FileNotFoundError):
            return WriteError(
                f"file {self.path}", found=error.strerror, expected="finished runs, and a place for more",
                remedy="start it again: it begins with the first run",
            )  # fmt: skip
        return WriteError(
            f"file {self.path}",
            found=error.strerror,
            expected="a file that can be written, and room for it",
            remedy="make room, or name another --out; finished runs are kept",
        )

    def _read(self) -> None:
        self._file.seek(0)
        whole = 0
        for number, line in enumerate(self._file):
            if not line.endswith(b"\n"):
                if number == 0 and not _line(self._identity).startswith(line):
                    raise self._foreign(number)
                break
            try:
                content = json.loads(line)
                if number == 0:
                    self._require_same(content)
                else:
                    self._take(number, content["cell_place"], _LINE.validate_json(line, strict=True))
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise self._foreign(number) from error
            whole += len(line)
        self._file.truncate(whole)
        if not whole:
            self._append(self._identity)

    def _take(self, number: int, place: int, result: RunResult) -> None:
        """Believe a line that is a run of this study.  Raises StudyError, and ValueError or TypeError for no run."""
        if not all(math.isfinite(value) for value in asdict(result).values() if isinstance(value, float)):
            raise ValueError("a figure that is no number")
        cells = dict(enumerate(cell.file.name for cell in self._plan.cells))
        if (cells.get(place), seed_of(self._plan.seed, result.index)) != (result.cell, result.seed):
            raise self._foreign(
                number, f"run {result.index} of {result.cell} with seed {result.seed}, of another study"
            )
        self.results[place, result.index] = result

    def _foreign(self, number: int, found: str = "no run of a study") -> StudyError:
        return StudyError(
            f"line {number + 1} of {self.path}",
            found=found,
            expected="what `coop study` wrote of this one",
            remedy="name another --out, or give --force",
        )

    def _require_same(self, found: Any) -> None:
        if found != self._identity:
            raise StudyError(
                f"study in {self.path.parent}",
                found=f"runs of {', '.join(_other(found, self._identity)) or 'another study'}",
                expected="none, or those of this study, which then goes on",
                remedy="name another --out, or give --force",
            )

    def add(self, task: Task, result: RunResult) -> None:
        """Keep one finished run.  Raises WriteError."""
        self.results[task.key] = result
        try:
            self._append({"cell_place": task.cell, **asdict(result)})
        except OSError as error:
            raise self._unwritable(error) from error

    def _append(self, content: Mapping[str, Any]) -> None:
        require_a_name(self._file.fileno(), self.path)
        self._file.write(_line(content))
        self._file.flush()
        os.fsync(self._file.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None and not self.results:
            self._remove()
        self._close()

    def _remove(self) -> None:
        """What was made for a study that failed before its first run, while nobody else can have it."""
        with contextlib.suppress(OSError):  # somebody has put something in a folder
            for path in self._made:
                path.unlink() if path == self.path else path.rmdir()

    def _close(self) -> None:
        with contextlib.suppress(OSError):  # of a line that the disk did not take: its writer was told
            self._file.close()


def _other(found: Any, own: Mapping[str, Any]) -> Iterator[str]:
    """What two studies differ in whose runs are not to be put together."""
    if not isinstance(found, dict):
        return
    if found.get("cells") != own["cells"]:
        yield "other cells, or another duration"
    if found.get("seed") != own["seed"]:
        yield f"seed {found.get('seed')}, not {own['seed']}"
    if found.get("faults") != own["faults"]:
        yield "other faults"
    theirs = found.get("versions")
    before: dict[str, Any] = theirs if isinstance(theirs, dict) else {}
    for name in sorted({*before, *own["versions"]}):
        if before.get(name) != own["versions"].get(name):
            yield f"{name} {before.get(name)}, not {own['versions'].get(name)}"


def _line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, allow_nan=False).encode() + b"\n"
