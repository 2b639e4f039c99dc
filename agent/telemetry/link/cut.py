"""Notices that the link to the recorder was away, and tells for how long once it is back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

_LOOK_S: Final = 0.1


class CutWatch:
    """Looks at a link ten times a second at most; before there was one, nothing is cut."""

    def __init__(self, linked: Callable[[], bool]) -> None:
        self._linked = linked
        self._looked_s = float("-inf")
        self._was_linked = False
        self._since_s: float | None = None

    @property
    def away(self) -> bool:
        """Whether the link was away at the last look."""
        return self._since_s is not None

    def ended(self, now_s: float) -> float | None:
        """Seconds for which the link was away, once, when it has just come back."""
        if now_s - self._looked_s < _LOOK_S:
            return None
        self._looked_s = now_s
        if not self._linked():
            if self._was_linked and self._since_s is None:
                self._since_s = now_s
            return None
        self._was_linked = True
        if self._since_s is None:
            return None
        away_s, self._since_s = now_s - self._since_s, None
        return away_s
