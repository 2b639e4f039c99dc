"""What makes a log self-describing: versions of what can change a number, and the files of its cell."""

from __future__ import annotations

import platform
from importlib import metadata
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from agent.config.files import CellFiles

RUN_FILE: Final = "run.json"  # attachments of every log: how it was run, and the cell file
CELL_FILE: Final = "cell.toml"
PACKAGES = ("widowx-coop", "pin", "numpy", "scipy", "eclipse-zenoh", "mcap", "dynamixel-sdk")
COMPUTING = ("widowx-coop", "pin", "numpy", "scipy")  # what laws and simulation are made of


def computing() -> dict[str, str]:
    """Versions of what computes the motion of a simulated cell in one process."""
    return {name: metadata.version(name) for name in COMPUTING}


def versions() -> dict[str, str]:
    """Versions of everything that can change a number."""
    found = {name: metadata.version(name) for name in PACKAGES}
    found["python"] = platform.python_version()
    return found


def attachments(cell: CellFiles, run_info: bytes) -> dict[str, bytes]:
    """Files of a log by name: run.json, the cell file, the arms' files and URDFs.

    Those that are not of this installation are in the cell file itself (agent.config.embed).
    """
    files = {RUN_FILE: run_info, CELL_FILE: cell.toml}
    for arm in cell.arms:
        if arm.entry.arm_file is None:
            files[f"{arm.entry.model}.toml"] = arm.toml
        if not arm.own_urdf:
            files[arm.file.urdf] = arm.urdf_xml.encode()
    return files
