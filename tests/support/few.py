"""Cases that state the same: some of them in `make test`, all of them in `make long`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def few(cases: Iterable[Any], kept: Callable[[Any], bool]) -> list[Any]:
    """Parameters of a test, of which only those that are `kept` are in `make test`; a tuple is several of them."""
    return [case if kept(case) else long(case) for case in cases]


def long(case: Any) -> Any:
    """The parameters of a case that is in `make long` alone."""
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)
