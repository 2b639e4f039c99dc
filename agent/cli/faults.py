"""The commands `coop faults list` and `coop faults inject`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from agent.cli import complete
from agent.cli.help import Commands
from agent.cli.options import AsJson, CellPath, Overrides, console, print_json

if TYPE_CHECKING:
    from agent.faults.catalogue import Row
    from agent.faults.measure import Measured
    from agent.faults.plan import Injection

SCHEMA = 1
AT_S = 3.0  # when a fault happens of which nothing is said
MORE_S = 2.0  # of a rehearsal after its fault

_OPTIONS = {"arm": "--arm", "servo": "--servo", "at_s": "--at", "for_s": "--for", "size": "--size"}

app = typer.Typer(
    cls=Commands, no_args_is_help=True, rich_markup_mode=None, help="What can fail, and what the cell then does."
)


@app.command("list")
def list_faults(
    kinds: Annotated[bool, typer.Option("--kinds", help="Show faults that `inject` knows instead.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what can fail, what must happen within which bound, and which tests hold it."""
    from agent.faults.catalogue import rows
    from agent.faults.plan import NAMES, POSSIBLE

    if as_json:
        known = zip(NAMES, POSSIBLE.values(), strict=True)
        print_json({
            "schema": SCHEMA,
            "rows": [_row(row) for row in rows()],
            "kinds": [{"name": n, "text": p.text, "unit": p.unit or None, "size": p.size or None} for n, p in known],
        })  # fmt: skip
    elif kinds:
        _table(("fault", "what happens", "size"), [
            (name, p.text, f"{p.size:g} {p.unit}" if p.unit else "")
            for name, p in zip(NAMES, POSSIBLE.values(), strict=True)
        ])  # fmt: skip
    else:
        _table(("id", "what fails", "what must happen", "bound", "tests"), [
            (r.id, r.fails, r.must, r.bounds, str(len(r.tests)) if r.is_tested else f"none: {r.untested}")
            for r in rows()
        ])  # fmt: skip


