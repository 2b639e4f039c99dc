"""What can be changed in one place of a syntax tree: comparisons, signs, numbers, flags, conditions, statements.

A change is one assignment to one field of one node, so it can be made, printed and taken back.
"""

from __future__ import annotations

import ast
import enum
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

BOUNDARY: Mapping[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
}  # fmt: skip
OPPOSITE: Mapping[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS: Mapping[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.FloorDiv,), ast.Pow: (ast.Mult,),
    ast.LShift: (ast.RShift,), ast.RShift: (ast.LShift,),
    ast.BitOr: (ast.BitAnd,), ast.BitAnd: (ast.BitOr,), ast.BitXor: (ast.BitOr,),
}  # fmt: skip
OTHER_CALL = {"min": "max", "max": "min", "any": "all", "all": "any"}
LARGE = 16  # a larger whole number is a size or a rate rather than a count, and is doubled and halved
DROPPED = (ast.Assign, ast.AugAssign, ast.Expr, ast.Raise, ast.Return, ast.Break, ast.Continue, ast.Delete)


@dataclass(frozen=True)
class Edit:
    """One field of one node, and what it becomes; index: of the item when the field is a list."""

    node: ast.AST
    field: str
    index: int | None
    new: Any

    @contextmanager
    def made(self) -> Iterator[None]:
        """The tree with this change, for as long as the block lasts."""
        old = self._swap(self.new)
        try:
            yield
        finally:
            self._swap(old)

    def make(self) -> None:
        """Change the tree for good."""
        self._swap(self.new)

    def _swap(self, value: Any) -> Any:
        if self.index is None:
            old = getattr(self.node, self.field)
            setattr(self.node, self.field, value)
        else:
            items = getattr(self.node, self.field)
            old, items[self.index] = items[self.index], value
        return old


def edits(node: ast.AST, names: Mapping[str, Any]) -> Iterator[Edit]:
    """Everything that is done to this node itself.  names: what the module's globals hold, to know its enums."""
    match node:
        case ast.Compare(ops=[present]):
            for table in (BOUNDARY, OPPOSITE):
                if type(present) in table:
                    yield Edit(node, "ops", 0, table[type(present)]())
        case ast.BinOp(op=present) | ast.AugAssign(op=present):
            for operator in OPERATORS.get(type(present), ()):
                yield Edit(node, "op", None, operator())
        case ast.BoolOp(op=present, values=values):
            yield Edit(node, "op", None, ast.Or() if isinstance(present, ast.And) else ast.And())
            for i in range(len(values)):
                yield Edit(node, "values", i, ast.Constant(isinstance(present, ast.And)))  # the condition is dropped
        case ast.Constant(value=value):
            yield from (Edit(node, "value", None, other) for other in _other_values(value))
        case ast.Attribute(value=ast.Name(id=name), attr=attr) if isinstance(names.get(name), enum.EnumMeta):
            if (other := _next_member(names[name], attr)) is not None:
                yield Edit(node, "attr", None, other)
        case ast.Name(id=name, ctx=ast.Load()) if name in OTHER_CALL:
            yield Edit(node, "id", None, OTHER_CALL[name])
        case ast.If() | ast.IfExp():
            for value in (True, False):
                yield Edit(node, "test", None, ast.Constant(value))
        case ast.While(test=test) if not isinstance(test, ast.Constant):
            yield Edit(node, "test", None, ast.Constant(False))
        case ast.comprehension(ifs=ifs):
            for i in range(len(ifs)):
                yield Edit(node, "ifs", i, ast.Constant(True))
        case ast.ExceptHandler(type=ast.expr()):
            yield Edit(node, "type", None, ast.Tuple([], ast.Load()))  # nothing is caught
    yield from _without_operand(node)
    yield from _without_statement(node)


def _other_values(value: Any) -> tuple[Any, ...]:
    match value:
        case bool():
            return (not value,)
        case int() if value > LARGE:
            return 2 * value, value // 2
        case int():
            return (value + 1, value - 1) if value > 1 else (value + 1,)
        case float():
            return (2.0 * value,) if value else (1.0,)
    return ()


def _next_member(members: enum.EnumMeta, name: str) -> str | None:
    """The member that stands in for this one; NONE for a flag would be a dropped flag, which is another change."""
    all_names = [m for m in members.__members__ if m != "NONE"]
    return all_names[(all_names.index(name) + 1) % len(all_names)] if name in all_names else None


def _without_operand(node: ast.AST) -> Iterator[Edit]:
    """Signs, `not` and `abs` dropped wherever they stand as a part of this node."""
    for field, value in ast.iter_fields(node):
        for index, part in enumerate(value) if isinstance(value, list) else [(None, value)]:
            match part:
                case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
                    yield Edit(node, field, index, operand)
                case ast.Call(func=ast.Name(id="abs"), args=[operand]):
                    yield Edit(node, field, index, operand)


def _without_statement(node: ast.AST) -> Iterator[Edit]:
    if isinstance(node, (ast.Module, ast.ClassDef)):
        return  # what is missing there is missed at once
    for field in ("body", "orelse", "finalbody"):
        part = getattr(node, field, None)
        for i, statement in enumerate(part if isinstance(part, list) else ()):
            if isinstance(statement, DROPPED) and not _says_nothing(statement):
                yield Edit(node, field, i, ast.Pass())


def _says_nothing(statement: ast.stmt) -> bool:
    """A docstring or `...`."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
