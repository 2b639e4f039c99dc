"""Every key of a cell file: unit, range, default and what it changes, from the schema; as JSON Schema and as a page.

What a key changes stands below its field in agent.config.schema and is read from there, so it has one home; nothing
else reads it, so that it costs no process anything at its start.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pydantic import BaseModel

from agent.config.schema.cell import CellFile

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
UNITS: Final = {
    "_kg_m2": "kg·m²", "_N_s_per_m": "N·s/m", "_Nm_s_per_rad": "N·m·s/rad", "_Nm_per_rad": "N·m/rad",
    "_m_per_s2": "m/s²", "_rad_per_s": "rad/s", "_m_per_s": "m/s", "_N_per_m": "N/m", "_N_Nm": "N, N·m",
    "_per_s": "1/s", "_C": "°C", "_V": "V", "_Nm": "N·m", "_kg": "kg", "_hz": "Hz", "_rad": "rad",
    "_m": "m", "_s": "s", "_N": "N",
}  # fmt: skip
UNSAID: Final = {"baud": "bit/s"} | dict.fromkeys(("xx", "yy", "zz", "xy", "xz", "yz"), "kg·m²")  # not in the name


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a cell file."""

    table: str  # its header without brackets; "" at the top
    name: str
    unit: str  # "" where there is none
    kind: str  # what may stand there, with its range
    default: str  # as TOML; "needed" where it must stand, "none" where leaving it out means nothing
    text: str  # what it changes


@functools.cache
def json_schema() -> dict[str, Any]:
    """JSON Schema of a cell file, each key with unit and what it changes; TOML has no null, so none is allowed."""
    schema = CellFile.model_json_schema()
    models = {model.__name__: model for model in _models(CellFile)}
    tables = {"CellFile": schema, **schema["$defs"]}
    for name, table in tables.items():
        model = models.get(name)
        for key, entry in table.get("properties", {}).items():
            texts = {} if model is None else _texts(model)
            unit = unit_of(key)
            entry["description"] = texts.get(key, "") + (f"  [{unit}]" if unit else "")
    tidy: dict[str, Any] = _tidy(schema)
    return {"$schema": DIALECT, **tidy, "title": "Cell file of widowx-coop"}


def all_keys() -> list[Key]:
    """All keys, table by table, in the order of the schema."""
    return list(_keys(CellFile, "", False))


def unit_of(name: str) -> str:
    """Unit that a key carries in its name; empty where it has none."""
    return UNSAID.get(name) or next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")


