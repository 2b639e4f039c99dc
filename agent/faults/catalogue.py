"""The list of faults: what fails, what must happen within which bound, which runs show it and which tests hold it.

`catalogue.toml` is the list; `nodes.toml`, written by `python -m tests.faults.nodes`, names the tests that are marked
with a row's id.
"""

from __future__ import annotations

import enum
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, model_validator

from agent.config.reading import ConfigError, validate
from agent.config.schema.types import AS_LIST, Strict, wrong
from agent.faults.plan import Injection

CATALOGUE: Final = Path(__file__).with_name("catalogue.toml")
NODES: Final = Path(__file__).with_name("nodes.toml")

Bound = Annotated[float, Field(ge=0.0, le=1e4)]


class Group(enum.StrEnum):
    """By what fails."""

    PROCESS = "process"
    BUS = "bus"
    SERVO = "servo"
    CLOCK = "clock"
    NETWORK = "network"
    DISK = "disk"
    CONFIGURATION = "configuration"
    NUMERIC = "numeric"
    PHYSICAL = "physical"
    REHEARSAL = "rehearsal"
    TOGETHER = "together"


class Within(Strict):
    """Bounds of a run, from the fault on; what is not given is not asked for."""

    noticed_s: Bound | None = None
    reacted_s: Bound | None = None  # until `who` have left the motion
    or_grown_N: Bound | None = None  # later is as good where grown_N is no more than this
    who: Annotated[tuple[str, ...], AS_LIST] = ()  # arms that must; none named: all whose process lives
    goes_on: bool = False  # nobody may leave the motion
    internal_N: Bound | None = None
    grown_N: Bound | None = None  # `Measured.grown_N`
    sag_m: Bound | None = None
    moved_rad: Bound | None = None  # an arm with the fault, until its servos' watchdog
    speed_rad_per_s: Bound | None = None
    apart_rad: Bound | None = None  # a joint of an arm in the loop, and its twin's
    others_rad_per_s: Bound | None = None  # of the arms without a fault
    fall_m_per_s: Bound | None = None
    strayed_m: Bound | None = None  # the object, from its way
    misled_rad: Bound | None = None  # what an arm with the fault computes with, from where its joint is

    def described(self) -> str:
        """In words, with units."""
        who = " and ".join(self.who) or "all"
        texts = {
            "noticed_s": "noticed ≤ {:g} s",
            "reacted_s": f"{who} stopped ≤ {{:g}} s",
            "or_grown_N": "or the internal force grows by ≤ {:g} N",
            "internal_N": "internal force ≤ {:g} N",
            "grown_N": "internal force rises by ≤ {:g} N",
            "sag_m": "sag ≤ {:g} m",
            "moved_rad": "joints ≤ {:g} rad until the watchdog",
            "speed_rad_per_s": "joints ≤ {:g} rad/s",
            "apart_rad": "arm and twin ≤ {:g} rad apart",
            "others_rad_per_s": "the others' joints ≤ {:g} rad/s",
            "fall_m_per_s": "the object falls at ≤ {:g} m/s",
            "strayed_m": "the object moves by ≤ {:g} m",
            "misled_rad": "no command from a value that is off by > {:g} rad",
        }
        found = [text.format(value) for key, text in texts.items() if (value := getattr(self, key)) is not None]
        return ", ".join((["motion goes on"] if self.goes_on else []) + found)


class Shown(Strict):
    """A run that shows a row: a cell, and what fails in it."""

    cell: str
    faults: Annotated[tuple[Injection, ...], AS_LIST] = ()  # none: what `set` makes of the cell is the fault
    duration_s: Annotated[float, Field(gt=0.0, le=1000.0)] = 5.0
    set: Annotated[tuple[str, ...], AS_LIST] = ()  # "key.path=value", as of --set
    within: Within


class Row(Strict):
    """One row of the list."""

    id: Annotated[str, Field(pattern=r"^[A-Z]\d{1,2}$")]
    group: Annotated[Group, AS_LIST]
    fails: str
    must: str
    never: str = ""  # what must not happen, or must not be lost
    bound: str = ""  # of tests, where no run says it
    runs: Annotated[tuple[Shown, ...], AS_LIST] = ()
    faults: Annotated[tuple[Injection, ...], AS_LIST] = ()  # of processes alone: what `coop faults inject CELL ID` does
    untested: str = ""  # why nothing here shows it

    @model_validator(mode="after")
    def _bounded(self) -> Row:
        if not (self.runs or self.bound or self.untested):
            raise wrong("bound", found="none", expected="a bound, runs or why neither", remedy="say what must hold")
        return self

    @property
    def tests(self) -> tuple[str, ...]:
        """Tests that are marked with this id; of a row that stands in the list itself."""
        return nodes().get(self.id, ())

    @property
    def bounds(self) -> str:
        """All bounds in words."""
        return "; ".join(
            dict.fromkeys([*([self.bound] if self.bound else []), *(r.within.described() for r in self.runs)])
        )

    @property
    def is_tested(self) -> bool:
        """Whether a run or a test shows it."""
        return bool(self.runs or self.tests)


class _File(Strict):
    row: list[Row]

    @model_validator(mode="after")
    def _unique(self) -> _File:
        ids = [row.id for row in self.row]
        for one in ids:
            if ids.count(one) > 1:
                raise wrong("row", found=f"{one} twice", expected="each id once", remedy="number them anew")
        return self


@cache
def rows() -> tuple[Row, ...]:
    """The list.  Raises ConfigError, which a test keeps from happening."""
    return tuple(validate(_File, tomllib.loads(CATALOGUE.read_text("utf-8")), str(CATALOGUE)).row)


@cache
def nodes() -> Mapping[str, tuple[str, ...]]:
    """Marked tests by row."""
    return {key: tuple(found) for key, found in tomllib.loads(NODES.read_text("utf-8")).items()}


def row(name: str) -> Row | None:
    """The row of that id, in any case of letters; None where there is none."""
    return next((one for one in rows() if one.id == name.upper()), None)


__all__ = ["ConfigError", "Group", "Row", "Shown", "Within", "nodes", "row", "rows"]
