"""Changed cell and arm files: values deleted, doubled, retyped, perturbed, exchanged; text and bytes spliced."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import tomli_w
from hypothesis import strategies as st

# kinds of motion that no shipped cell has, for the paper's cell
MOTIONS = {
    "rest_to_rest": """kind = "rest_to_rest"
p_from_m = [0.3, 0.12, 0.0]
p_to_m = [0.33, 0.12, 0.0]
quat_to = [0.9995, 0.0, 0.0, 0.031618823507524754]
move_s = 4.0
wait_s = 1.0
and_back = true
""",
    "waypoints": """kind = "waypoints"
points = [
  { t_s = 0.0, p_m = [0.3, 0.12, 0.0] },
  { t_s = 2.0, p_m = [0.33, 0.13, 0.0], quat = [0.9995, 0.0, 0.0, 0.031618823507524754] },
  { t_s = 4.0, p_m = [0.3, 0.11, 0.0] },
]
""",
    "file": 'kind = "file"\npath = "way.csv"\n',
}
WAY = "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + "".join(
    f"{0.5 * k},{0.3 + 0.01 * x},0.12,0.0,1.0,0.0,0.0,0.0\n" for k, x in enumerate((0, 0, 1, 2, 3, 3, 2, 1, 0, 0))
)

Place = tuple[Any, Any]  # a table or list, and the key or index in it

EXTREME_NUMBERS = (
    0, -0.0, -1, 1, 2, 3, 1e-3, -1e-3, 0.5, 1e-9, 1e-300, 5e-324, 1e9, 6e10, 1e300, 1.8e308, -1e300, math.nan, math.inf,
    -math.inf, 2**31, -(2**63), 10**30, 10**400, 4095, 4096, 254, 255,
)  # fmt: skip
TEXTS = (
    "", " ", "a", "left", "right", "wx200", "../wx200", "/dev/zero", "/", "NaN", "200", "yes", "plant", "ee", "waist",
    "shoulder", "observer", "dynamixel", "zero", "file", "waypoints", "fourier", "rest_to_rest", "XL430-W250", "AX-12A",
    "x" * 5000, "линия", "\u202e\u0000\n\t\"'\\", "\U0001f9be", "e\u0301", "%s{0}", "\x1b[31m", "\u2028",
)  # fmt: skip
OTHERS = (True, False, [], {}, [1, 2], ["a"], {"a": 1}, [[]], [{}], [[1.0, 2.0, 3.0]] * 3)
SPLICES = (
    "", "=", "[", "]", "[[", "{", "}", '"', "'''", "#", "\n", ".", ",", "-", "e9", "nan", "inf", "0x", "true",
    "[arms]\n", "[[arms]]\n", "\x00", "\ufeff", "é", "[" * 3000, "9" * 5000, "[controller]\n", "1979-05-27T07:32:00Z",
)  # fmt: skip
CSV_SPLICES = ("", ",", "\n", "nan", "inf", "1e300", "-", "e5", ".", "0", "#", "\x00", "é", "t_s", "9" * 400)
URDF_SPLICES = (
    "", "<", ">", "/", '"', "0", "nan", "inf", "1e300", "-", "<joint/>", "<link name='x'/>", "\x00", "é", "continuous",
    "floating", "prismatic", "fixed", "mimic", "waist", "ee",
)  # fmt: skip

numbers = st.one_of(st.sampled_from(EXTREME_NUMBERS), st.floats(), st.integers(-(10**6), 10**6))
values = st.one_of(numbers, st.sampled_from(TEXTS), st.text(max_size=12), st.sampled_from(OTHERS))


def places(node: Any) -> Iterator[Place]:
    """Every value of a document, at every depth."""
    keys: Sequence[Any] = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in keys:
        yield node, key
        yield from places(node[key])


def _one_of(data: st.DataObject, found: list[Place]) -> Place:
    return found[data.draw(st.integers(0, len(found) - 1), label="place")]


def _delete(_: st.DataObject, found: list[Place], at: Place) -> None:
    del at[0][at[1]]


def _double(data: st.DataObject, found: list[Place], at: Place) -> None:
    holder, key = at
    if isinstance(holder, list):
        holder.insert(key, copy.deepcopy(holder[key]))
    else:
        holder[data.draw(st.one_of(st.sampled_from(TEXTS), st.just(f"{key}_2")))] = copy.deepcopy(holder[key])


def _retype(data: st.DataObject, found: list[Place], at: Place) -> None:
    at[0][at[1]] = copy.deepcopy(data.draw(values))


def _perturb(data: st.DataObject, found: list[Place], at: Place) -> None:
    """A number by a factor or a step, as slips are; anything else is exchanged."""
    holder, key = at
    value = holder[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        _exchange(data, found, at)
        return
    factor = data.draw(st.sampled_from([-1, 0, 0.5, 0.9, 1.001, 1.1, 2, 10, 57.3, 100, 1000, 1e6, -1e3, 1e-3, 1e-9]))
    step = data.draw(st.sampled_from([0, 0, 0, 1, -1, 1e-6]))
    changed = value * factor + step if abs(value) < 10**300 else value
    holder[key] = round(changed) if isinstance(value, int) and math.isfinite(changed) else changed


def _exchange(data: st.DataObject, found: list[Place], at: Place) -> None:
    """The value of another place; a copy, since a table may not hold itself."""
    other, key = _one_of(data, found)
    at[0][at[1]] = copy.deepcopy(other[key])


_CHANGES: tuple[Callable[[st.DataObject, list[Place], Place], None], ...] = (
    _delete, _double, _retype, _retype, _perturb, _perturb, _perturb, _exchange,
)  # fmt: skip


def changed_document(data: st.DataObject, document: dict[str, Any]) -> bytes:
    """TOML of the document with one to three values changed."""
    changed = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        found = list(places(changed))
        if found:
            data.draw(st.sampled_from(_CHANGES))(data, found, _one_of(data, found))
    return tomli_w.dumps(changed).encode(errors="replace")


def spliced(data: st.DataObject, text: str, pieces: Sequence[str] = SPLICES) -> bytes:
    """The text with up to three stretches cut out and something else put in; sometimes not UTF-8 any more."""
    for _ in range(data.draw(st.integers(1, 3))):
        begin = data.draw(st.integers(0, len(text)))
        end = min(len(text), begin + data.draw(st.sampled_from([0, 0, 1, 3, 20, 200, 10**6])))
        middle = data.draw(st.one_of(st.sampled_from(pieces), st.text(max_size=5), st.just(text[begin:end] * 2)))
        text = text[:begin] + middle + text[end:]
    raw = text.encode(errors="replace")
    at = data.draw(st.integers(-9, len(raw)))  # now and then
    return raw if at < 0 or data.draw(st.integers(0, 9)) else raw[:at] + b"\xff\xfe" + raw[at:]
