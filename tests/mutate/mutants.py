"""Every one-line change to a module: generated from its syntax tree, or written by hand as text."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import SequenceMatcher
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from tests.mutate.by_hand import BY_HAND
from tests.mutate.edits import Edit, edits

SHOWN = 160  # characters of a statement
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Mutant:
    """One change.  `key` stays the same when lines move: it is what lists of equivalent changes name."""

    module: str
    where: str  # function or method as a qualified name, or the class or "" for what runs at import
    before: str  # first line of the statement
    after: str
    line: int
    end: int  # of a compound statement's head, or of the statement
    tree: ast.Module
    edit: Edit | None  # None: `tree` is changed already
    in_function: bool  # the change lies in a body, so that running code can be exchanged without importing again

    @property
    def key(self) -> tuple[str, str, str]:
        """Where, and what became of the statement."""
        return self.where, self.before, self.after

    @property
    def text(self) -> str:
        """One line for a person; of a long statement what is around the change."""
        before, after = self.before, self.after
        if max(len(before), len(after)) > SHOWN:
            changed = SequenceMatcher(None, before, after, autojunk=False).get_opcodes()
            _, from_, to, other_from, other_to = next(code for code in changed if code[0] != "equal")
            around = SHOWN // 4
            before = f"…{before[max(0, from_ - around) : to + around]}…"
            after = f"…{after[max(0, other_from - around) : other_to + around]}…"
        return f"{self.module}:{self.line} {self.where or 'module'}: {before}  →  {after}"

    def code(self) -> CodeType:
        """The changed module, compiled under its own name; the tree stays changed."""
        if self.edit is not None:
            self.edit.make()
        return compile(ast.fix_missing_locations(self.tree), str(source_of(self.module)), "exec", dont_inherit=True)


def source_of(module: str) -> Path:
    """File of a module, found without running it."""
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(module)
    return Path(spec.origin)


def generated(module: str) -> list[Mutant]:
    """All changes to a module, in the order of its lines; the same text twice in one function is numbered."""
    tree = ast.parse(source_of(module).read_text())
    names = vars(import_module(module))
    seen: Counter[tuple[str, str, str]] = Counter()
    found = []
    for place in _places(tree, "", None, in_function=False):
        for edit in edits(place.node, names):
            line, end = _lines(place.statement_of(edit))
            before = _first_line(place.statement_of(edit))
            with edit.made():
                after = _first_line(place.statement_of(edit))
            key = (place.where, before, after)
            seen[key] += 1
            if seen[key] > 1:
                after = f"{after}  ({seen[key]})"
            found.append(Mutant(module, place.where, before, after, line, end, tree, edit, place.in_function))
    return sorted(found, key=lambda m: m.line)


def written(module: str) -> list[Mutant]:
    """The changes of `by_hand.py`.  Raises ValueError for one whose text does not stand in the module exactly once."""
    text = source_of(module).read_text()
    found = []
    for before, after in BY_HAND.get(module, ()):
        if text.count(before) != 1:
            raise ValueError(f"{module}: {before!r} stands there {text.count(before)} times, not once")
        line = text[: text.index(before)].count("\n") + 1
        tree = ast.parse(text.replace(before, after))
        flat = [" ".join(part.split()) for part in (before, after)]
        found.append(
            Mutant(module, "by hand", flat[0], flat[1] or "nothing", line, line, tree, None, in_function=False)
        )
    return found


@dataclass(frozen=True)
class _Place:
    node: ast.AST
    statement: ast.stmt | None  # the innermost one around the node
    where: str
    in_function: bool

    def statement_of(self, edit: Edit) -> ast.AST:
        """The statement that the edit changes: for a dropped one the statement itself."""
        if edit.field in ("body", "orelse", "finalbody") and edit.index is not None:
            found: ast.AST = getattr(edit.node, edit.field)[edit.index]
            return found
        return self.statement or edit.node


def _places(node: ast.AST, where: str, statement: ast.stmt | None, *, in_function: bool) -> Iterator[_Place]:
    """Nodes that may be changed: no annotations, no texts, no docstrings, no `strict` of a zip: an assertion."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg == "strict"):
        return
    if isinstance(node, ast.stmt):
        statement = node
    if isinstance(node, (*_FUNCTIONS, ast.ClassDef)) and not in_function:
        where = f"{where}.{node.name}".lstrip(".")
    yield _Place(node, statement, where, in_function or isinstance(node, _FUNCTIONS))
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "type_params", "decorator_list", "bases"):
            continue
        inside = in_function or (isinstance(node, _FUNCTIONS) and field == "body")
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, ast.AST):
                yield from _places(part, where, statement, in_function=inside)


def _lines(node: ast.AST) -> tuple[int, int]:
    """First and last line; of a compound statement those of its head."""
    first, body = getattr(node, "lineno", 0), getattr(node, "body", None)
    last = body[0].lineno - 1 if isinstance(body, list) else getattr(node, "end_lineno", first)
    return first, max(first, last)


def _first_line(node: ast.AST) -> str:
    """The head of a statement, in one line."""
    if isinstance(node, (ast.If, ast.While, ast.For, ast.With, ast.Try, ast.ClassDef, *_FUNCTIONS)):
        head = ast.unparse(node)
        return head.splitlines()[0] if not isinstance(node, ast.Try) else "try … " + _handlers(node)
    return " ".join(ast.unparse(node).split())


def _handlers(node: ast.Try) -> str:
    return ", ".join(f"except {ast.unparse(h.type)}" for h in node.handlers if h.type is not None)


# --- into the running interpreter ------------------------------------------------------------------------------------


def exchange(mutant: Mutant) -> bool:
    """Give the running function the changed body, for all who hold it.  False when only a fresh import can do it."""
    target = _function(vars(import_module(mutant.module)), mutant.where) if mutant.in_function else None
    if target is None:
        return False
    wanted = target.__code__
    for code in _codes(mutant.code()):
        if (code.co_qualname, code.co_firstlineno) == (wanted.co_qualname, wanted.co_firstlineno):
            if code.co_freevars != wanted.co_freevars:
                return False
            target.__code__ = code
            return True
    return False


def _function(names: Mapping[str, Any], where: str) -> FunctionType | None:
    """The function of this qualified name, out of what decorators made of it."""
    *classes, name = where.split(".")
    for part in classes:
        names = vars(names[part])
    found = names[name]
    for attribute in ("fget", "func", "__func__"):
        found = getattr(found, attribute, found)
    while hasattr(found, "__wrapped__"):
        found = found.__wrapped__
    return found if isinstance(found, FunctionType) else None


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)
