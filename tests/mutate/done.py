"""What earlier runs noticed, as lines of a file: a line counts while the module and the noticing test are the same.

Survivors are not kept, so a run that goes on tries them again.  A change to what a test imports is not seen here: the
figure that counts is that of a run that began with an empty file.
"""

from __future__ import annotations

import ast
import json
from functools import cache
from hashlib import sha256
from pathlib import Path

from tests.mutate.mutants import Mutant, source_of

ROOT = Path(__file__).parents[2]


class Done:
    """Verdicts in a file; None: nothing is kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        lines = path.read_text().splitlines() if path is not None and path.exists() else []
        self._tests: dict[str, str] = dict(map(json.loads, lines))

    def noticed_by(self, mutant: Mutant) -> str:
        """The test that noticed this change, or nothing."""
        state, _, test = self._tests.get(_name(mutant), "").partition(" ")
        return test if test and state == _state(mutant, test) else ""

    def keep(self, mutant: Mutant, test: str) -> None:
        """Append what a test noticed."""
        if self._path is not None and test:
            with self._path.open("a") as file:
                file.write(json.dumps([_name(mutant), f"{_state(mutant, test)} {test}"]) + "\n")


def _name(mutant: Mutant) -> str:
    return " | ".join((mutant.module, *mutant.key))


def _state(mutant: Mutant, test: str) -> str:
    return _hash(source_of(mutant.module).read_text()) + _hash(_text_of(test))


def _text_of(test: str) -> str:
    """Of the function; the whole file where it is none."""
    path, _, name = test.split(" ", maxsplit=1)[0].partition("::")
    names = _functions(ROOT / path)
    return names.get(name.split("[", maxsplit=1)[0], names[""])


@cache
def _functions(path: Path) -> dict[str, str]:
    text = path.read_text() if path.is_file() else ""
    lines = text.splitlines()
    found = {"": text}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            found[node.name] = "\n".join(lines[first - 1 : node.end_lineno])
    return found


@cache
def _hash(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:12]
