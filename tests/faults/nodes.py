"""Which tests are marked with which row of the list of faults; `python -m tests.faults.nodes` writes it down."""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from agent.atomic import write_atomically
from agent.faults.catalogue import NODES

ROOT = Path(__file__).parents[2]
HEAD = "# Written by `python -m tests.faults.nodes`: the tests marked with a row's id.\n"


def marked() -> dict[str, list[str]]:
    """Tests by the id they are marked with, in the order of their files."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        text = path.read_text()
        if "mark.fault(" not in text:
            continue
        name = str(path.relative_to(ROOT))
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                for one in _ids(node):
                    found[one].append(f"{name}::{node.name}")
    return found


def _ids(test: ast.FunctionDef) -> Iterator[str]:
    for decorator in test.decorator_list:
        if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "pytest.mark.fault":
            yield from (ast.literal_eval(each) for each in decorator.args)


def written(found: dict[str, list[str]]) -> str:
    """The content of the file."""

    def order(one: str) -> tuple[str, int]:
        return one[0], int(one[1:])

    lines = [f"{key} = [\n" + "".join(f'    "{n}",\n' for n in found[key]) + "]\n" for key in sorted(found, key=order)]
    return HEAD + "".join(lines)


if __name__ == "__main__":
    write_atomically(NODES, written(marked()).encode())
    sys.stdout.write(f"{NODES}\n")
