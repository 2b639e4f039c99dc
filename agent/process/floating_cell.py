"""The cell of `coop float`: told which arms float and whether the others move, and what must hold before any torque."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from agent.config.cell import Arm, Cell, cell_from_toml, load_cell
from agent.config.floating import taking_part
from agent.config.monitors import speeds_of_motion
from agent.config.reading import override, shown
from agent.process.build import Connection, port_of
from agent.process.float_loop import FloatError
from agent.process.operated import NO_REAL_TIME_REMEDY
from agent.verify.check import examine
from drivers.dynamixel.line.ports import require_usable


class FloatAskedError(FloatError):
    """A command line by which no arm can float; nothing was opened or started."""

    exit_code = 2


@dataclass(frozen=True)
class FloatOptions:
    """How arms are let float."""

    cell: Path
    arms: tuple[str, ...]
    overrides: tuple[str, ...] = ()
    holding: bool = False
    ports: Path | None = None  # folder with a port per arm; None: the cell's
    emulate: bool = False  # on emulated servos of this command's own
    out: Path | None = None
    priority: int | None = None
    others_move: bool = False  # the other arms carry the object along the cell's motion
    no_realtime: bool = False  # arms that move may do so at a normal priority


def floating_cell(options: FloatOptions) -> Cell:
    """The cell, told which arms float.  Raises ConfigError, FloatAskedError."""
    if options.emulate and options.ports is not None:
        raise FloatAskedError(
            "--ports with --emulate", found="two answers to which servos are meant", expected="one of them",
            remedy="leave out --emulate for servos on those ports, or --ports for emulated ones",
        )  # fmt: skip
    changes = [change for change in options.overrides if _is_of_floating(change)]
    others = [change for change in options.overrides if change not in changes]
    cell = load_cell(options.cell, others)
    names = [arm.name for arm in cell.arms]
    if cell.file.floating is None and not options.arms:
        raise FloatAskedError(
            "arms that are to float", found="none", expected="--arm NAME", remedy=f"name {' or '.join(names)}"
        )
    for name in options.arms:
        if name not in names:
            raise FloatAskedError(
                "--arm", found=repr(name), expected=" or ".join(names), remedy="name arms of the cell"
            )  # fmt: skip
    own = [*changes, *_said(options, changes)]
    if cell.file.floating is not None:
        return load_cell(options.cell, [*others, *own])
    return _with_table(cell, own, options.cell.name)


def _is_of_floating(change: str) -> bool:
    return change.partition(".")[0].strip() == "floating"


def _said(options: FloatOptions, changes: Sequence[str]) -> list[str]:
    """What options say of the table, as changes of it.  Raises FloatAskedError for a key that --set gives as well."""
    carries = "--others-move" if options.others_move else "--holding"
    said = {
        "arms": ("--arm", json.dumps(options.arms) if options.arms else None),
        "holding": (carries, "true" if options.holding or options.others_move else None),
        "others_move": ("--others-move", "true" if options.others_move else None),
    }
    for change in changes:
        option, value = said.get(change.partition("=")[0].partition(".")[2].strip(), ("", None))
        if value is not None:
            raise FloatAskedError(
                option, found=f"--set {shown(change)} beside it", expected="one of the two", remedy="leave one out"
            )
    return [f"floating.{key}={value}" for key, (_, value) in said.items() if value is not None]


def _with_table(cell: Cell, changes: Sequence[str], source: str) -> Cell:
    """The cell with a table [floating] behind all else, so that the log keeps its comments.  Raises ConfigError."""
    document: dict[str, Any] = {}
    for change in changes:
        override(document, change)
    return cell_from_toml(cell.toml.rstrip() + b"\n\n" + tomli_w.dumps(document).encode(), source)


def require_ports(cell: Cell, options: FloatOptions) -> None:
    """Refuse ports that are not there, may not be used, are none or are in use.  Raises ConnectError."""
    for name in names_of(cell):
        require_usable(port_for(cell, options, name))


def require_motion(cell: Cell, options: FloatOptions) -> None:
    """Refuse a motion of the arms that move: unsafe, too fast beside a hand, or of real arms without real time.

    Raises ConfigError, FloatAskedError.
    """
    spec, movers = cell.file.floating, moving(cell)
    if spec is None or not movers:
        return
    if not (options.emulate or options.priority is not None or options.no_realtime):
        raise FloatAskedError(
            "arms that move while others float", found="a normal priority", expected="SCHED_FIFO on a real arm",
            remedy=NO_REAL_TIME_REMEDY,
        )  # fmt: skip
    examine(cell, wired=True).require()
    for arm in movers:
        fastest = float(speeds_of_motion(cell, arm, cell.model(arm)).max())
        if fastest > spec.speed_max_rad_per_s:
            raise FloatAskedError(
                f"motion of arm {arm.name}", found=f"a joint at {fastest:.2f} rad/s",
                expected=f"at most {spec.speed_max_rad_per_s:g} (floating.speed_max_rad_per_s), beside a hand",
                remedy="give the cell a slower motion: --set trajectory.KEY=VALUE",
            )  # fmt: skip


def moving(cell: Cell) -> tuple[Arm, ...]:
    """The arms that move while others float."""
    spec = cell.file.floating
    return tuple(arm for arm in cell.arms if spec is not None and spec.moves(arm.name))


def names_of(cell: Cell) -> list[str]:
    """Of the arms that float, and of those that move while they do."""
    return [arm.name for arm in taking_part(cell)]


def port_for(cell: Cell, options: FloatOptions, name: str) -> str:
    """Path of the port of an arm.  Raises ConnectError."""
    given = None if options.ports is None else str(options.ports / name)
    return port_of(cell.arm(name), Connection(port=given))
