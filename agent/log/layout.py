"""The layout of rows as the log's own schema gives it, so that a log of another release can be read by name.

A schema is read if all its fields are numbers or arrays of fixed length, each on a multiple of its size, as ours are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from agent.log import ros_definitions
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE, Field, Layout

OURS: Final = {ros_definitions.schema_name(layout.ros_name): layout for layout in (AGENT_STATE, PLANT_STATE)}
_LINE: Final = re.compile(
    r"(uint64|int64|float64|uint32)(?:\[(\d{1,4})\])? ([a-zA-Z]\w*)(?:  # (.*?)(?: \[([^\]]*)\])?)?"
)
_TIMING: Final = frozenset(f.name for layout in OURS.values() for f in layout.fields if f.timing)


def parse(schema_name: str, definition: str) -> Layout | None:
    """The layout that a schema of ours describes, of whatever release; None for one that cannot be read."""
    own = OURS.get(schema_name)
    if own is None:
        return None
    if definition == own.definition:
        return own
    fields = []
    for line in definition.splitlines():
        found = _LINE.fullmatch(line)
        if found is None:
            return None
        kind, length, name, doc, unit = found.groups()
        fields.append(Field(name, kind, int(length or 0), unit or "", doc or "", name in _TIMING))
    layout = Layout(own.ros_name, tuple(fields))
    try:
        known = layout.dtype  # checks the alignment and that no name comes twice
    except (AssertionError, ValueError):
        return None
    return layout if known.itemsize > 0 and fields else None


def differences(found: Sequence[Field], expected: Sequence[Field]) -> str:
    """In words what the fields of one layout lack and have beside those of another; empty where they are alike."""
    theirs, ours = ({(f.name, f.ros_type, f.length) for f in fields} for fields in (found, expected))
    lacking, other = sorted({name for name, *_ in ours - theirs}), sorted({name for name, *_ in theirs - ours})
    parts = [f"without {', '.join(lacking)}" if lacking else "", f"with another {', '.join(other)}" if other else ""]
    return ", ".join(part for part in parts if part)
