"""`load`: a run in one call, for analysis in Python; arrays and data frames by arm, by name, by time.

The file is read once; its rows lie by column in a temporary file without a name, and what is asked for is in memory.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Column, Table
from agent.log.flat import FlatColumn, Members, flat_columns, flatten
from agent.log.read import ColumnLog, LogError, open_log
from agent.log.runinfo import RunInfo, read_info
from agent.log.servos import ServoTable
from agent.log.when import on_time_of
from agent.telemetry.row.event import Event
from agent.telemetry.row.sample import AGENT_STATE, MAX_JOINTS, Field, Layout
from agent.telemetry.row.topics import PLANT
from drivers.interface import Refusal

if TYPE_CHECKING:
    import pandas as pd

_TIMES: Final = frozenset({"t", "stamp_ns", "utc_ns"})  # rows of another release may lack one


class MissingPackage(Refusal):
    """An optional package is needed for this."""


class NoSuchField(LogError, KeyError):
    """The log has no member or field of that name."""

    __str__ = Exception.__str__  # KeyError would quote the whole line


class Rows:
    """Rows of an arm or of the plant; `rows[name]` is an array, one row per tick."""

    def __init__(self, name: str, table: Table, layout: Layout, names: Members, run: Run) -> None:
        self.name = name
        self._run = run  # which keeps the temporary file for as long as somebody has rows of it
        self._table, self._layout, self._names = table, layout, names
        self._joints = dict(zip(names.arms, names.joints, strict=True)).get(name)

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        span = f", {self.t[0]:.3f} s to {self.t[-1]:.3f} s" if len(self) else ""
        return f"<{self.name}: {len(self)} rows{span}, {len(self.fields)} fields>"

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of what a row holds."""
        return tuple(f.name for f in self._layout.fields)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the arm's joints, in the order of its joint arrays; none of the plant."""
        return self._joints or ()

    @property
    def t(self) -> NDArray[np.float64]:
        """Time since the trajectory's zero, (k,) s; negative before it, of arms that nobody has started a day ahead."""
        return self["t"]

    def __getitem__(self, field: str) -> Column:
        """Array (k,) or (k, length) of a field; of an arm's joint arrays only its own joints.  Raises NoSuchField."""
        found = self._field(field)
        if self._joints is not None and found.length == MAX_JOINTS:
            return self._table.column(field, slice(0, len(self._joints)))
        return self._table[field]

    def about(self, field: str) -> str:
        """What a field means, and its unit.  Raises NoSuchField."""
        found = self._field(field)
        return f"{found.doc} [{found.unit}]" if found.unit else found.doc

    def between(self, from_s: float, to_s: float) -> Rows:
        """The rows from from_s on and before to_s, by the time of the trajectory."""
        return self.where((self.t >= from_s) & (self.t < to_s))

    def where(self, chosen: NDArray[np.bool_]) -> Rows:
        """The rows (k,) that are chosen."""
        return Rows(self.name, self._table[chosen], self._layout, self._names, self._run)

    def columns(self, *fields: str) -> dict[str, Column]:
        """Plain columns (k,) whose names have component and unit, of these fields or of all.  Raises NoSuchField."""
        return flatten(self._table, self._flat(fields))

    def frame(self, *fields: str) -> pd.DataFrame:
        """The same as a data frame with the time (s) as its index.  Raises MissingPackage, NoSuchField."""
        try:
            import pandas as pd  # noqa: PLC0415 (optional)
        except ImportError as error:
            raise MissingPackage(
                "data frames", found="no pandas", expected="it beside widowx-coop",
                remedy="pip install 'widowx-coop[analysis]'; arrays need nothing",
            ) from error  # fmt: skip
        return pd.DataFrame(self.columns(*fields), index=pd.Index(self.t, name="t_s"))

    def _flat(self, fields: tuple[str, ...]) -> list[FlatColumn]:
        chosen = [self._field(name) for name in fields] or self._layout.fields
        return flat_columns(chosen, self.name, self._names)

    def _field(self, name: str) -> Field:
        for f in self._layout.fields:
            if f.name == name:
                return f
        raise NoSuchField(
            f"rows of {self.name}", found=repr(name), expected=f"one of {', '.join(self.fields)}",
            remedy="see agent/telemetry/row/sample.py",
        )  # fmt: skip


