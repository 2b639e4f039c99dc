"""The commands `coop motors …`: servos one by one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from agent.cli import complete
from agent.cli.help import Commands
from agent.cli.options import ArmName, AsJson, CellPath, Force, Overrides, note, print_json, require_yes
from agent.cli.progress import Steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from agent.config.schema.arm import ArmFile
    from agent.motors.find import ServoSeen

SCHEMA = 1  # of scan --json; grows when a key changes its meaning

app = typer.Typer(cls=Commands, rich_markup_mode=None, help="Servos one by one: find, set up, save, restore.")

Port = Annotated[str, typer.Option("--port", help="Serial port.", show_default=False)]
Bauds = Annotated[
    list[int], typer.Option("--baud", help="Only at these speeds, bit/s (default: all that servos know).")
]


@app.command()
def scan(
    port: Annotated[list[str], typer.Option("--port", help="Serial ports (default: all of this machine).")] = [],
    baud: Bauds = [],
    protocol_1: Annotated[
        bool, typer.Option("--protocol-1", help="Look for Protocol 1.0 instead (9 s per speed; 1 Mbit/s and 57600).")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List every servo on every port, at every speed; exit code 1 when there is none."""
    from agent.motors.find import survey, survey_old
    from agent.motors.line import open_line, ports
    from drivers.dynamixel.line.protocol1 import BAUDS
    from drivers.interface import Refusal

    seen: list[ServoSeen] = []
    refused: list[Refusal] = []
    bauds = _bauds(baud)
    with Steps(lines=True) as step:
        for path in port or ports():
            step(path)
            try:
                if protocol_1:
                    seen += survey_old(path, baud or BAUDS, step)
                    continue
                with open_line(path) as bus:
                    seen += survey(bus, path, bauds, step)
            except Refusal as error:
                refused.append(error)
    for refusal in refused:
        note(f"coop: {refusal}")
    if as_json:
        print_json({"schema": SCHEMA, "servos": [_as_row(servo) for servo in seen]})
    else:
        _print_servos(seen)
    if not seen:
        if len(refused) == 1 and len(port) == 1:
            raise typer.Exit(refused[0].exit_code)
        note("no servo found: is the 12 V supply on?  Protocol 1.0 servos answer to --protocol-1 only")
        raise typer.Exit(1)


