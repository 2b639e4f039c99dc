"""Names that a report's pictures may have: known without drawing one, and without what draws them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

START: Final = "start"  # the cell as the run begins
_OF_THE_CELL: Final = (
    START, "pose", "errors", "errors_start", "errors_rest", "torques", "wrenches", "lyapunov", "internal_force",
    "loop_timing", "load_share", "disagreement", "friction", "noticed", "pulled", "margins", "bus",
)  # fmt: skip
_OF_AN_ARM: Final = ("torque_terms", "estimates", "servos")


def picture_files(arms: Iterable[str]) -> list[str]:
    """Files of all pictures that the report of a cell with these arms may have; each report has some of them."""
    stems = (*_OF_THE_CELL, *(f"{stem}_{arm}" for arm in arms for stem in _OF_AN_ARM))
    return [f"{stem}.png" for stem in stems]