class Run:
    """A log; `run["left"]` are the rows of an arm, `run["plant"]` the truth of a simulation."""

    def __init__(self, log: ColumnLog, resources: ExitStack) -> None:
        self._log = log = on_one_time(log)
        self._close = weakref.finalize(self, resources.close)
        self.info: RunInfo = read_info(log)
        self._names = member_names(log, self.info)

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._log.agents)

    @property
    def plant(self) -> Rows | None:
        """The truth of a simulation; None on real arms."""
        return None if self._log.plant is None else self[PLANT]

    @property
    def events(self) -> list[Event]:
        """What happened, by time."""
        return self._log.events

    @property
    def servos(self) -> Mapping[str, ServoTable]:
        """By arm: temperature, voltage, current or load and error bits of each servo, about once a second.

        Simulated arms have joints without servos and no entry here; neither have logs of releases before this.
        """
        return self._log.servos

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Files inside the log: the cell file, arm files, URDFs."""
        return self._log.attachments

    @property
    def complete(self) -> bool:
        """Whether nothing is missing and nothing is damaged."""
        return self._log.complete

    @property
    def lacks(self) -> tuple[str, ...]:
        """What of the run is not in the log: rows, an arm, its end."""
        return self._log.lacks

    @property
    def gaps(self) -> Mapping[str, tuple[tuple[int, int], ...]]:
        """By arm, first and last row number of every stretch that is missing; of the plant, of those it writes."""
        return self._log.gaps

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with the file."""
        return self._log.problems

    def __getitem__(self, member: str) -> Rows:
        """Rows of an arm, or of the plant.  Raises NoSuchField."""
        tables = members_of(self._log)
        if member not in tables:
            raise NoSuchField(
                f"log {self._log.path}", found=repr(member), expected=f"one of {', '.join(tables)}",
                remedy="name one of them",
            )  # fmt: skip
        return Rows(member, tables[member], self._log.layouts[member], self._names, self)

    def close(self) -> None:
        """Give the temporary file up; arrays stay valid.  Safe twice, and not needed at the end of a program."""
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def load(path: str | Path, *, folder: str | Path | None = None) -> Run:
    """Open the log of a run, finished or not, of this or another release.

    folder: where the temporary file lies, about as large as the log.  Raises LogError for what is no log of ours.
    """
    with ExitStack() as stack:
        log = stack.enter_context(open_log(Path(path), None if folder is None else Path(folder), any_layout=True))
        return Run(log, stack.pop_all())


def on_one_time(log: ColumnLog) -> ColumnLog:
    """The log with one zero for the times `t` of all rows, the trajectory's; the plant's own is where it began."""
    if log.plant is None or not all({f.name for f in layout.fields} >= _TIMES for layout in log.layouts.values()):
        return log
    time = next(f for f in AGENT_STATE.fields if f.name == "t")
    own = log.layouts[PLANT]
    layout = replace(own, fields=tuple(time if f.name == "t" else f for f in own.fields))
    return replace(log, plant=on_time_of(log.plant, log.agents.values()), layouts={**log.layouts, PLANT: layout})


def members_of(log: ColumnLog) -> dict[str, Table]:
    """Rows by arm, and the plant's where there is one."""
    return {**log.agents, **({} if log.plant is None else {PLANT: log.plant})}


def member_names(log: ColumnLog, info: RunInfo) -> Members:
    """Arms in the plant's order, as many as it moves, with the names of their joints."""
    described = {arm.name: arm.joints for arm in info.arms}
    count = int(log.plant["arm_count"][0]) if log.plant is not None and len(log.plant) else len(described)
    arms = [*described, *(f"arm{i}" for i in range(len(described), count))]
    return Members(tuple(arms), tuple(described.get(arm, ()) for arm in arms))
