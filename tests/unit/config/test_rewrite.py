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
        ("simulation.ready_s=5.5", "ready_s = 4.0  # so long", "ready_s = 5.5"),
        ("simulation.list=[]", "[\n  1.0,  # first\n  2.0,\n]", "[]"),
        ("arms.left.share=0.4", "share = 0.5", "share = 0.4"),
        ("arms.right.rest_rad.elbow=1.0", 'name = "right"', 'name = "right"\nrest_rad = { elbow = 1.0 }'),
        ("arms.left.dynamixel.mark=2", "mark = 1", "mark = 2"),
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
    anew = rewritten(TEXT, ["arms.left.name=middle"])
    assert anew == tomli_w.dumps(wanted(TEXT, "arms.left.name=middle"))
    text = "# of dots\na.b = 1\na.c = 2\n"
    assert rewritten(text, ["a.b=3"]) == tomli_w.dumps({"a": {"b": 3, "c": 2}})


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
    changed = load_cell(Path("two_wx200"), ["duration_s=12.0", "arms.left.load_share=0.5"]).toml.decode()
    assert [line for line in PAPER.splitlines() if line.startswith("#")] == [
        line for line in changed.splitlines() if line.startswith("#")
    ]