@app.command()
def setup(
    port: Port,
    joint: Annotated[
        str,
        typer.Option(help="Joint the servo is for, or `gripper`.", show_default=False, autocompletion=complete.joints),
    ],
    arm_model: Annotated[
        str | None,
        typer.Option(help="Arm description, e.g. wx200.", show_default=False, autocompletion=complete.arm_models),
    ] = None,
    arm_file: Annotated[
        Path | None, typer.Option(help="Arm file of your own, instead of --arm-model.", show_default=False)
    ] = None,
    shadow: Annotated[bool, typer.Option("--shadow", help="The second servo of that joint.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Set up the one servo on a line for its place in an arm: ID, speed, direction, shadow, limits, return delay."""
    from agent.motors.line import open_line
    from agent.motors.setup import apply_setup, plan_setup, servo_of

    file = _described(arm_model, arm_file)
    slot = servo_of(file, joint, shadow=shadow)
    with open_line(port) as bus:
        plan = plan_setup(bus, slot, file.baud, note)
        typer.echo(plan.title)
        for change in plan.changes:
            typer.echo(f"  {change.register.name}: {change.found} → {change.wanted}")
        if not plan.changes:
            typer.echo("  nothing to change")
            return
        if not yes:
            require_yes("write this")
        apply_setup(bus, plan, file.baud)
    typer.echo(f"servo {slot.servo_id} is set up and was read back; torque was never on")


def _described(arm_model: str | None, arm_file: Path | None) -> ArmFile:
    from agent.config.files import load_arm_file, load_own_arm_file

    if arm_model is not None and arm_file is None:
        return load_arm_file(arm_model, "arm model")[0]
    if arm_file is not None and arm_model is None:
        return load_own_arm_file(arm_file)
    raise typer.BadParameter("either --arm-model or --arm-file says what the servo is to be")


@app.command()
def dump(
    port: Port,
    out: Annotated[Path, typer.Option(help="File to write (TOML).", show_default=False)],
    baud: Bauds = [],
    force: Force = False,
) -> None:
    """Save all EEPROM registers of all servos on a line."""
    from datetime import UTC, datetime

    from agent.atomic import require_place, write_atomically
    from agent.motors.dump import take
    from agent.motors.find import survey
    from agent.motors.line import open_line

    bauds, now = _bauds(baud), datetime.now(UTC).isoformat(timespec="seconds")
    require_place(out, force=force)
    with Steps(lines=True) as step, open_line(port) as bus:
        seen = survey(bus, port, bauds, step)
        step("reading registers")
        saved = take(bus, port, seen, now)
    write_atomically(out, saved.toml())
    registers = sum(len(servo.registers) for servo in saved.servos)
    typer.echo(f"{out}: {len(saved.servos)} servos, {registers} registers")


@app.command()
def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File made by `coop motors dump`.", show_default=False)],
    port: Port,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the differences and write nothing.")] = False,
    mark: Annotated[bool, typer.Option("--mark", help="Write the mark, too: the file is of this very arm.")] = False,
) -> None:
    """Write back what differs from a saved file and read it back; exit code 1 when a servo is missing."""
    from agent.motors.dump import apply_restore, load, plan_restore
    from agent.motors.find import ALL_BAUDS
    from agent.motors.line import open_line

    saved = load(file)
    with open_line(port, saved.servos[0].baud) as bus:
        plans = plan_restore(bus, saved, ALL_BAUDS, mark=mark)
        for plan in plans:
            for change in plan.changes:
                typer.echo(change.line)
            for change in plan.left:
                typer.echo(f"{change.line}; not written, for it may be an arm's mark: --mark")
            for name in plan.absent:
                typer.echo(f"servo {plan.servo.id}: {name}: found no such register in its firmware; left out")
            if plan.baud is None:
                typer.echo(
                    f"servo {plan.servo.id}: found none, wanted a {plan.servo.model}; check its cable and supply"
                )
        changes = sum(len(plan.changes) for plan in plans)
        if not dry_run:
            apply_restore(bus, plans)
    what = "would be written" if dry_run else "written and read back"
    none = "no other differences" if any(plan.left for plan in plans) else "no differences"
    typer.echo(f"{changes} registers {what}" if changes else none)
    if any(plan.baud is None for plan in plans):
        raise typer.Exit(1)


@app.command()
def mark(
    cell: CellPath,
    arm: ArmName,
    ports: Annotated[Path | None, typer.Option(help="Folder of ports named like the arms (`coop emulate`).")] = None,
    overrides: Overrides = [],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask, and leave the LEDs dark.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the mark of another arm, once you said yes.")] = False,
) -> None:
    """Give all servos of an arm the mark that the cell has for it, by which swapped cables are noticed."""
    from agent.config.cell import load_cell
    from agent.motors.line import open_line
    from agent.motors.mark import apply_mark, lit, marked, plan_mark

    if force and yes:
        raise typer.BadParameter("either --force or --yes: which arm has another's mark is seen by its LEDs alone")
    described = load_cell(cell, overrides)
    servos = marked(described, described.arm(arm), ports)
    with open_line(servos.port, servos.baud) as bus:
        changes = plan_mark(bus, servos, replace=force)
        for change in changes:
            typer.echo(change.line)
        if not changes:
            typer.echo(f"arm {arm}: all servos have mark {servos.mark.own} already")
            return
        if not yes:
            with lit(bus, servos):
                require_yes(f"the LEDs of this arm are lit: is it {arm}, and is this to be written")
        apply_mark(bus, servos, changes)
    typer.echo(f"arm {arm}: mark {servos.mark.own} is in {len(changes)} servos, read back; torque was never on")


def _bauds(wanted: Sequence[int]) -> Sequence[int]:
    from agent.motors.find import ALL_BAUDS, refuse_unknown_bauds

    refuse_unknown_bauds(wanted)
    return wanted or ALL_BAUDS


def _print_servos(seen: Sequence[ServoSeen]) -> None:
    line = ""
    for servo in seen:
        if line != (line := f"{servo.port} at {servo.baud} bit/s"):
            typer.echo(line)
            heads = f"{'firmware':>8}  {'supply':>7}  {'temperature':>11}  {'position':>8}  hardware error"
            typer.echo(f"  {'id':>3}  {'model':<12}{heads}")
        volts = f"{servo.voltage_V:.1f} V" if servo.voltage_V is not None else "-"
        celsius = f"{servo.temperature_C} °C" if servo.temperature_C is not None else "-"
        firmware = "-" if servo.firmware is None else servo.firmware
        tick = "-" if servo.position_tick is None else servo.position_tick
        rest = servo.note or servo.hardware_text + ("; torque is on" if servo.torque_on else "")
        cells = f"{firmware:>8}  {volts:>7}  {celsius:>11}  {tick:>8}  {rest}"
        typer.echo(f"  {servo.servo_id:>3}  {servo.model_name:<12}{cells}")


def _as_row(servo: ServoSeen) -> dict[str, Any]:
    return {
        "port": servo.port,
        "baud": servo.baud,
        "id": servo.servo_id,
        "model": servo.model.name if servo.model is not None else None,
        "model_number": servo.model_number,
        "firmware": servo.firmware,
        "voltage_V": None if servo.voltage_V is None else round(servo.voltage_V, 1),
        "temperature_C": servo.temperature_C,
        "hardware_error": None if servo.hardware_error is None else int(servo.hardware_error),
        "hardware_error_text": servo.hardware_text,
        "torque_on": servo.torque_on,
        "position_tick": servo.position_tick,
        "note": servo.note,
    }
