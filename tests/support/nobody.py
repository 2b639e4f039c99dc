"""Somebody who watches a run and says nothing."""

from __future__ import annotations


class Nobody:
    def phase(self, what: str, *, still: bool = False) -> None:
        """What is being done."""

    def note(self, text: str) -> None:
        """Something that stays to be read."""

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        """How far the run is."""
