"""Where the files lie that ship beside the code: documents, units, layouts, cells, arms; the same names in every
installation."""

from __future__ import annotations

import enum
import sysconfig
from pathlib import Path

import configs
from drivers.interface import Refusal

INSTALLED = Path("share/widowx-coop")  # below an environment's prefix, as pyproject.toml has it


class NotShipped(Refusal):
    """This installation came without these files."""


class Shipped(enum.StrEnum):
    """What ships beside the code."""

    CELLS = "cells"
    ARMS = "arms"
    UNITS = "units"
    DOCS = "docs"
    LAYOUTS = "layouts"


def folder(what: Shipped) -> Path:
    """Folder of these files: in the checkout, or where the wheel put them.  Raises NotShipped."""
    places = {
        Shipped.CELLS: configs.CELLS_DIR,
        Shipped.ARMS: configs.ARMS_DIR,
        Shipped.UNITS: _root() / "systemd",
        Shipped.DOCS: _root() / "docs",
        Shipped.LAYOUTS: configs.LAYOUTS_DIR,
    }
    place = places[what]
    if not place.is_dir():
        raise NotShipped(
            what.value, found=f"no folder {place}", expected="the files that ship", remedy="install widowx-coop again"
        )
    return place


def _root() -> Path:
    checkout = Path(configs.__file__).parents[1]
    return checkout if (checkout / "pyproject.toml").is_file() else Path(sysconfig.get_path("data")) / INSTALLED