def page() -> str:
    """docs/cell.md: a table of keys for each table of the file."""
    lines = [
        "# Every key of a cell file", "",
        "Written by `coop schema --page`; a test holds it against the schema. An editor that reads JSON Schema for",
        "TOML checks and completes a cell file whose first line is `#:schema cell.schema.json`, with",
        "`coop schema > cell.schema.json` beside it; the cells that ship name the one in `configs/`. What is *needed*",
        "must stand; *none* may be left out and then means what its text says. Quaternions are w x y z.",
    ]  # fmt: skip
    table = None
    for key in all_keys():
        if key.table != table:
            table = key.table
            lines += ["", f"## {'At the top' if not table else f'`{table}`'}", ""]
            lines += ["| key | unit | may be | default | what it changes |", "|---|---|---|---|---|"]
        cells = (f"`{key.name}`", key.unit, key.kind, key.default, key.text)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _models(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for info in model.model_fields.values():
        for inner in _inside(info.annotation):
            yield from _models(inner)


def _inside(annotation: Any) -> list[type[BaseModel]]:
    """Models named in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in getattr(annotation, "__args__", ()) for model in _inside(inner)]


@functools.cache
def _texts(model: type[BaseModel]) -> Mapping[str, str]:
    """What stands below the fields of a model and of those that it is made from."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, BaseModel) and base.__module__.startswith("agent.config.schema"):
            found |= _below(base.__module__).get(base.__name__, {})
    return found


@functools.cache
def _below(module: str) -> Mapping[str, Mapping[str, str]]:
    """Of each class of a module, the text below each field."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    return {node.name: dict(_documented(node.body)) for node in classes}


def _documented(body: Sequence[ast.stmt]) -> Iterator[tuple[str, str]]:
    for field, below in itertools.pairwise(body):
        named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        text = below.value.value if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) else None
        if named and isinstance(text, str):
            yield field.target.id, inspect.cleandoc(text)  # type: ignore[attr-defined]


def _keys(model: type[BaseModel], table: str, many: bool) -> Iterator[Key]:
    header = f"[[{table}]]" if many else f"[{table}]" if table else ""
    entries = json_schema() if model is CellFile else json_schema()["$defs"][model.__name__]
    for name in model.model_fields:
        entry, required = entries["properties"][name], name in entries.get("required", ())
        default = "needed" if required else _default(entry)
        yield Key(header, name, unit_of(name), _kind(entry), default, _texts(model).get(name, ""))
    for name, info in model.model_fields.items():
        inner, where = _inside(info.annotation), f"{table}.{name}" if table else name
        repeated = entries["properties"][name].get("type") == "array"
        for one in inner:
            place = f"{where}.NAME" if _by_name(entries["properties"][name]) is not None else where
            kinds = one.model_fields.get("kind")
            several = len(inner) > 1 and kinds is not None
            yield from _keys_of(one, place, repeated, str(kinds.annotation.__args__[0]) if several else "")  # type: ignore[union-attr]


def _keys_of(model: type[BaseModel], table: str, many: bool, kind: str) -> Iterator[Key]:
    for key in _keys(model, table, many):
        yield Key(
            f"{key.table}, kind {kind}" if kind else key.table, key.name, key.unit, key.kind, key.default, key.text
        )


def _default(entry: Mapping[str, Any]) -> str:
    value = entry.get("default")
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, dict):
        return "as below"
    return f"`{json.dumps(float(f'{value:.6g}') if isinstance(value, float) else value)}`"


def _kind(entry: Mapping[str, Any]) -> str:
    """What may stand there, in words."""
    if "$ref" in entry:
        entry = json_schema()["$defs"][entry["$ref"].rsplit("/", 1)[1]]
        return " or ".join(f'`"{x}"`' for x in entry["enum"]) if "enum" in entry else "a table"
    if "oneOf" in entry:
        return "a table, by its `kind`"
    if "anyOf" in entry:
        return " or ".join(_kind(option) for option in entry["anyOf"])
    if "const" in entry:
        return f'`"{entry["const"]}"`'
    if entry.get("type") == "array":
        return _array(entry)
    if entry.get("type") == "object":
        inner = _by_name(entry)
        return f"by name, {_kind(inner)}" if isinstance(inner, dict) else "a table"
    names = {"number": "number", "integer": "whole number", "boolean": "`true` or `false`", "string": "text"}
    return " ".join([names[str(entry["type"])], *_range(entry)])


def _by_name(entry: Mapping[str, Any]) -> Any:
    """What stands under each name of a table whose keys are names; None of any other."""
    patterns = list(entry.get("patternProperties", {}).values())
    return patterns[0] if patterns else entry.get("additionalProperties")


def _array(entry: Mapping[str, Any]) -> str:
    low, high, items = entry.get("minItems"), entry.get("maxItems"), entry.get("items")
    count = f"{low} of" if low == high and low is not None else f"{low} to {high} of" if high else "list of"
    if isinstance(items, dict):
        return f"{count}: {_kind(items)}"
    return "list of: " + ", ".join(_kind(item) for item in entry.get("prefixItems", ()))


def _range(entry: Mapping[str, Any]) -> Iterator[str]:
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    yield from (f"{sign} {entry[key]:g}" for key, sign in signs.items() if key in entry)
    if "pattern" in entry:
        yield f"like `{entry['pattern']}`"


def _tidy(node: Any) -> Any:
    """Without null, made-up titles, and the three equal entries of a vector said once."""
    if isinstance(node, list):
        return [_tidy(item) for item in node]
    if not isinstance(node, dict):
        return node
    node = {key: _tidy(value) for key, value in node.items() if key != "title" or not isinstance(value, str)}
    if node.get("default", "") is None:
        del node["default"]
    options = [option for option in node.get("anyOf", ()) if option != {"type": "null"}]
    if "anyOf" in node:
        node["anyOf"] = options
        if len(options) == 1:
            del node["anyOf"]
            node = {**options[0], **node}
    items = node.get("prefixItems")
    if items and all(item == items[0] for item in items):
        del node["prefixItems"]
        node["items"] = items[0]
    return node
