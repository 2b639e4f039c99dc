"""What the shell offers after a tab: shipped cells, arms and keys of the cell on the line, arm models, faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

import configs


def cells(incomplete: str) -> list[str]:
    """Shipped cells by name and the TOML files of this folder; a path is left to the shell."""
    if "/" in incomplete:
        return []
    shipped = sorted(path.stem for path in configs.CELLS_DIR.glob("*.toml"))
    here = sorted(path.name for path in Path().glob("*.toml"))
    return [name for name in (*shipped, *here) if name.startswith(incomplete)]


def arms(ctx: typer.Context, incomplete: str) -> list[str]:
    """Arms of the cell that stands on the line."""
    named = (arm.get("name") for arm in _arms(_cell(ctx)))
    return [name for name in named if isinstance(name, str) and name.startswith(incomplete)]


def members(ctx: typer.Context, incomplete: str) -> list[str]:
    """Whose rows there are: its arms, and the simulated plant."""
    return [*arms(ctx, incomplete), *(["plant"] if "plant".startswith(incomplete) else [])]


def settings(ctx: typer.Context, incomplete: str) -> list[str]:
    """Keys that the cell on the line has, each with its value."""
    return [pair for pair in _pairs(_cell(ctx)) if pair.startswith(incomplete)]


def arm_models(incomplete: str) -> list[str]:
    """Described arms."""
    described = sorted(path.stem for path in configs.ARMS_DIR.glob("*.toml"))
    return [name for name in described if name.startswith(incomplete)]


def faults(incomplete: str) -> list[str]:
    """Faults by name, and those rows of the list that can be shown; half a second, where the others read TOML alone."""
    from agent.faults.catalogue import rows
    from agent.faults.plan import NAMES

    shown = (row.id for row in rows() if row.faults or row.runs)
    return [name for name in (*NAMES, *shown) if name.startswith(incomplete)]


def joints(ctx: typer.Context, incomplete: str) -> list[str]:
    """Joints of the arm on the line, and its gripper."""
    own = ctx.params.get("arm_file")
    model = _read(Path(own) if own else configs.ARMS_DIR / f"{ctx.params.get('arm_model') or ''}.toml")
    described = model.get("joints", [])
    named = [str(joint.get("name", "")) for joint in described if isinstance(joint, dict)]
    return [name for name in (*named, "gripper") if name.startswith(incomplete)]


def _cell(ctx: typer.Context) -> dict[str, Any]:
    """The cell file on the line; empty where none can be read."""
    words = [ctx.params.get("cell"), *ctx.args]  # an option that still wants its value leaves all words unparsed
    given = Path(str(next((word for word in words if word), "")))
    return _read(given) or _read(configs.CELLS_DIR / f"{given.name}.toml")


def _read(path: Path) -> dict[str, Any]:
    import tomllib

    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # an error here would be printed into the line that is being typed
        return {}


def _arms(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    found = document.get("arms", [])
    return [arm for arm in found if isinstance(arm, dict)] if isinstance(found, list) else []


def _pairs(node: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in node.items():
        if isinstance(value, dict):
            yield from _pairs(value, f"{prefix}{key}.")
        elif key == "arms" and not prefix:
            for arm in _arms(node):
                yield from _pairs(arm, f"arms.{arm.get('name', '')}.")
        else:
            plain = isinstance(value, int | float | str)  # a list is for the user to type
            shown = str(value).lower() if isinstance(value, bool) else str(value)
            yield f"{prefix}{key}={shown if plain else ''}"
