"""The table of exit codes in docs/install.md against what the code returns."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.faults.page import refusals
from tests.support.documents import ROOT


def literal_exits(folder: Path) -> set[int]:
    """Every number that a module of this folder gives to `Exit(...)` or `exit(...)`."""
    numbers = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in ("Exit", "exit")
            ):
                numbers |= {each.value for each in node.args if isinstance(each, ast.Constant)}
    return numbers


def table() -> set[int]:
    """The first column of the table."""
    text = (ROOT / "docs/commands.md").read_text()
    _, _, rest = text.partition("| code | means |\n")
    assert rest
    rows = rest[: rest.index("\n\n")].splitlines()[1:]
    return {int(number) for row in rows if (number := re.match(r"\| (\d+) \| \S", row)[1])}  # type: ignore[index]


def test_the_table_has_every_exit_code_and_no_other() -> None:
    kinds = {kind.exit_code for kind in refusals()}
    assert {2, 3, 4, 5, 7, 8} <= kinds
    assert table() == kinds | literal_exits(ROOT / "agent/cli") | {0}
