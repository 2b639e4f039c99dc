"""The processes that `coop run` starts, as typed commands; each renders its own command line.

A field has the name of the command's parameter in `agent.cli.arms` or `agent.cli.processes`; a test parses every one
with that parser.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

from agent.config.schema.cell import DriverKind


@dataclass(frozen=True, kw_only=True)
class ChildCommand:
    """What every process of a run is given.  None and False leave an option out."""

    verb: ClassVar[str]
    cell: Path
    with_parent: bool = True  # it ends when `coop run` does

    def argv(self) -> list[str]:
        """The words behind `coop`."""
        words = [self.verb, str(self.cell)]
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "cell" or value is None or value is False:
                continue
            words.append("--" + field.name.replace("_", "-"))
            if value is not True:
                words.append(str(value))
        return words


@dataclass(frozen=True, kw_only=True)
class RecordCommand(ChildCommand):
    """`coop record`: the log of the run."""

    verb: ClassVar[str] = "record"
    out: Path
    listen: str
    driver: DriverKind
    truth: bool
    seed: int
    run_info: Path


@dataclass(frozen=True, kw_only=True)
class PlantCommand(ChildCommand):
    """`coop plant`: the simulated cell behind simulated drivers."""

    verb: ClassVar[str] = "plant"
    socket: Path
    ring: Path
    real_time: bool


@dataclass(frozen=True, kw_only=True)
class EmulateCommand(ChildCommand):
    """`coop emulate`: the simulated cell behind emulated servos."""

    verb: ClassVar[str] = "emulate"
    ports: Path
    ring: Path | None
    faults: Path | None
    seed: int
    whole: bool = False


@dataclass(frozen=True, kw_only=True)
class AgentCommand(ChildCommand):
    """`coop agent`: one arm, on the plant or on a port of emulated servos."""

    verb: ClassVar[str] = "agent"
    arm: str
    ring: Path
    control: Path
    driver: DriverKind
    plant_socket: Path | None = None
    port: Path | None = None
    emulated: bool = False
    real_time: bool = False
    whole: bool = False
    hold: bool = False
    guard: Path | None = None
    gripper_empty: bool = False
    priority: int | None = None
    allow_no_realtime: bool = False


@dataclass(frozen=True, kw_only=True)
class GuardCommand(ChildCommand):
    """`coop guard`: goes on when the agent of a real arm cannot."""

    verb: ClassVar[str] = "guard"
    arm: str
    socket: Path
    control: Path
    post_mortem: Path
    driver: DriverKind | None = None  # None: the cell's
    port: Path | None = None
    hold: bool = False
    emulated: bool = False
    priority: int | None = None


@dataclass(frozen=True, kw_only=True)
class TelemetryCommand(ChildCommand):
    """`coop telemetry`: one ring on its way to the recorder."""

    verb: ClassVar[str] = "telemetry"
    member: str
    ring: Path
    connect: str
    lockstep: bool
