"""TOML read and held against a schema; every refusal names key, value found, what is allowed and what to do.

What is read is a file of at most 16 MB; a device, a pipe or a folder is refused.
"""

from __future__ import annotations

import codecs
import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

import configs
from agent.config.schema.types import IN_WORDS, MISFIT, nearest
from agent.config.tables import tables
from drivers import named_file
from drivers.interface import Refusal, one_line

M = TypeVar("M", bound=BaseModel)
SCREENFUL: Final = 40  # lines of refusal
NO_SUCH_KIND, WITHOUT_KIND = "union_tag_invalid", "union_tag_not_found"  # as pydantic says it
_UTF_16 = "text in UTF-16", "save it as UTF-8"
NO_TEXT: Final = {  # how files begin that are often named for another: what they are, what to do
    b"\x89MCAP": ("a log (MCAP)", "name the cell's own file; `coop report` and others take logs"),
    b"\x1f\x8b": ("a file packed with gzip", "unpack it (`gunzip`)"),
    b"\x28\xb5\x2f\xfd": ("a file packed with zstd", "unpack it (`unzstd`)"),
    b"PK\x03\x04": ("a zip archive", "unpack it (`unzip`)"),
    b"\xff\xfe": _UTF_16,
    b"\xfe\xff": _UTF_16,
}
CHANGED: Final = " with the changes asked for"  # behind a file's name: what is wrong may not stand in it
SHOWN: Final = 120  # characters of a value in a refusal
_IS = re.compile(r"^(Value error, |Input should be )")
_IN_TOML: Final = {  # what pydantic misses, in words of TOML
    "bool_type": "true or false", "float_type": "a number", "int_type": "a whole number",
    "string_type": "text in quotes",
    "list_type": "a list", "tuple_type": "a list", "model_type": "a table", "model_attributes_type": "a table",
    "dict_type": "a table", "too_long": "at most {max_length} of them", "too_short": "at least {min_length} of them",
}  # fmt: skip
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class ConfigError(Refusal):
    """A cell file or arm file says something that cannot be used."""


class WrongKeys(ConfigError):
    """Several things are wrong: the first speaks for all where there is one line, `problems` has each."""

    def __init__(self, problems: Sequence[ConfigError]) -> None:
        first, others = problems[0], [problem.what for problem in problems[1:]]
        named = shown(", ".join(what.partition(" in ")[0] for what in others))
        super().__init__(
            f"{first.what} (and {len(others)} more: {named})",
            found=first.found, expected=first.expected, remedy=first.remedy,
        )  # fmt: skip
        self.problems = tuple(problems)

    @property
    def lines(self) -> list[str]:
        """One for each, up to a screenful."""
        more = len(self.problems) - SCREENFUL
        told = [line for problem in self.problems[:SCREENFUL] for line in problem.lines]
        return [*told, f"and {more} more"] if more > 0 else told


def refuse_all(problems: Sequence[ConfigError]) -> None:
    """Raise what is wrong, all of it at once and nothing twice; nothing where nothing is."""
    problems = list({str(problem): problem for problem in problems}.values())
    if len(problems) > 1:
        raise WrongKeys(problems)
    if problems:
        raise problems[0]


def read_file(path: Path, remedy: str = "") -> bytes:
    """Bytes of a file of text; remedy: of one that is not there, if it is no cell file.  Raises ConfigError."""
    try:
        named_file.size_of(path)
        _refuse_no_text(path)  # before its size: a log is named as one
        return named_file.read(path)
    except named_file.UnfitFile as error:
        raise ConfigError(error.what, found=error.found, expected=error.expected, remedy=error.remedy) from error
    except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigError(
            f"file {shown(str(path))}", found=reason, expected="a readable file",
            remedy=remedy or "cells that ship go by name: " + ", ".join(shipped_cells()),
        ) from error  # fmt: skip


