"""Commands that answer one question of a log: events, grasps."""

from __future__ import annotations

import datetime
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from agent.cli.options import AsJson, LogPath, console, instant, note, print_json
from agent.cli.progress import Steps

if TYPE_CHECKING:
    from agent.log.read import ColumnLog
    from agent.telemetry.row.event import Event

SCHEMA = 1


def events(
    log: LogPath,
    arm: Annotated[list[str], typer.Option("--arm", help="Only from this arm; also: plant, recorder.")] = [],
    from_s: Annotated[
        float, typer.Option("--from", callback=instant, help="First second of the trajectory.")
    ] = -math.inf,
    to_s: Annotated[float, typer.Option("--to", callback=instant, help="Where to end, s.")] = math.inf,
    as_json: AsJson = False,
) -> None:
    """Say what happened when: events of the arms by the time of the trajectory, the rest by that of the day (UTC)."""
    from agent.log.read import open_log
    from agent.log.when import trajectory_time

    if not from_s < to_s:
        raise typer.BadParameter(f"no time between --from {from_s:g} and --to {to_s:g}")
    with Steps() as step:
        step("reading the log")
        with open_log(log, any_layout=True) as opened:
            _refuse_strangers(opened, arm)
            every = _told_and_lost(opened)
            asked = [event for event in every if not arm or event.source in arm]
            timed = [(trajectory_time(event, opened.agents.get(event.source)), event) for event in asked]
    chosen = [(t, event) for t, event in timed if from_s <= t < to_s or math.isnan(t)]
    for problem in opened.remarks:
        note(f"{log}: {problem}")
    if as_json:
        print_json({"schema": SCHEMA, "log": str(log), "events": [_document(t, event) for t, event in chosen]})
        return
    for t, event in chosen:
        when = _day_time(event) if math.isnan(t) else f"{t:.3f} s"
        typer.echo(f"{when:>12}  {event.source:<10} {event.level.name:<6} {event.text}")
    if not chosen:
        note(f"{log}: no event {'of these' if every else 'at all'}")


def _told_and_lost(log: ColumnLog) -> list[Event]:
    """The events of a log, and what became of the object by the plant's rows, if the rows are of this release."""
    from agent.report.loss import told
    from agent.report.prepared import prepare
    from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

    if log.plant is None or any(
        own.dtype not in (AGENT_STATE.dtype, PLANT_STATE.dtype) for own in log.layouts.values()
    ):
        return list(log.events)
    return sorted([*log.events, *told(prepare(log))], key=lambda event: event.utc_ns)


def _refuse_strangers(log: ColumnLog, names: list[str]) -> None:
    """Raise NoSuchField for a name that nobody has who could have told something in this log."""
    from agent.config.schema.types import nearest
    from agent.log.run import NoSuchField
    from agent.telemetry.row.topics import PLANT, RECORDER

    known = list(dict.fromkeys((*log.agents, PLANT, RECORDER, *(event.source for event in log.events))))
    for name in names:
        if name not in known:
            raise NoSuchField(
                f"log {log.path}", found=repr(name), expected=f"one of {', '.join(known)}",
                remedy=nearest(name, known) or "name one of them",
            )  # fmt: skip


def _day_time(event: Event) -> str:
    return f"{datetime.datetime.fromtimestamp(event.utc_ns / 1e9, datetime.UTC):%H:%M:%S}Z"


def _document(t: float, event: Event) -> dict[str, Any]:
    return {
        "t_s": None if math.isnan(t) else t, "utc_ns": event.utc_ns, "source": event.source,
        "level": event.level.name, "text": event.text, "data": dict(event.data),
    }  # fmt: skip


def grasps(log: LogPath, as_json: AsJson = False) -> None:
    """Say whose picture of the object is off, what each grasp carries, and how much of its grip is left."""
    from agent.log.read import open_log
    from agent.replay.grasps import grasps as of_log
    from agent.replay.source import recorded_cell

    with Steps() as step:
        step("reading the log")
        with open_log(log) as opened:
            found = of_log(opened, recorded_cell(opened))
    for problem in opened.remarks:
        note(f"{log}: {problem}")
    if as_json:
        arms = {
            g.arm: {
                "rows": g.rows, "offset_m": g.offset_m, "offset_rad": g.offset_rad, "force_max_N": g.force_max_N,
                "grip_force_max_N": g.grip_force_max_N, "margin_N": g.margin_N,
            }
            for g in found.arms
        }  # fmt: skip
        print_json({"schema": SCHEMA, "log": str(log), "truth": found.truth, "arms": arms})
        return
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    against = "the true object" if found.truth else "the mean of the arms"
    table = Table(title=f"{escape(str(log))}: against {against}", title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("arm", "sees it off by", "turned by", "largest force", "grip", "margin"):
        table.add_column(heading, justify="left" if heading == "arm" else "right", no_wrap=True)
    for g in found.arms:
        grip, left = ("not given" if x is None else f"{x:.2f} N" for x in (g.grip_force_max_N, g.margin_N))
        table.add_row(
            g.arm, f"{1e3 * g.offset_m:.3f} mm", f"{1e3 * g.offset_rad:.3f} mrad", f"{g.force_max_N:.2f} N", grip, left
        )
    console().print(table)
    if not found.truth:
        typer.echo("forces are those commanded; two arms that disagree do not tell which one is off, a third does")
