"""The refusal of everything that shows a run; apart from the rest, so that naming it loads nothing."""

from __future__ import annotations

from drivers.interface import Refusal


class ViewError(Refusal):
    """A run or a cell that cannot be shown."""