def _refuse_no_text(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(max(map(len, NO_TEXT)))
    for begin, (found, remedy) in NO_TEXT.items():
        if head.startswith(begin):
            raise ConfigError(f"file {shown(str(path))}", found=found, expected="text in UTF-8", remedy=remedy)


def shipped_cells() -> list[str]:
    """Names of the cells that ship."""
    return sorted(path.stem for path in configs.CELLS_DIR.glob("*.toml"))


def parse(raw: bytes, path: Path) -> dict[str, Any]:
    """The tables of a TOML text.  Raises ConfigError with the line."""
    if raw.startswith(codecs.BOM_UTF8):
        raise ConfigError(
            path.name, found="a byte order mark before the first line", expected="TOML in UTF-8",
            remedy="save it as UTF-8 without BOM",
        )  # fmt: skip
    try:
        return tables(raw.decode())
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            path.name, found=f"a byte in line {line} that is no UTF-8 (0x{raw[error.start]:02x})",
            expected="TOML in UTF-8", remedy="save it as UTF-8, or name another file",
        ) from error  # fmt: skip
    except (ValueError, RecursionError) as error:  # not TOML, a number of thousands of digits, too deep
        raise ConfigError(
            path.name, found=shown(str(error)), expected="TOML in UTF-8", remedy="correct that line"
        ) from error


def override(document: dict[str, Any], text: str) -> list[str]:
    """Change one value of a parsed cell; text: "key.path=value", arms by their names; the path.  Raises ConfigError."""
    key, separator, value = text.partition("=")
    *parents, last = (part.strip() for part in key.split("."))
    if not separator or not all((*parents, last)):
        raise _not_an_override(text, "key.path=value", "e.g. duration_s=20")
    node: Any = document
    for name in parents:
        if isinstance(node, list):
            named = [x["name"] for x in node if isinstance(x, dict) and isinstance(x.get("name"), str)]
            if named and name not in named:
                raise _not_an_override(key, " or ".join(named), nearest(name, named) or "name one of these")
            if named.count(name) > 1:
                raise _not_an_override(key, f"one of {name} in the file", "give each entry a name of its own")
            node = next((x for x in node if isinstance(x, dict) and x.get("name") == name), None)
        else:
            node = node.setdefault(name, {})
        if not isinstance(node, (dict, list)):
            raise _not_an_override(key, "a table of the cell", "see the cell file")
    if not isinstance(node, dict):
        raise _not_an_override(key, f"a key of one of {'.'.join(parents)}", f"e.g. {'.'.join(parents)}.NAME.KEY=VALUE")
    node[last] = _value(value)
    return [*parents, last]


def _value(text: str) -> Any:
    """A TOML value; what is none is text."""
    try:
        document = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return document["value"] if len(document) == 1 else text


def _not_an_override(text: str, expected: str, remedy: str) -> ConfigError:
    return ConfigError("override", found=shown(repr(text)), expected=expected, remedy=remedy)


