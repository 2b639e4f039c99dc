"""Tells that something is waited for, once that has lasted."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

_SAY_AFTER_S: Final = 2.0  # of waiting: processes that start together need not be told of each other


class Patience:
    """Tells somebody, once, that something has been waited for for a while."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._since_s = time.monotonic()
        self._told = False

    def waiting(self, still: bool) -> None:
        """Called again and again."""
        if still and not self._told and time.monotonic() - self._since_s > _SAY_AFTER_S:
            self._told = True
            self._tell()
