"""The quick table is the one that rich draws, and is left to rich where it is not sure of that."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.table import Table

from agent.cli.boxed import boxed

HEADER = ("what", "where", "found", "")
ROWS = [("e_η(0)", "cell", "≤ 0.1 N·m, 3² – 5 °", "ok"), ("a longer line than these", "left arm", "", "refused")]
WIDEST = 71


def by_rich(title: str, rows: list[tuple[str, ...]]) -> list[str]:
    table = Table(title=title, title_justify="left")
    for column in HEADER:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console(file=(shown := io.StringIO()), width=200, color_system=None).print(table)
    return [line.rstrip() for line in shown.getvalue().splitlines()]


def test_a_table_is_the_one_that_rich_draws() -> None:
    drawn = boxed("paper  0123", HEADER, ROWS)
    assert drawn is not None
    assert drawn.splitlines() == by_rich("paper  0123", ROWS)
    assert len(drawn.splitlines()[1]) == WIDEST


@pytest.mark.parametrize("cell", ["two\nlines", "鏡", "e\u0301", "\x1b[1mbold", "\u200bnothing", "━", "\u05b0"])
def test_what_may_be_wider_or_narrower_is_left_to_rich(cell: str) -> None:
    assert boxed("paper", HEADER, [("a", "b", cell, "ok")]) is None
    assert boxed(cell, HEADER, ROWS) is None


def test_no_table_is_too_wide_to_be_drawn() -> None:
    """Where nobody looks, a finding is one line, however long."""
    drawn = boxed("p" * 2000, HEADER, [("a", "b", "c" * 1000, "ok")])
    assert drawn is not None
    assert f"│ a    │ b     │ {'c' * 1000} │ ok │" in drawn.splitlines()
