"""What a comparison of rows has found: by arm how many differ, and the first field in which one does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Difference:
    """The first field of a row that came out otherwise."""

    arm: str
    row: int  # sequence number
    t_s: float
    field: str
    index: int | None  # in an array
    recorded: float | str
    replayed: float | str
    fields: tuple[str, ...]  # all that differ in that row


TORQUES: Final = frozenset({"tau_cmd", "tau_limited"})  # of which the largest difference is told


@dataclass(frozen=True, slots=True)
class ArmComparison:
    """One arm's rows against the same rows computed again."""

    arm: str
    rows: int  # compared
    different: int
    left_out: int  # in the window, but without a memory to begin with
    first: Difference | None
    torque_difference_Nm: float  # largest, of what the law asks for and of what the limits leave of it


@dataclass(frozen=True, slots=True)
class Comparison:
    """All arms; `notes` say what the comparison could not cover."""

    arms: tuple[ArmComparison, ...]
    notes: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Rows compared."""
        return sum(arm.rows for arm in self.arms)

    @property
    def different(self) -> int:
        """Rows of which some field differs."""
        return sum(arm.different for arm in self.arms)

    @property
    def first(self) -> Difference | None:
        """The earliest row that differs."""
        found = [arm.first for arm in self.arms if arm.first is not None]
        return min(found, key=lambda d: d.row, default=None)

    @property
    def equal(self) -> bool:
        """Whether every row of the window was compared and none differs."""
        return not self.different and not any(arm.left_out for arm in self.arms)
