"""The picture of one result, drawn once for all tests that look at the files beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any

import pytest
from matplotlib.figure import Figure


@contextmanager
def drawn_once(module: str, figure: str) -> Iterator[None]:
    """Meanwhile what `module` draws of a result by its function `figure` is drawn and rendered the first time only."""
    there = import_module(module)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(there, figure, _of_each(getattr(there, figure)))
        patch.setattr(there, "save_png", cache(there.save_png))
        yield


def _of_each(draw: Callable[[Any], Figure]) -> Callable[[Any], Figure]:
    known: dict[int, tuple[Any, Figure]] = {}  # results, which have no hash, are kept with their ids

    def drawn(result: Any) -> Figure:
        if id(result) not in known:
            known[id(result)] = result, draw(result)
        return known[id(result)][1]

    return drawn