def validate(model: type[M], document: Mapping[str, Any], source: str) -> M:
    """The document as an object of `model`.  Raises ConfigError; of several things that are wrong, WrongKeys with all.

    What only shows when single values are right (shares that do not sum to 1) is looked at after them.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        problems = _without_misspelt(model, [dict(problem) for problem in error.errors()])
        every = [ConfigError(f"{_place(document, p)} in {source}", **_explain(model, p)) for p in problems]
        found = list({str(one): one for one in every}.values())  # a number that stands for three is wrong once
        raise (WrongKeys(found) if len(found) > 1 else found[0]) from error


def _without_misspelt(model: type[BaseModel], problems: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A misspelt key is both unknown and missing: the first tells all.  Unknown keys come first."""
    unknown = [p["loc"] for p in problems if p["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], _meant(model, loc)) for loc in unknown}
    told = [p for p in problems if p["type"] != "missing" or tuple(p["loc"]) not in meant]
    return sorted(told, key=lambda problem: problem["type"] != "extra_forbidden")


def _meant(model: type[BaseModel], location: Sequence[str | int]) -> str:
    """The key that an unknown one is most like; empty when there is none."""
    table = _model_at(model, location[:-1])
    near = difflib.get_close_matches(str(location[-1]), list(table.model_fields) if table is not None else [], n=1)
    return near[0] if near else ""


def shown(text: str, most: int = SHOWN) -> str:
    """One line of a text from a file, cut where it is longer than `most` characters."""
    line = one_line(text)
    return line if len(line) <= most else line[: most - 1] + "…"


def _place(document: Any, problem: dict[str, Any]) -> str:
    """Where in the file the problem is: keys, and the names of arms and joints instead of their numbers."""
    node, parts = document, []
    for part in problem["loc"]:
        if (isinstance(node, dict) and part not in node and node.get("kind") == part) or isinstance(node, (int, float)):
            continue  # which of several kinds of table, or of three that one number stands for: that is no key
        inside = node[part] if _has(node, part) else None
        named = inside.get("name") if isinstance(part, int) and isinstance(inside, dict) else None
        parts.append(named if isinstance(named, str) else str(part))
        node = inside
    if problem["type"] == MISFIT and problem["ctx"]["key"]:
        parts.append(problem["ctx"]["key"])
    if problem["type"] in (NO_SUCH_KIND, WITHOUT_KIND):
        parts.append(problem["ctx"]["discriminator"].strip("'"))
    return ".".join(shown(part if _BARE_KEY.fullmatch(part) else repr(part)) for part in parts) or "the whole file"


def _has(node: Any, part: Any) -> bool:
    return part in node if isinstance(node, dict) else isinstance(node, list) and part in range(len(node))


def _explain(model: type[BaseModel], problem: dict[str, Any]) -> dict[str, str]:
    """Found, expected and remedy of one pydantic problem."""
    kind, found = problem["type"], shown(repr(problem["input"]))
    if kind == MISFIT:
        context = problem["ctx"]
        return {"found": shown(context["found"])} | {k: shown(context[k], 4 * SHOWN) for k in ("expected", "remedy")}
    if kind == NO_SUCH_KIND:
        tag, kinds = problem["ctx"]["tag"], problem["ctx"]["expected_tags"].replace("'", "").split(", ")
        remedy = nearest(tag, kinds) or "name one of these kinds"
        return {"found": shown(repr(tag)), "expected": " or ".join(kinds), "remedy": remedy}
    if kind == WITHOUT_KIND:
        return {"found": "nothing", "expected": "which kind of table it is", "remedy": "add the key"}
    if kind == "missing" and isinstance(problem["loc"][-1], int):
        return {"found": "nothing", "expected": "a value", "remedy": "add it to the list (its places count from 0)"}
    if kind == "missing":
        reasons = getattr(_model_at(model, problem["loc"][:-1]), "absent", {})
        return {
            "found": "nothing", "expected": "a value", "remedy": reasons.get(str(problem["loc"][-1]), "add the key")
        }  # fmt: skip
    if kind == "extra_forbidden":
        return _explain_unknown(model, problem["loc"])
    if kind == "string_pattern_mismatch":
        pattern = problem["ctx"]["pattern"]
        return {"found": found, "expected": IN_WORDS.get(pattern, f"a match of {pattern}"), "remedy": "correct it"}
    message = _IS.sub("", problem["msg"]).replace(" should have ", " of ")
    if kind in _IN_TOML:
        message = _IN_TOML[kind].format(**problem.get("ctx", {}))
    if isinstance(problem["input"], dict):
        found = "not that"
    elif isinstance(problem["input"], bool):
        found = found.lower()
    return {
        "found": found,
        "expected": shown(message, 4 * SHOWN),
        "remedy": "correct the value and its unit (the key carries it)",
    }


def _explain_unknown(model: type[BaseModel], location: Sequence[str | int]) -> dict[str, str]:
    table, key = _model_at(model, location[:-1]), str(location[-1])
    retired = getattr(table, "retired", {}).get(key)
    if retired is not None:
        return {"found": "a key of an earlier version", "expected": "keys of this one", "remedy": retired}
    known = sorted(table.model_fields) if table is not None else []
    remedy = nearest(key, known) or f"known keys: {', '.join(known)}"
    return {"found": "an unknown key", "expected": "only known keys", "remedy": remedy}


def _model_at(model: type[BaseModel], location: Sequence[str | int]) -> type[BaseModel] | None:
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
