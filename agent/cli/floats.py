"""The command `coop float`: arms that a hand guides, with what they are doing on the screen."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import typer

from agent.cli.options import CellPath, Overrides, SomeArms, asked_yes, note
from agent.cli.progress import Steps

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live
    from rich.table import Table

    from agent.process.glance import Glance

LINE_EVERY_S = 2.0  # where no terminal shows it
JSON_EVERY_S = 0.1
QUESTION = (
    "Is arm {arms} supported by somebody's hand or by what it lies on, is nobody's hand between its links, and is "
    "somebody ready to pull the plug? Torque comes on now, {what}."
)
HEADINGS = ("joint", "rad", "°", "rad/s", "to its limit", "load", "°C")
SPARE = ("°", "rad/s", "load")  # left out of a narrow table, in this order
STOPS = "Ctrl-C: it brakes and stands for 3 s, sinks slowly, and its torque goes off once it lies"


def float_arms(
    cell: CellPath,
    arm: SomeArms = [],
    holding: Annotated[
        bool, typer.Option("--holding", help="The arms hold the object: grippers close, each carries its load share.")
    ] = False,
    others_move: Annotated[
        bool, typer.Option("--others-move", help="With the object: the other arms carry it along the cell's motion.")
    ] = False,
    ports: Annotated[Path | None, typer.Option(help="Folder of ports named like the arms, not the cell's.")] = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it on emulated servos; nothing real moves.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of the log (default runs/<UTC>-<cell>-float).")] = None,
    priority: Annotated[int | None, typer.Option(min=1, max=99, help="SCHED_FIFO priority, or refuse.")] = None,
    allow_no_realtime: Annotated[
        bool, typer.Option("--allow-no-realtime", help="Let real arms move at a normal priority.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="The arm is supported: do not ask.")] = False,
    overrides: Overrides = [],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document a line, ten a second.")] = False,
) -> None:
    """Let arms float so that a hand can guide them: weight compensated, damped; writes a log for `coop calibrate`.

    A stop lets them stand, then sink; so does the guard of one whose process dies.  Keep a hand on them all the same.
    """
    from agent.host.signals import StopFlag
    from agent.process.floating_arms import float_arms
    from agent.process.floating_cell import (
        FloatOptions,
        floating_cell,
        moving,
        names_of,
        require_motion,
        require_ports,
    )

    requested = StopFlag()
    options = FloatOptions(
        cell, tuple(arm), tuple(overrides), holding, ports, emulate, out, priority, others_move, allow_no_realtime
    )
    with requested.interrupting():
        loaded = floating_cell(options)
        if not emulate:
            require_ports(loaded, options)
        require_motion(loaded, options)
        spec = loaded.file.floating
        if not emulate and spec is not None:
            _ask(names_of(loaded), [one.name for one in moving(loaded)], holding=spec.holding, yes=yes)
    with Shown(as_json=as_json) as shown:
        log = float_arms(loaded, options, requested, shown)
    if as_json:
        typer.echo(json.dumps({"log": str(log)}))
    else:
        typer.echo(f"log      {log}")


float_arms.__name__ = "float"  # the command's word, which a function of this module cannot have


def _ask(arms: Sequence[str], moving: Sequence[str], *, holding: bool, yes: bool) -> None:
    """End the command unless a person says that the arms are supported; moving: those that move the object."""
    what = "and the grippers close on the object" if holding else "and the arm floats"
    if moving:
        what += f"; 3 s later it MOVES, carried by {' and '.join(moving)}"
    if not yes and not asked_yes(QUESTION.format(arms=" and ".join(arms), what=what)):
        note("no arm floats: nobody has said yes; support them and answer yes, or give --yes")
        raise typer.Exit(1)


class Shown:
    """What is on the screen: a table that lives on a terminal, a line now and then elsewhere, or JSON lines."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._on_terminal = sys.stdout.isatty()  # what rich puts before it while a spinner is drawn denies that
        self._steps = Steps(lines=True)
        self._live: Live | None = None
        self._next_s = 0.0
        self._said: set[tuple[str, str]] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def phase(self, what: str) -> None:
        """What is being done."""
        self._end()
        self._steps(what)

    def note(self, text: str) -> None:
        """Write a line that stays."""
        self._steps.clear()
        note(text)

    def show(self, glances: Sequence[Glance]) -> None:
        """How the arms are."""
        if self._as_json:
            if self._due(JSON_EVERY_S):
                typer.echo(json.dumps([glance.document() for glance in glances], allow_nan=False))
            return
        if self._on_terminal:
            self._table(glances)
            return
        self._tell(glances)
        seen = [glance for glance in glances if glance.joints]
        if seen and self._due(LINE_EVERY_S):
            for glance in seen:
                typer.echo(line(glance))

    def _tell(self, glances: Sequence[Glance]) -> None:
        """What the arms say, each thing once."""
        for glance in glances:
            for text in glance.said:
                if (glance.arm, text) not in self._said:
                    self._said.add((glance.arm, text))
                    note(f"{glance.arm}: {text}")

    def _table(self, glances: Sequence[Glance]) -> None:
        from rich.console import Console
        from rich.live import Live

        if self._live is None:
            self._steps.clear()
            self._live = Live(console=Console(), auto_refresh=False)
            self._live.start()
        self._live.update(tables(glances, self._live.console.width), refresh=True)

    def _due(self, every_s: float) -> bool:
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = now_s + every_s
        return True

    def _end(self) -> None:
        self._steps.clear()
        if self._live is not None:
            self._live.stop()
            self._live = None


