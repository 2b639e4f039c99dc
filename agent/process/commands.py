"""The processes of a cell as typed commands; each renders its own command line, and is read from it again.

A field has the name of the command's parameter in `agent.cli.arms` or `agent.cli.processes`; a test parses every one
with that parser.  What an agent and a guard are run with is their command, with what it leaves open said by cell and
host.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, get_args, get_type_hints

from agent.config.schema.driver import DriverKind
from agent.process.loss import AfterLoss


@dataclass(frozen=True, kw_only=True)
class ChildCommand:
    """What every process of a cell is given.  None, False and a default leave an option out."""

    verb: ClassVar[str]
    cell: Path
    with_parent: int | None = field(default_factory=os.getpid)  # process that starts it, with which it ends

    def argv(self) -> list[str]:
        """The words behind `coop`."""
        words = [self.verb, str(self.cell)]
        for one in fields(self):
            value = getattr(self, one.name)
            if one.name == "cell" or value is None or value is False:
                continue
            if value is True:
                words.append(_option(one.name))
            elif value != one.default:
                words += [_option(one.name), str(value)]
        return words


@dataclass(frozen=True, kw_only=True)
class RecordCommand(ChildCommand):
    """`coop record`: the log of a cell."""

    verb: ClassVar[str] = "record"
    out: Path | None = None
    out_dir: Path = Path("runs")
    listen: str
    network_config: Path | None = None
    driver: DriverKind | None
    truth: bool
    seed: int
    split_mb: int | None = None
    split_s: float | None = None
    keep_mb: int | None = None
    run_info: Path | None
    at_once: bool = False  # with its parent it ends by SIGKILL, which one that is stopped obeys, too


@dataclass(frozen=True, kw_only=True)
class PlantCommand(ChildCommand):
    """`coop plant`: the simulated cell behind simulated drivers."""

    verb: ClassVar[str] = "plant"
    socket: Path | None
    ring: Path | None
    real_time: bool
    lost_arm: AfterLoss = AfterLoss.END
    pauses: str | None = None  # s of the trajectory, with commas: in lockstep it waits there until SIGUSR1
    stops: bool = False  # who starts it has arms stopped that [[simulation.fault]] says hold
    common_start: Path | None = None  # file in which the run will say when the trajectory starts
    utc_offset_ns: int | None = None  # UTC minus CLOCK_MONOTONIC as the run has found it; None: as it is now


@dataclass(frozen=True, kw_only=True)
class EmulateCommand(ChildCommand):
    """`coop emulate`: the simulated cell behind emulated servos."""

    verb: ClassVar[str] = "emulate"
    ports: Path
    ring: Path | None
    faults: Path | None
    control: Path | None = None
    seed: int
    no_timing: bool = False
    whole: bool = False
    stops: bool = False  # this and the next as of PlantCommand
    common_start: Path | None = None
    utc_offset_ns: int | None = None


@dataclass(frozen=True, kw_only=True)
class ServoLine:
    """How the servos of an arm are reached."""

    port: str | None = None  # None: that of the cell file
    emulated: bool = False  # the servos on that port are emulated: nothing can fall


@dataclass(frozen=True, kw_only=True)
class Connection(ServoLine):
    """How an agent reaches its arm, and how its clock stands to UTC."""

    plant_socket: Path | None = None  # simulated driver, and the twin of an arm in the loop
    utc_offset_ns: int | None = None  # as of PlantCommand


@dataclass(frozen=True, kw_only=True)
class ArmCommand(ChildCommand, ServoLine):
    """What agent and guard of an arm are both given."""

    arm: str
    control: Path | None
    driver: DriverKind | None = None  # None: the cell's
    hold: bool | None = None  # at a stop and at the end; None: by what the arm is
    priority: int | None = None  # SCHED_FIFO; None: leave the scheduler alone

    @property
    def shared(self) -> bool:
        """Whether what moves the arm has its time of this host, once it is said what that is."""
        return self.driver is DriverKind.SIM or self.emulated


@dataclass(frozen=True, kw_only=True)
class AgentCommand(ArmCommand, Connection):
    """`coop agent`: one arm, on the plant or on a port of servos."""

    verb: ClassVar[str] = "agent"
    ring: Path | None
    real_time: bool = False
    whole: bool = False  # it begins at its rest, and is told word by word
    guard: Path | None = None  # socket of the arm's guard; None: nobody goes on when this process cannot
    gripper_empty: bool = False
    gripper_word: Path | None = None
    allow_no_realtime: bool = False  # a real arm may be started without real time
    wait: float = 0.0  # s, for guard and plant, where they start beside it
    stop_in: int | None = None  # cycle of the trajectory in which a simulated run has arranged that it is stopped


@dataclass(frozen=True, kw_only=True)
class AgentOptions(AgentCommand):
    """The command once cell and host have said what it leaves open; without a control socket nobody says a word."""

    driver: DriverKind = field()
    hold: bool = field()
    ring: Path

    @property
    def lockstep(self) -> bool:
        """Whether time waits for this arm."""
        return self.driver is DriverKind.SIM and not self.real_time


@dataclass(frozen=True, kw_only=True)
class GuardCommand(ArmCommand):
    """`coop guard`: goes on when the agent of a real arm cannot."""

    verb: ClassVar[str] = "guard"
    socket: Path | None
    post_mortem: Path  # folder


@dataclass(frozen=True, kw_only=True)
class GuardOptions(GuardCommand):
    """The command once cell and host have said what it leaves open."""

    driver: DriverKind = field()
    hold: bool = field()
    socket: Path


@dataclass(frozen=True, kw_only=True)
class TelemetryCommand(ChildCommand):
    """`coop telemetry`: one ring on its way to the recorder."""

    verb: ClassVar[str] = "telemetry"
    member: str
    ring: Path | None
    connect: str
    network_config: Path | None = None
    lockstep: bool
    follow: bool = False
    # of the cell, from a process that has read its files; this one need not then, and starts in a third of the time
    cell_name: str | None = None
    fingerprint: str | None = None
    at_once: bool = False  # as of RecordCommand


_KINDS: dict[str, type[ChildCommand]] = {
    kind.verb: kind
    for kind in (RecordCommand, PlantCommand, EmulateCommand, AgentCommand, GuardCommand, TelemetryCommand)
}


def read(words: Sequence[str]) -> ChildCommand:
    """The command whose `argv` these words are.  Raises LookupError, ValueError or TypeError for words of none."""
    verb, cell, *options = words
    kind = _KINDS[verb]
    types, given = get_type_hints(kind), {"cell": Path(cell)} | _unsaid(kind)
    rest = deque(options)
    while rest:
        name = rest.popleft().removeprefix("--").replace("-", "_")
        told = _without_none(types[name])
        given[name] = True if told is bool else told(rest.popleft())
    return kind(**given)


def _unsaid(kind: type[ChildCommand]) -> dict[str, Any]:
    """What a line means that leaves everything out."""
    types = get_type_hints(kind)
    found: dict[str, Any] = {}
    for one in fields(kind):
        if types[one.name] is bool:
            found[one.name] = False
        elif one.default is MISSING and type(None) in get_args(types[one.name]):
            found[one.name] = None
    return found


def _without_none(told: Any) -> Any:
    """Of what may be left out, what it is where it is said."""
    (found,) = [option for option in get_args(told) or (told,) if option is not type(None)]
    return found


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
