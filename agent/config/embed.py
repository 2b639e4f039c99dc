"""Files that a cell names, taken into its bytes while it is loaded: a motion, and arm files of its own with URDFs.

From then on the cell stands alone: every host, every log and every replay has the same under the same fingerprint.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import tomli_w

from agent.config.reading import ConfigError, read_file, shown
from agent.config.tables import tables
from agent.config.trajectory import text_of_file
from agent.config.urdf import urdf_beside

_TABLE: Final = "embedded"


def embed(raw: bytes, document: dict[str, Any], cell_path: Path) -> bytes:
    """The cell's bytes with the files it names appended as a table `embedded`; those that it already carries stay.

    Raises TrajectoryError and ConfigError for files that cannot be read.
    """
    carried = document.get(_TABLE, {})
    if not isinstance(carried, dict):
        return raw
    found = dict(_texts(document, cell_path, carried))
    if not found:
        return raw
    if carried:
        return tomli_w.dumps({**document, _TABLE: carried | found}, multiline_strings=True).encode()
    return raw.rstrip(b"\n") + b"\n\n" + tomli_w.dumps({_TABLE: found}, multiline_strings=True).encode()


def without_files(text: str) -> str:
    """The cell's text without the files that `embed` appended to it; they are found beside the cell file again."""
    before, table, _ = text.partition(f"\n\n[{_TABLE}]\n")
    return f"{before}\n" if table else text


def _texts(document: Mapping[str, Any], cell_path: Path, carried: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    trajectory = document.get("trajectory")
    if isinstance(trajectory, dict) and trajectory.get("kind") == "file":
        name = trajectory.get("path")
        if isinstance(name, str) and name not in carried:
            yield name, text_of_file(name, cell_path)
    arms = document.get("arms")
    for arm in arms if isinstance(arms, list) else ():
        name = arm.get("arm_file") if isinstance(arm, dict) else None
        if isinstance(name, str) and name not in carried:
            yield from _of_arm(name, str(arm.get("name")), cell_path)


def _of_arm(name: str, arm: str, cell_path: Path) -> Iterator[tuple[str, str]]:
    """Its file, and its URDF where that stands beside it; where it does not, it is one that ships."""
    text = _arm_text(name, arm, cell_path)
    yield name, text
    try:
        urdf = tables(text).get("urdf")
    except (ValueError, RecursionError):
        return  # what is wrong with it is said where it is read
    if isinstance(urdf, str) and (cell_path.parent / urdf_beside(name, urdf)).is_file():
        yield urdf_beside(name, urdf), _arm_text(urdf_beside(name, urdf), arm, cell_path)


def _arm_text(name: str, arm: str, cell_path: Path) -> str:
    try:
        return read_file(cell_path.parent / name).decode()
    except (ConfigError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"arm_file of arm {shown(arm)} in {cell_path.name}",
            found=f"{shown(name)}: " + (str(error.found) if isinstance(error, ConfigError) else "not UTF-8 text"),
            expected="a readable arm file",
            remedy="give the path relative to the cell file, or leave arm_file out for the file that ships",
        ) from error
