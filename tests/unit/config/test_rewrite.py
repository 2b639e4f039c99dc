"""Values of a command line in a cell's text: what it says is what is wanted, and comments and line breaks stay."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

import configs
from agent.config.cell import load_cell
from agent.config.reading import override
from agent.config.rewrite import rewritten

PAPER = (configs.CELLS_DIR / "two_wx200.toml").read_text()
TEXT = """# a cell
top = 1

[simulation]
ready_s = 4.0  # so long
list = [
  1.0,  # first
  2.0,
]

[[arms]]
name = "left"  # as one stands behind
# measured
dynamixel = { port = "/dev/a", mark = 1 }
share = 0.5

[[arms]]
name = "right"
"""


def wanted(text: str, *overrides: str) -> dict[str, Any]:
    document = tomllib.loads(text)
    for one in overrides:
        override(document, one)
    return document


@pytest.mark.parametrize(
    ("given", "old", "new"),
    [
        ("top=2", "top = 1", "top = 2"),
        ("new=[1, 2]", "top = 1", "top = 1\nnew = [1, 2]"),
        ("simulation.ready_s=5.5", "ready_s = 4.0", "ready_s = 5.5"),
        ("simulation.list=[]", "[\n  1.0,  # first\n  2.0,\n]", "[]"),
        ("arms.left.share=0.4", "share = 0.5", "share = 0.4"),
        ("arms.right.rest_rad.elbow=1.0", 'name = "right"', 'name = "right"\nrest_rad = { elbow = 1.0 }'),
        ("arms.left.dynamixel.mark=2", "mark = 1", "mark = 2"),
        ("arms.left.name=middle", 'name = "left"', 'name = "middle"'),
        ("simulation.reality.seed=3", "  2.0,\n]", "  2.0,\n]\n\n[simulation.reality]\nseed = 3"),
        ("session.lift_m=0.02", 'name = "right"', 'name = "right"\n\n[session]\nlift_m = 0.02'),
        ("floating.hand.at=a b", 'name = "right"', 'name = "right"\n\n[floating.hand]\nat = "a b"'),
    ],
)
def test_only_what_is_given_changes(given: str, old: str, new: str) -> None:
    assert TEXT.count(old) == 1
    assert rewritten(TEXT, [given]) == TEXT.replace(old, new)
    assert tomllib.loads(rewritten(TEXT, [given])) == wanted(TEXT, given)


def test_several_values_go_in_one_after_the_other() -> None:
    given = ["session.lift_m=0.02", "session.lift_m=0.03", "session.off_m=1", "session={a=1}", "session.b=2"]
    assert tomllib.loads(rewritten(TEXT, given)) == wanted(TEXT, *given)
    assert rewritten(TEXT, given[:3]).endswith("[session]\nlift_m = 0.03\noff_m = 1\n")


def test_what_stands_in_an_unusual_way_is_written_anew() -> None:
    text = "# of dots\na.b = 1\na.c = 2\n"
    anew = tomli_w.dumps({"a": {"b": 3, "c": 2}})
    assert rewritten(text, ["a.b=3"]) == anew
    assert rewritten(text.replace("\n", "\r\n"), ["a.b=3"]) == anew.replace("\n", "\r\n")
    inline = 'arms = [{ name = "left", a = 1 }]\n'
    assert rewritten(inline, ["arms.left.name=west"]) == tomli_w.dumps({"arms": [{"name": "west", "a": 1}]})


@pytest.mark.parametrize("end", ["", "\n", "\n\n", "\n# the end"])
def test_the_end_of_the_text_stays(end: str) -> None:
    assert rewritten(f"[a]\nb = 1{end}", ["a.b=2"]) == f"[a]\nb = 2{end}"
    assert rewritten(f"[a]\nb = 1{end}", ["c.d=2"]).startswith(f"[a]\nb = 1{end}")
    assert tomllib.loads(rewritten(f"[a]\nb = 1{end}", ["c.d=2"])) == {"a": {"b": 1}, "c": {"d": 2}}


CELLS = {path.stem: path.read_text() for path in sorted(configs.CELLS_DIR.glob("*.toml"))}


def values_in_a_line(text: str) -> dict[str, int]:
    """Keys as `--set` names them, of the values that stand in one line under a header, with the number of that line."""
    found, table = {}, ""
    for i, line in enumerate(text.split("\n")):
        key = line.partition(" = ")[0]
        if line.startswith("["):
            table = line.partition("#")[0].strip().strip("[]") + "."  # a comment may stand behind it
        elif key.isidentifier() and not line.endswith(("[", "{")):
            name = key == "name" and table == "arms."
            table = f"arms.{tomllib.loads(line)['name']}." if name else table
            found[table + key] = i
    return found


@given(st.data(), st.sampled_from(sorted(CELLS)), st.integers() | st.floats() | st.text() | st.booleans())
def test_of_a_shipped_cell_one_line_changes_and_in_it_the_value(data: st.DataObject, name: str, value: Any) -> None:
    text = CELLS[name]
    places = values_in_a_line(text)
    key = data.draw(st.sampled_from(sorted(places)))
    given = f"{key}={tomli_w.dumps({'v': value}).removeprefix('v = ').rstrip()}"
    before, after = text.split("\n"), rewritten(text.replace("\n", "\r\n"), [given]).split("\r\n")
    at = places[key]
    assert before[:at] + before[at + 1 :] == after[:at] + after[at + 1 :]
    assert not any("\n" in line or "\r" in line for line in after)
    prefix, comment = before[at].partition(" = ")[0], before[at].partition(" #")
    assert after[at].startswith(f"{prefix} = ")
    assert after[at].endswith(comment[1] + comment[2])
    assert repr(tomllib.loads("\n".join(after))) == repr(wanted(text, given)), "repr: nan is not equal to itself"


KEYS = (
    "top",
    "simulation.ready_s",
    "simulation.effects.friction",
    "arms.left.share",
    "arms.left.dynamixel.baud",
    "w.x.y",
)


@given(st.lists(st.tuples(st.sampled_from(KEYS), st.integers() | st.text() | st.lists(st.text())), max_size=3))
def test_what_it_says_is_what_is_wanted(values: list[tuple[str, Any]]) -> None:
    given = [f"{key}={value!r}" for key, value in values]
    assert tomllib.loads(rewritten(TEXT, given)) == wanted(TEXT, *given)


def test_a_cell_with_a_changed_value_has_its_comments() -> None:
    given = ["duration_s=12.0", "safety.tau_max_fraction_of_stall=0.5"]
    before, after = PAPER.split("\n"), load_cell(Path("two_wx200"), given).toml.decode().split("\n")
    assert [line.partition("#")[1:] for line in before] == [line.partition("#")[1:] for line in after]
    assert sum(a != b for b, a in zip(before, after, strict=True)) == 2


def test_a_cell_with_a_changed_value_has_the_line_ends_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(PAPER.replace("\n", "\r\n").encode())
    changed = load_cell(path, ["duration_s=12.0", "simulation.reality.seed=3"]).toml
    assert changed.count(b"\n") == changed.count(b"\r\n") == PAPER.count("\n") + 3
