"""Makes docs/failures.md of the list of faults, the meanings and the code; `python -m tests.faults.page` writes it."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

import agent
import drivers
import sim_backend
from agent.atomic import write_atomically
from agent.faults.catalogue import Group, Row, rows
from agent.faults.plan import NAMES, POSSIBLE
from agent.modes import Mode
from agent.safety import Flag
from drivers.dynamixel.errors import FaultCause
from drivers.dynamixel.events import EventKind
from drivers.interface import Refusal

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs/failures.md"
HEAD: Final = Path(__file__).with_name("page_head.md")
PROCEDURE: Final = Path(__file__).with_name("page_procedure.md")
MEANINGS: Final = Path(__file__).with_name("meanings.toml")
TELLERS: Final = ("event", "_say", "warn", "Event", "TextEvent")  # who tells an event, its text among the arguments

PASSED_ON: Final = {  # modules that are given a teller, and what it is called there
    "agent/monitors/watch.py": "_tell", "agent/process/rehearse.py": "_tell",
}  # fmt: skip

Meaning = Mapping[str, str]


def meanings() -> Mapping[str, Mapping[str, Meaning]]:
    """By kind and name: means, cause, remedy."""
    return tomllib.loads(MEANINGS.read_text("utf-8"))


def refusals() -> list[type[Refusal]]:
    """Every kind of refusal that any of our modules defines, by exit code and name."""
    for package in (agent, drivers, sim_backend):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    found, todo = set(), {Refusal}
    while todo:
        kind = todo.pop()
        found.add(kind)
        todo |= set(kind.__subclasses__())
    ours = (kind for kind in found if kind.__module__.split(".")[0] in ("agent", "drivers", "sim_backend"))
    return sorted(ours, key=lambda kind: (kind.exit_code, kind.__name__))


def names() -> Mapping[str, set[str]]:
    """What the code has, by the kinds of `meanings` that are enumerations."""
    return {
        "mode": set(Mode.__members__),
        "flag": {str(flag.name) for flag in Flag},
        "driver_event": set(EventKind.__members__),
        "servo_fault": set(FaultCause.__members__),
    }


def told() -> set[str]:
    """How the texts of events begin that our processes tell: all of a text, or what stands before the first value.

    A text that begins with a value: how it ends, behind "…".
    """
    found: set[str] = set()
    for path in sorted((ROOT / "agent").rglob("*.py")):
        text = path.read_text()
        passed_on = PASSED_ON.get(str(path.relative_to(ROOT)))
        if not passed_on and not any(f"{word}(" in text for word in TELLERS) and "Level." not in text:
            continue
        tree = ast.parse(text)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and (_name(node.func) in (*TELLERS, passed_on) or _has_level(node)):
                found |= {text for each in node.args for text in _texts(tree, each, frozenset()) if text}
    return found


def _has_level(call: ast.Call) -> bool:
    """Whether it is given how bad something is, as those are who pass an event on."""
    return any(ast.unparse(each).startswith("Level.") for each in call.args)


def _texts(tree: ast.Module, node: ast.expr, names: frozenset[str]) -> Iterator[str]:
    """What may be told by an argument of this module; names: variables that are looked up already."""
    if isinstance(node, ast.Name) and node.id not in names:
        for where, value in _assigned(tree, node.id):
            yield from _texts(where, value, names | {node.id})
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):  # "...".strip(), {...}.get(mode)
        yield from _texts(tree, node.func.value, names)
    elif isinstance(node, ast.Dict):
        for value in node.values:
            yield from _texts(tree, value, names)
    elif isinstance(node, ast.JoinedStr):
        parts = [str(each.value) if isinstance(each, ast.Constant) else "" for each in node.values]
        yield parts[0] or (f"…{parts[-1]}" if parts[-1] else "")
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value


def _assigned(tree: ast.Module, name: str) -> Iterator[tuple[ast.Module, ast.expr]]:
    """What a module gives to the variable, or the module of ours that it has the name from, and which of them."""
    for each in ast.walk(tree):
        if isinstance(each, ast.Assign) and any(isinstance(t, ast.Name) and t.id == name for t in each.targets):
            yield tree, each.value
        elif isinstance(each, ast.ImportFrom) and any(alias.name == name for alias in each.names):
            source = ROOT / f"{(each.module or '').replace('.', '/')}.py"
            if source.is_file():
                yield from _assigned(ast.parse(source.read_text()), name)


def _name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def page() -> str:
    """The whole page."""
    return "\n".join([HEAD.read_text("utf-8"), *_faults(), *_reference(), PROCEDURE.read_text("utf-8")])


def _faults() -> Iterator[str]:
    yield "## What happens when\n"
    yield (
        "Bounds are on virtual time, real drivers and loops on emulated servos; `make faults` measures all of them\n"
        "and says which are missed. *Shown by*: the faults of its runs, the first of which `coop faults inject CELL\n"
        "ID` repeats; or tests. Faults of telemetry and recorder it carries out on processes.\n"
    )
    for group in Group:
        yield f"### {group.value.capitalize()}\n"
        own = [row for row in rows() if row.group is group]
        yield _table(("id", "what fails", "what must happen", "bound", "shown by"), map(_row, own))
    yield "### What can be made to fail\n"
    yield "`coop faults inject CELL FAULT --arm NAME --at T` knows (telemetry has `--arm plant`, too):\n"
    known = zip(NAMES, POSSIBLE.values(), strict=True)
    lines = ((f"`{name}`", p.text, f"{p.size:g} {p.unit}" if p.unit else "") for name, p in known)
    yield _table(("fault", "what happens", "size"), lines)


def _row(row: Row) -> tuple[str, ...]:
    each = [*(fault for run in row.runs for fault in run.faults), *row.faults]
    faults = dict.fromkeys(f"`{fault.fault}`" for fault in each)
    shown = [
        *faults,
        *(["settings"] if any(not run.faults for run in row.runs) else []),
        *(["tests"] if row.tests else []),
    ]
    must = row.must + (f"; never {row.never}" if row.never else "")
    return row.id, row.fails, must, row.bounds or "-", ", ".join(shown) or f"nothing: {row.untested}"


def _reference() -> Iterator[str]:
    known = meanings()
    yield "## Reference\n"
    for kind, title in (
        ("exit_code", "Exit codes"),
        ("mode", "Modes"),
        ("flag", "Flags of a cycle (`safety: ...`)"),
        ("event", "Events, by how their text begins, or behind … ends"),
        ("driver_event", "Events of the servo bus"),
        ("servo_fault", "Servo faults"),
    ):
        yield f"### {title}\n"
        yield _table(
            ("", "means", "cause", "what to do"),
            ((_shown(kind, name), m["means"], m["cause"], m["remedy"]) for name, m in known[kind].items()),
        )
    yield "What each monitor watches, and its bounds: [monitors.md](monitors.md).\n"
    yield "### Refusals\n"
    yield "A refusal is one line: what, found, expected, and after the semicolon what to do. By exit code:\n"
    yield _table(
        ("exit code", "refusal", "means"), ((str(k.exit_code), f"`{k.__name__}`", _first(k)) for k in refusals())
    )


def _shown(kind: str, name: str) -> str:
    if kind == "driver_event":
        return f"{EventKind[name].value}"
    if kind == "servo_fault":
        return f"{FaultCause[name].value}"
    return f"`{name.strip()}`"


def _first(kind: type[Refusal]) -> str:
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def _table(heads: tuple[str, ...], lines: Iterable[tuple[str, ...]]) -> str:
    body = "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)
    return "| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|\n" + body


if __name__ == "__main__":
    write_atomically(PAGE, page().encode())
    sys.stdout.write(f"{PAGE}\n")