def line(glance: Glance) -> str:
    """An arm in one line."""
    if math.isnan(glance.p_m[0]):
        return f"{glance.t:7.1f} s  {glance.arm} {glance.mode.name}  not seen: its servos do not answer"
    joints = "  ".join(f"{j.name} {j.q_rad:+.3f}" for j in glance.joints)
    x, y, z = glance.p_m
    return f"{glance.t:7.1f} s  {glance.arm} {glance.mode.name}  {joints} rad  at {x:+.3f} {y:+.3f} {z:+.3f} m"


def tables(glances: Sequence[Glance], width: int) -> Group:
    """All arms as tables of at most so many characters, one without torque as a line, with what they say below."""
    from rich.console import Group
    from rich.text import Text

    parts: list[Table | Text] = []
    for glance in glances:
        parts.append(
            _fitting(glance, width) if glance.joints else Text(f"{glance.arm}  {glance.mode.name}", style="italic")
        )
        parts += [Text(f"  {text}", style="yellow") for text in glance.said]
    return Group(*parts, Text(STOPS, style="dim"))


def _fitting(glance: Glance, width: int) -> Table:
    """Its table, on a narrow screen without what another column or the log says too, rather than with cut names."""
    from rich.console import Console

    wide, table = Console(width=1000), _table(glance, ())
    for out in range(1, len(SPARE) + 1):
        if wide.measure(table).maximum <= width:
            break
        table = _table(glance, SPARE[:out])
    return table


def _table(glance: Glance, without: Sequence[str]) -> Table:
    from rich.table import Table
    from rich.text import Text

    x, y, z = glance.p_m
    roll, pitch, yaw = map(math.degrees, glance.rpy_rad)
    place = f"end effector {x:+.4f} {y:+.4f} {z:+.4f} m, roll {roll:+.1f}° pitch {pitch:+.1f}° yaw {yaw:+.1f}°"
    table = Table(title=f"{glance.arm}  {glance.mode.name}  {glance.t:.1f} s", caption=place, title_justify="left")
    shown = [heading not in without for heading in HEADINGS]
    for heading in compress(HEADINGS, shown):
        table.add_column(heading, justify="left" if heading == "joint" else "right", no_wrap=True)
    for j in glance.joints:
        near = "red" if j.room_rad < 0.1 else ""
        cells: tuple[str | Text, ...] = (
            j.name, f"{j.q_rad:+.4f}", f"{math.degrees(j.q_rad):+.1f}", f"{j.dq_rad_per_s:+.2f}",
            Text(f"{j.room_rad:.2f} rad", style=near), f"{j.load:.0%}",
            "-" if math.isnan(j.temperature_C) else f"{j.temperature_C:.0f}",
        )  # fmt: skip
        table.add_row(*compress(cells, shown))
    return table
