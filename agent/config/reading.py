"""TOML read and held against a schema; every refusal names key, value found, what is allowed and what to do."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

import configs
from agent.config.schema.types import MISFIT
from drivers.interface import Refusal

M = TypeVar("M", bound=BaseModel)


class ConfigError(Refusal):
    """A cell file or arm file says something that cannot be used."""


def read_file(path: Path) -> bytes:
    """Bytes of a file.  Raises ConfigError."""
    try:
        return path.read_bytes()
    except OSError as error:
        shipped = ", ".join(sorted(f"configs/cells/{p.name}" for p in configs.CELLS_DIR.glob("*.toml")))
        raise ConfigError(
            f"file {path}", found=error.strerror, expected="a readable file", remedy=f"cells that ship: {shipped}"
        ) from error


def parse(raw: bytes, path: Path) -> dict[str, Any]:
    """The tables of a TOML text.  Raises ConfigError with the line."""
    try:
        return tomllib.loads(raw.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path.name}", found=str(error), expected="TOML", remedy="correct that line") from error


def override(document: dict[str, Any], text: str) -> None:
    """Change one value of a parsed cell; text: "key.path=value", arms by their names.  Raises ConfigError."""
    key, separator, value = text.partition("=")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"] if separator else None
    except tomllib.TOMLDecodeError:
        parsed = value
    if parsed is None:
        raise ConfigError("override", found=repr(text), expected="key.path=value", remedy="e.g. duration_s=20")
    *parents, last = key.strip().split(".")
    node: Any = document
    for name in parents:
        if isinstance(node, list):
            node = next((x for x in node if isinstance(x, dict) and x.get("name") == name), None)
        else:
            node = node.setdefault(name, {})
        if not isinstance(node, (dict, list)):
            raise ConfigError("override", found=repr(key), expected="a table of the cell", remedy="see the cell file")
    node[last] = parsed


def validate(model: type[M], document: Mapping[str, Any], source: str) -> M:
    """The document as an object of `model`.  Raises ConfigError with the first thing that is wrong."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        # a misspelt key is both unknown and missing; the first of the two tells more
        problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
        first = problems[0]
        key = ".".join(str(part) for part in (*first["loc"], *_named(dict(first)))) or "the whole file"
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ConfigError(f"{key} in {source}{more}", **_explain(model, dict(first))) from error


def _named(problem: dict[str, Any]) -> list[str]:
    """The key that a validator of several values says is wrong."""
    return [problem["ctx"]["key"]] if problem["type"] == MISFIT else []


def _explain(model: type[BaseModel], problem: dict[str, Any]) -> dict[str, str]:
    """Found, expected and remedy of one pydantic problem."""
    kind, found = problem["type"], repr(problem["input"])
    if kind == MISFIT:
        return {part: problem["ctx"][part] for part in ("found", "expected", "remedy")}
    if kind == "missing":
        return {"found": "nothing", "expected": "a value", "remedy": "add the key"}
    if kind == "extra_forbidden":
        retired = _retired_at(model, problem["loc"][:-1]).get(str(problem["loc"][-1]))
        if retired is not None:
            return {"found": "a key of an earlier version", "expected": "keys of this one", "remedy": retired}
        known = _keys_at(model, problem["loc"][:-1])
        near = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1)
        remedy = f"did you mean {near[0]}?" if near else f"known keys: {', '.join(known)}"
        return {"found": "an unknown key", "expected": "only known keys", "remedy": remedy}
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if isinstance(problem["input"], dict):
        found = "not that"
    return {"found": found, "expected": message, "remedy": "correct the value and its unit (the key carries it)"}


def _keys_at(model: type[BaseModel], location: tuple[str | int, ...]) -> list[str]:
    """Keys allowed at a place in the file."""
    found = _model_at(model, location)
    return sorted(found.model_fields) if found is not None else []


def _retired_at(model: type[BaseModel], location: tuple[str | int, ...]) -> Mapping[str, str]:
    """Keys of earlier versions at a place in the file, and what to write instead."""
    return getattr(_model_at(model, location), "retired", {})


def _model_at(model: type[BaseModel], location: tuple[str | int, ...]) -> type[BaseModel] | None:
    """The model of the table at a place in the file, following nested models."""
    current: Any = model
    for part in location:
        if isinstance(part, int) or not (isinstance(current, type) and issubclass(current, BaseModel)):
            continue
        info = current.model_fields.get(part)
        if info is None:
            continue
        current = _model_in(info.annotation)
    return current if isinstance(current, type) and issubclass(current, BaseModel) else None


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None
