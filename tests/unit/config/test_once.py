"""What follows from a cell is found once for it, and never for another cell."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from agent.config.cell import Cell, load_cell
from agent.config.once import once_per_cell


def test_it_is_found_once_for_each_cell_and_forgotten_with_it() -> None:
    asked: list[str] = []

    @once_per_cell
    def rate(cell: Cell) -> tuple[float]:
        asked.append(cell.file.name)
        return (cell.file.rate_hz,)

    slow, quick = (load_cell(Path("paper"), [f"rate_hz={hz}"]) for hz in (150.0, 200.0))
    assert rate(slow) == (150.0,)
    assert rate(quick) == (200.0,)
    assert rate(slow) is rate(slow)
    assert len(asked) == 2
    del slow
    gc.collect()
    assert [rate(load_cell(Path("paper"), [f"rate_hz={hz}"]))[0] for hz in (160.0, 170.0)] == [160.0, 170.0]


def test_what_it_raises_is_raised_again() -> None:
    asked: list[str] = []

    @once_per_cell
    def fails(cell: Cell) -> None:
        asked.append(cell.file.name)
        raise ValueError("not found")

    cell = load_cell(Path("paper"))
    for _ in range(2):
        with pytest.raises(ValueError, match="not found"):
            fails(cell)
    assert len(asked) == 2
