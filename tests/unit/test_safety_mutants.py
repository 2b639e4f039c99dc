"""Mutation check of agent.safety.limit: every changed comparison, operator, name, flag, condition or missing
statement must be noticed by the examples of test_safety.  So every statement and both ways of every branch run.
"""

from __future__ import annotations

import ast
import copy
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from agent import safety
from agent.safety import Limits
from tests.unit.test_safety import EXAMPLES

TREE = ast.parse(inspect.getsource(safety.limit))
COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
OPERATORS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.BitOr: (ast.BitAnd, ast.BitXor),
}
EQUIVALENT = (
    *("if wanted > last + step", "elif wanted < last - step"),  # `allowed` is `wanted` there
    *("flags ^= _RATE_LIMITED", "flags ^= _SATURATED"),  # set once: there is nothing to flip back
)
NUMBERS = ("wanted", "last", "bound", "step")
FLAGS = ("_NONE", "_NOT_FINITE", "_SATURATED", "_RATE_LIMITED")
Change = Callable[[Any], None]


def changes(node: Any) -> Iterator[tuple[str, Change]]:
    """What can be done to one node: a label, and a function that does it."""
    match node:
        case ast.Compare(ops=[present]):
            for op in COMPARISONS:
                if not isinstance(present, op):
                    yield op.__name__, lambda n, op=op: n.ops.__setitem__(0, op())
        case ast.BinOp(op=present) | ast.AugAssign(op=present):
            for op in OPERATORS[type(present)]:
                yield op.__name__, lambda n, op=op: setattr(n, "op", op())
        case ast.UnaryOp(op=ast.USub()):
            yield "no sign", lambda n: setattr(n, "op", ast.UAdd())
        case ast.Constant(value=bool(value)):
            yield f"{value} negated", lambda n: setattr(n, "value", not n.value)
        case ast.Name(id=name, ctx=ast.Load()) if name in (*NUMBERS, "allowed"):
            for other in NUMBERS:
                if other != name:
                    yield f"{name} is {other}", lambda n, other=other: setattr(n, "id", other)
        case ast.Name(id=name, ctx=ast.Load()) if name in FLAGS:
            for other in FLAGS:
                if other != name:
                    yield f"{name} is {other}", lambda n, other=other: setattr(n, "id", other)
        case ast.Module():
            return
        case ast.If():
            for value in (True, False):
                yield f"always {value}", lambda n, value=value: setattr(n, "test", ast.Constant(value))
    for part in ("body", "orelse"):
        for i, statement in enumerate(getattr(node, part, [])):
            if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):  # a docstring
                yield f"no {part}[{i}]", lambda n, part=part, i=i: getattr(n, part).__setitem__(i, ast.Pass())


def mutants() -> Iterator[tuple[str, int, Change]]:
    """Every mutant, one change each: a label, which node of the walk, and what is done to it."""
    for index, node in enumerate(ast.walk(TREE)):
        for label, change in changes(node):
            yield f"line {node.lineno}: {label}", index, change


def mutant(index: int, change: Change) -> ast.Module:
    """The function with that change."""
    tree = copy.deepcopy(TREE)
    change(list(ast.walk(tree))[index])
    return ast.fix_missing_locations(tree)


def function_of(tree: ast.Module) -> Callable[..., Any]:
    namespace = dict(vars(safety))
    exec(compile(tree, "mutant", "exec"), namespace)
    limit: Callable[..., Any] = namespace["limit"]
    return limit


def unnoticed(limit: Callable[..., Any]) -> bool:
    """Whether the examples see no difference from what limit must do."""
    try:
        for wanted, last, bound, step, torque, flags in EXAMPLES:
            # the same joint twice: a flag that is set must stay set
            found = limit([wanted, wanted], [last, last], Limits((bound, bound), (step, step)))
            if found != ([torque, torque], flags):
                return False
    except (TypeError, NameError):  # a missing statement left no number or no name
        return False
    return refuses_wrong_length(limit)


def refuses_wrong_length(limit: Callable[..., Any]) -> bool:
    try:
        limit([0.0], [0.0, 0.0], Limits((1.0,), (1.0,)))
    except ValueError:
        return True
    return False


MUTANTS = list(mutants())


def test_the_original_passes_the_examples() -> None:
    assert unnoticed(safety.limit)
    assert unnoticed(function_of(TREE))


@pytest.mark.parametrize(("index", "change"), [m[1:] for m in MUTANTS], ids=[label for label, *_ in MUTANTS])
@pytest.mark.fault("M2")
def test_mutant_is_noticed(index: int, change: Change) -> None:
    tree = mutant(index, change)
    text = ast.unparse(tree)
    assert unnoticed(function_of(tree)) == any(same in text for same in EQUIVALENT), text


def test_there_are_mutants_of_every_kind() -> None:
    kinds = {label.split(": ")[1].split()[0] for label, *_ in MUTANTS}
    assert {"Sub", "Add", "BitAnd", "Lt", "GtE", "no", "wanted", "_SATURATED", "always", "True"} <= kinds
