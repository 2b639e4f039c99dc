"""Changing one value in the text of a TOML file: everything else stays, byte for byte."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import configs
from agent.atomic import WriteError, write_atomically
from agent.config.edit import Change, EditError, apply, lines_of

TEXT = """# a cell
top = 1

[controller] # the law
k = 150.0 # the paper's
list = [
  1.0,  # first
  2.0,
]
# the end of the table

[[arms]]
name = "left"
k_v = 2.5

[[arms]]
name = 'right'
k_v = 2.5
"""


def test_only_the_named_value_changes() -> None:
    edited = apply(TEXT, [Change("arms", "k_v", "[1.0, 2.0, 3.0]", "right")])
    assert edited == TEXT.replace("name = 'right'\nk_v = 2.5", "name = 'right'\nk_v = [1.0, 2.0, 3.0]")


def test_a_value_before_the_first_header_is_changed_there() -> None:
    assert apply(TEXT, [Change("", "top", '"new"  # was 1')]) == TEXT.replace("top = 1", 'top = "new"  # was 1')
    added = apply(TEXT, [Change("", "k", "2")])
    assert added == TEXT.replace("top = 1\n", "top = 1\nk = 2\n")
    with pytest.raises(
        EditError, match="top before the first header: found an unusual way of writing it, expected top ="
    ):
        apply(TEXT.replace("top =", '"top" ='), [Change("", "top", "2")])


def test_a_value_over_several_lines_is_replaced_as_a_whole() -> None:
    edited = apply(TEXT, [Change("controller", "list", "[]")])
    assert tomllib.loads(edited)["controller"] == {"k": 150.0, "list": []}
    assert "# the end of the table" in edited


def test_a_new_key_goes_to_the_end_of_its_own_table() -> None:
    edited = apply(TEXT, [Change("controller", "k_rate", "75.0"), Change("arms", "k_w", "1.0", "left")])
    assert edited.index("k_rate") < edited.index("# the end of the table") < edited.index("k_w") < edited.index("right")


def test_a_table_within_another_that_is_not_there_yet_comes_behind_it() -> None:
    seen = [Change("controller.observer", "slope", "2.0"), Change("controller.observer", "gain", "0.1")]
    edited = apply(TEXT, seen)
    assert edited == TEXT.replace("  2.0,\n]\n", "  2.0,\n]\n\n[controller.observer]\nslope = 2.0\ngain = 0.1\n")
    assert apply(edited, [Change("controller.observer", "gain", "0.3")]) == edited.replace("0.1", "0.3")


@pytest.mark.parametrize(
    ("line", "toml", "becomes"),
    [
        ("k = 1.0 # the paper's", "2.0", "k = 2.0 # the paper's"),
        ("  k=1.0\t#", "2.0", "  k=2.0\t#"),
        ("k = 1.0 ", "2.0", "k = 2.0 "),
        ("k = 'a # b'  # c # d", '"e # f"', 'k = "e # f"  # c # d'),
        ('k = """a # b""" # c', "2.0", "k = 2.0 # c"),
        ("k = { a = '#', b = [1, 2] } # c", "{ a = 2 }", "k = { a = 2 } # c"),
        ("k = [\n 1, # one\n 2 # two\n] # both", "[]", "k = [] # both"),
        ('k = """\n# no comment\nj = 1\n# none""" # one', "2.0", "k = 2.0 # one"),
        ("j = 1 # once\u2028k = 5\nk = 1.0", "2.0", "j = 1 # once\u2028k = 5\nk = 2.0"),
        ("k = 1.0  # mounted askew", "2.0  # measured, was 1.0", "k = 2.0  # measured, was 1.0  # mounted askew"),
        *((f"k = 1.0 # once{cut}k = 5", "2.0", f"k = 2.0 # once{cut}k = 5") for cut in "\x85\u2028\u2029"),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("rest", ["", "\n", "\n# the end\n\n[b]\nk = 1\n", "\n\n\n[b]"])
def test_all_but_the_value_stays_in_its_line(line: str, toml: str, becomes: str, newline: str, rest: str) -> None:
    text = f"# a file\u2028k = 7\n\n[a]\n{line}{rest}".replace("\n", newline)
    assert apply(text, [Change("a", "k", toml)]) == text.replace(
        line.replace("\n", newline), becomes.replace("\n", newline)
    )


def test_what_is_added_ends_as_the_lines_of_the_file() -> None:
    new = [Change("controller", "k_rate", "75.0"), Change("controller.observer", "gain", "0.1")]
    assert apply(TEXT.replace("\n", "\r\n"), new) == apply(TEXT, new).replace("\n", "\r\n")
    assert apply("[a]\r\nj = 1", [Change("a", "k", "2")]) == "[a]\r\nj = 1\r\nk = 2"
    assert apply("[a]\r\nj = 1\nk = 1\n", [Change("a", "k", "2")]) == "[a]\r\nj = 1\nk = 2\n", "each has its own"
    assert apply("", [Change("", "k", "2")]) == "k = 2\n"


def test_a_line_ends_where_toml_says() -> None:
    ends = ("a\n", "\n", "b # \x0b\x0c\x1c\x1d\x1e\x85\u2028\u2029c\r\n", "d\re\n", "f")
    assert lines_of("".join(ends)) == list(ends)
    assert lines_of("") == []


@pytest.mark.parametrize("path", sorted(configs.ARMS_DIR.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_arm_file_can_be_edited(path: Path) -> None:
    text = path.read_text()
    figure = '{ value = 0.5, status = "measured", source = "a log # with a comment sign" }'
    for joint in tomllib.loads(text)["joints"]:
        edited = apply(text, [Change("joints", "coulomb_Nm", figure, joint["name"])])
        before, after = text.splitlines(), edited.splitlines()
        assert len(before) == len(after)
        assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


@pytest.mark.parametrize(
    ("text", "change", "found"),
    [
        (TEXT, Change("world", "g", "9.81"), "no such header"),
        (TEXT, Change("arms", "k_v", "1.0", "middle"), "no such header"),
        ("controller = { k = 1.0 }\n", Change("controller", "k", "2.0"), "no such header"),
        (TEXT, Change("world.sky", "g", "9.81"), "no such header"),
        ("[a]\nb = { c = 1 }\n", Change("a.b", "c", "2"), "an unusual way"),
        ("[a]\nb.c = 1\n", Change("a.b", "d", "2"), "an unusual way"),
        ('[a]\nnote = """\n[b]\n"""\n\n[b]\nk = 1\n', Change("b", "k", "2"), "an unusual way"),
    ],
)
def test_what_cannot_be_edited_safely_is_refused(text: str, change: Change, found: str) -> None:
    with pytest.raises(EditError, match=found):
        apply(text, [change])


def test_a_file_is_replaced_as_a_whole_and_nothing_is_left_behind(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_bytes(b"old")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "folder"
    (path / "inside").mkdir(parents=True)
    with pytest.raises(WriteError, match="found a folder, expected a file"):
        write_atomically(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]
    with pytest.raises(WriteError, match="No such file"):
        write_atomically(tmp_path / "none" / "arm.toml", b"new")