@app.command()
def inject(
    cell: CellPath,
    fault: Annotated[
        str,
        typer.Argument(
            help="Name of a fault (`coop faults list --kinds`), or a row's id.", autocompletion=complete.faults
        ),
    ],
    arm: Annotated[
        str | None,
        typer.Option(help="Arm (the cell's first); plant: telemetry of the truth.", autocompletion=complete.arms),
    ] = None,
    servo: Annotated[int | None, typer.Option(help="ID of one servo, instead of all of the arm.")] = None,
    at: Annotated[float | None, typer.Option(min=0.0, help=f"When, s of the trajectory ({AT_S:g}).")] = None,
    for_s: Annotated[float | None, typer.Option("--for", max=1e6, help="How long, s; for good without it.")] = None,
    size: Annotated[float | None, typer.Option(help="How much, in the unit of `list --kinds`.")] = None,
    duration: Annotated[
        float | None, typer.Option(help=f"Seconds of the trajectory (until {MORE_S:g} s behind the fault).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of what is random on the bus.")] = 1,
    out: Annotated[Path | None, typer.Option(metavar="LOG", help="Leave a log of it.")] = None,
    overrides: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Let something fail in a simulated cell of real drivers on emulated servos: who noticed, who held, what it cost.

    Nothing is sent to an arm: time is virtual.  What fails of telemetry or recorder does so in a lockstep run of real
    processes, and each torque is held against the undisturbed run, bit by bit: exit code 1 where one differs.
    """
    from agent.config.cell import load_cell
    from agent.faults.log import require_new, write_log
    from agent.faults.measure import measured
    from agent.faults.plan import require_happens, require_simulated
    from agent.faults.rehearse import rehearse
    from agent.faults.strikes import is_of_listeners
    from agent.process.befallen import require_none
    from agent.verify.check import examine

    faults, made_so = _faults(fault, arm=arm, servo=servo, at_s=at, for_s=for_s, size=size)
    changes = [*made_so, *overrides]
    loaded = load_cell(cell, [*changes, *_length(cell, changes, faults, duration)])
    require_simulated(loaded)
    require_none(loaded, "`coop faults inject`")
    require_happens(faults, loaded.file.duration_s)
    if out is not None:
        require_new(out)
    if is_of_listeners(faults):
        from agent.cli.listeners import inject as inject_listeners

        inject_listeners(loaded, faults, seed, out, as_json=as_json)
        return
    examine(loaded).require()
    run = rehearse(loaded, faults, seed)
    found = measured(run)
    if out is not None:
        write_log(out, run)
    if as_json:
        print_json({"schema": SCHEMA, "cell": loaded.file.name, "faults": given(run.faults), **found.document()})
    else:
        _say(run.faults, found)
        if out is not None:
            typer.echo(f"log               {out}")


def _length(cell: Path, changes: list[str], faults: Sequence[Injection], duration: float | None) -> list[str]:
    """How long the run is, as a change of the cell: as asked, else until something behind the last fault.

    Raises FaultPlanError where it is asked for twice, and where nobody asks for a run beyond the cell's own and a
    fault would begin behind that.
    """
    from agent.config.files import load_files
    from agent.faults.plan import FaultPlanError, require_happens

    asked = [change for change in changes if change.partition("=")[0].strip() == "duration_s"]
    if asked and duration is not None:
        raise FaultPlanError(
            "--duration", found=f"--set {asked[-1]} beside it", expected="one of the two", remedy="leave one out"
        )
    if asked or duration is not None:
        return [] if asked else [f"duration_s={duration}"]
    require_happens(faults, load_files(cell, changes).file.duration_s)
    ends = [fault.at_s + (fault.for_s if math.isfinite(fault.for_s) else 0.0) for fault in faults]
    return [f"duration_s={max(ends, default=AT_S) + MORE_S}"]


def _faults(name: str, **given: Any) -> tuple[tuple[Injection, ...], tuple[str, ...]]:
    """The fault of that name, or those of a row's first run and what that makes of its cell.  Raises FaultPlanError.

    given: what is said of the fault, None where nothing is; a row says it itself.
    """
    from agent.faults.catalogue import row
    from agent.faults.plan import FaultPlanError, injection

    found = row(name)
    if found is None:
        at_s = AT_S if given["at_s"] is None else given["at_s"]
        return (injection(name, **given | {"at_s": at_s}),), ()
    said = [_OPTIONS[key] for key, value in given.items() if value is not None]
    shown = found.faults or (found.runs[0].faults if found.runs else ())
    if said and shown:
        each = " and ".join(dict.fromkeys(fault.fault for fault in shown))
        raise FaultPlanError(
            f"row {found.id}", found=", ".join(said), expected="none of these: a row says when and whom itself",
            remedy=f"name the fault in its place: {each}",
        )  # fmt: skip
    if found.faults:
        return found.faults, ()
    if not found.runs:
        held = f"its tests show it, such as `pytest {found.tests[0]}`" if found.tests else found.untested
        raise FaultPlanError(
            f"row {found.id}, {found.fails}", found="nothing of it in virtual time",
            expected="a row with faults, or a fault of `coop faults list --kinds`", remedy=held,
        )  # fmt: skip
    return found.runs[0].faults, found.runs[0].set


def given(faults: tuple[Injection, ...]) -> list[dict[str, Any]]:
    """Faults as JSON has them."""
    return [f.model_dump(mode="json", exclude_none=True) | {"for_s": _finite(f.for_s)} for f in faults]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _row(row: Row) -> dict[str, Any]:
    return {
        "id": row.id,
        "group": row.group.value,
        "fails": row.fails,
        "must": row.must,
        "never": row.never or None,
        "bound": row.bounds,
        "runs": [
            {"cell": r.cell, "faults": [f.fault for f in r.faults], "bound": r.within.described()} for r in row.runs
        ],
        "faults": [fault.fault for fault in row.faults],
        "tests": list(row.tests),
        "untested": row.untested or None,
    }


def _say(faults: tuple[Injection, ...], found: Measured) -> None:
    for f in faults:
        tell(f, f", arm {f.arm}")
    typer.echo(f"noticed           {_after(found.noticed_s)}{f' ({found.noticed})' if found.noticed else ''}")
    for arm, at in found.stopped_s.items():
        ended = found.ended[arm]
        typer.echo(f"arm {arm:<13} {'goes on' if at is None else f'stopped {_after(at)}'}, ended in {ended}")
        if found.why[arm]:
            typer.echo(f"                  {found.why[arm]}")
    typer.echo(f"internal force    {found.internal_N:.2f} N at most, {found.internal_before_N:.2f} N before")
    typer.echo(f"sag               {found.sag_m * 1e3:.1f} mm")
    typer.echo(f"fastest joint     {found.speed_rad_per_s:.2f} rad/s")
    typer.echo(f"largest torque    {found.torque_share:.0%} of the limit")
    if found.apart_rad > 0.0:
        typer.echo(f"arm from twin     {found.apart_rad:.3f} rad at most")


def tell(fault: Injection, whose: str) -> None:
    """One line of a fault."""
    amount = f" ({fault.amount:g} {fault.possible.unit})" if fault.possible.unit else ""
    typer.echo(f"fault             {fault.fault}{whose}, at {fault.onset_s:g} s: {fault.possible.text}{amount}")


def _after(at: float | None) -> str:
    return "never" if at is None else f"after {at * 1e3:.0f} ms"


def _table(headings: tuple[str, ...], lines: list[tuple[str, ...]]) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for heading in headings:
        table.add_column(heading)
    for line in lines:
        table.add_row(*line)
    console().print(table)
