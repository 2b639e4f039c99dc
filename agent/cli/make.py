"""The command that makes a cell file: new."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli import complete
from agent.cli.options import AsJson, Force, note, print_json

if TYPE_CHECKING:
    from agent.make.make import Made
    from agent.make.wish import MotionWish, Wish


class ShapeName(StrEnum):
    """What the object is like."""

    BOX = "box"
    BAR = "bar"
    CYLINDER = "cylinder"


class MotionName(StrEnum):
    """What it is to do."""

    LIFT = "lift"
    CARRY = "carry"
    SINUSOID = "sinusoid"
    WAYPOINTS = "waypoints"


BY = {"lift": "0,0,0.05", "carry": "0.04,0,0.04", "sinusoid": "0.04,0,0", "waypoints": "0,0,0"}


def new(
    cell: Annotated[Path, typer.Argument(metavar="FILE", help="Cell file to write.", show_default=False)],
    arm: Annotated[
        list[str],
        typer.Option(
            help='Words apart by spaces, as "wx250s face=-x": MODEL, or an arm file of its own (.toml), '
            "face=-x|+x|+y|-y, down=DEG below the level, inset=M over the face, "
            "base=X,Y,Z,YAW_DEG, pose=X,Y,Z,QW,QX,QY,QZ of the hand in object axes, share=PART, "
            "name=NAME as wanted. One option per arm.",
            show_default=False,
            autocompletion=complete.arm_models,
        ),
    ] = [],
    mass: Annotated[float | None, typer.Option(help="Mass of the object, kg.", show_default=False)] = None,
    size: Annotated[str | None, typer.Option(help="Its sides X,Y,Z, m.", show_default=False)] = None,
    shape: Annotated[ShapeName, typer.Option(help="For its inertia; bar and cylinder are long in x.")] = ShapeName.BOX,
    inertia: Annotated[str | None, typer.Option(help="XX,YY,ZZ instead, kg·m².", show_default=False)] = None,
    motion: Annotated[MotionName, typer.Option(help="What the object is to do.")] = MotionName.LIFT,
    by: Annotated[str | None, typer.Option(help="How far, or amplitudes, DX,DY,DZ, m.", show_default=False)] = None,
    time: Annotated[float, typer.Option(min=0.5, max=600.0, help="Of one way, or a period, s.")] = 5.0,
    point: Annotated[list[str], typer.Option(help="Way-point T,DX,DY,DZ after the start; repeated.")] = [],
    height: Annotated[float | None, typer.Option(help="Of the object at the start, m.", show_default=False)] = None,
    rate: Annotated[float, typer.Option(min=20.0, max=2000.0, help="Control rate, Hz.")] = 200.0,
    search_gains: Annotated[bool, typer.Option("--tune/--no-tune", help="Search gains, or take usual ones.")] = True,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Make a cell file that `coop check` accepts, or say what cannot be met; without --arm it asks on a terminal."""
    from agent.atomic import require_place, write_atomically
    from agent.cli.progress import Steps

    require_place(cell, force=force)
    _require_fit(motion, by, point)
    if not arm and _asks():
        arm, mass, size, motion, by = _asked(mass, size, motion, by)
    moves = _motion(motion, by, time, point)
    wish = _wish(cell, arm, (mass, size, shape, inertia), moves, height, rate)
    from agent.make.make import Maker

    with Steps() as step:
        made = Maker(wish, step).make(tune=search_gains)
    write_atomically(cell, made.text.encode())
    if as_json:
        print_json(_document(made, cell))
    else:
        for finding in made.warnings:
            typer.echo(f"warning: {finding.line}")
        note(f"written  {cell}; next: `coop run {cell}`, for real arms docs/new-cell.md")


def _asks() -> bool:
    """Whether there is somebody to ask."""
    return sys.stdin is not None and sys.stdin.isatty()


def _asked(
    mass: float | None, size: str | None, motion: MotionName, by: str | None
) -> tuple[list[str], float, str, MotionName, str | None]:
    """Questions with defaults, in the order in which a cell is thought of; way-points say the motion themselves."""
    count = typer.prompt("How many arms", "2", value_proc=_count)
    arms = [typer.prompt(f"Arm {i + 1} (MODEL face=... base=..., see -h)", "wx250s") for i in range(count)]
    kg = mass if mass is not None else typer.prompt("Mass of the object, kg", 0.2, type=float)
    sides = size if size is not None else typer.prompt("Its sides x,y,z, m", "0.2,0.1,0.04")
    if motion is MotionName.WAYPOINTS:
        return arms, kg, sides, motion, None
    kind = typer.prompt("Motion (lift, carry, sinusoid)", motion.value, value_proc=_moving)
    way = by if by is not None else typer.prompt("How far dx,dy,dz, m", BY[kind.value])
    return arms, kg, sides, kind, way


def _count(text: str) -> int:
    if text not in {"1", "2", "3", "4"}:
        raise typer.BadParameter("1 to 4")
    return int(text)


def _moving(text: str) -> MotionName:
    if text not in {name.value for name in MotionName if name is not MotionName.WAYPOINTS}:
        raise typer.BadParameter("lift, carry or sinusoid; way-points are given with --point")
    return MotionName(text)


def _require_fit(motion: MotionName, by: str | None, points: list[str]) -> None:
    """Raise WishError for words about the motion that do not go together."""
    from agent.make.wish import WishError

    if bool(points) != (motion is MotionName.WAYPOINTS):
        raise WishError(
            f"motion {motion.value}", found=f"{len(points)} way-points", remedy="give --point, or leave it out",
            expected="some with --motion waypoints, and none with any other",
        )  # fmt: skip
    if points and by is not None:
        raise WishError(
            f"motion {motion.value}", found="--by beside --point", expected="one of them", remedy="leave --by out"
        )


def _motion(motion: MotionName, by: str | None, time: float, points: list[str]) -> MotionWish:
    from agent.make.wish import MotionKind, MotionWish, points_of, vector

    way = vector(BY[motion.value] if by is None else by, "--by")
    return MotionWish(MotionKind(motion.value), way, time, points_of(points))


def _wish(
    cell: Path,
    arms: list[str],
    what: tuple[float | None, str | None, ShapeName, str | None],
    motion: MotionWish,
    height: float | None,
    rate: float,
) -> Wish:
    from agent.make.wish import ObjectWish, ShapeKind, Wish, WishError, arm_wishes, name, vector

    called = name(cell.stem, f"name of the cell {cell}", "give the file such a name")
    mass, size, shape, inertia = what
    if mass is None or size is None:
        raise WishError(
            "object", found="no mass" if mass is None else "no size", expected="--mass KG and --size X,Y,Z",
            remedy="give both",
        )  # fmt: skip
    sides, moments = vector(size, "--size"), None if inertia is None else vector(inertia, "--inertia")
    thing = ObjectWish(mass, sides, ShapeKind(shape.value), moments)
    thing.require_possible()
    return Wish(called, arm_wishes(arms), thing, motion, height, rate, cell.parent)


def _document(made: Made, path: Path) -> dict[str, object]:
    from agent.cli.documents import check_document

    return {**check_document(made.cell, made.report), "written": str(path), "tuned": made.tuned}
