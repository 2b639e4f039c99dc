"""How files, names and overrides are read: strictly, in one line of refusal, and never without end."""

from __future__ import annotations

import gzip
import os
import re
from pathlib import Path

import pytest
import zstandard

import configs
from agent.config.cell import ConfigError, cell_from_toml, load_cell
from agent.config.reading import WrongKeys
from agent.control.trajectory_spline import TrajectoryError
from agent.log.scan import MAGIC
from agent.verify import check
from agent.verify.check import examine
from agent.verify.finding import Verdict
from drivers.interface import Refusal

PAPER = configs.CELLS_DIR / "paper.toml"
IDENTIFY = configs.CELLS_DIR / "identify_wx200.toml"


@pytest.mark.parametrize(
    "override",
    [
        'rate_hz="200"',
        "rate_hz=true",
        "object.mass_kg=nan",
        "object.mass_kg=inf",
        "object.quat_start=[nan, 0.0, 0.0, 0.0]",
        "trajectory.axis=[0.0, nan, 1.0]",
        "loop_delay_s=inf",
        'controller.friction_feedforward="yes"',
        "controller.friction_feedforward=1",
        "simulation.substeps_per_cycle=5.0",
        "simulation.substeps_per_cycle=true",
        'controller.k_p_per_s=["1", 2, 3]',
        "controller.k_p_per_s=true",
        "arms.left.p_world_base_m=[0.0, true, 0.0]",
        'arms.left.locked_rad.waist="0.0"',
        "controller.kind=1",
        "format=1.0",
        "format=true",
        "name=5",
        "report.transient_s=1979-05-27",
    ],
)
def test_nothing_is_made_from_another_kind_of_value(override: str) -> None:
    with pytest.raises(ConfigError, match=override.split("=", maxsplit=1)[0].replace(".waist", "")):
        load_cell(PAPER, [override])


def test_a_rotation_without_a_k_v_of_its_own_is_refused_with_the_reason() -> None:
    text = PAPER.read_text().replace("k_v_Nm_s_per_rad", "# k_v_Nm_s_per_rad", 1)
    with pytest.raises(ConfigError, match=r"left\.k_v_Nm_s_per_rad .*found nothing.*far too much for a wrist"):
        cell_from_toml(text.encode(), "paper.toml")


def test_a_whole_number_stands_for_the_real_one_and_a_list_for_a_tuple() -> None:
    file = load_cell(PAPER, ["rate_hz=200", "controller.k_p_per_s=[150, 150, 150]", "object.size_m=[1, 1, 1]"]).file
    assert (file.rate_hz, file.controller.k_p_per_s, file.object.size_m) == (200.0, (150.0,) * 3, (1.0,) * 3)


@pytest.mark.parametrize(
    "text",
    ["arms.left=1", "arms=1", "arms.left.k_v.x.y=1", "=1", "a..b=1", "a.=1", "object=1", "rate_hz.x=1", "arms.x.y=1"],
)
def test_overrides_of_what_is_no_value_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"override|arms in|object in|unknown key"):
        load_cell(PAPER, [text])


@pytest.mark.parametrize("key", ["load_share=0.4", "x.y=0"])
def test_an_override_of_two_arms_of_one_name_is_refused(key: str, tmp_path: Path) -> None:
    text = configs.CELLS_DIR.joinpath("paper_real.toml").read_text().replace('name = "right"', 'name = "left"')
    (tmp_path / "twins.toml").write_text(text)
    with pytest.raises(ConfigError, match="expected one of left in the file; give each entry a name of its own"):
        load_cell(tmp_path / "twins.toml", [f"arms.left.{key}"])


@pytest.mark.parametrize(
    ("name", "remedy"), [("lft", "did you mean left?"), ("middle", "name one of these"), ("1", "name one of these")]
)
def test_an_arm_that_no_override_finds_is_answered_with_those_that_there_are(name: str, remedy: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_cell(PAPER, [f"arms.{name}.load_share=0.4"])
    key = f"arms.{name}.load_share"
    assert str(refused.value) == f"override: found '{key}', expected left or right; {remedy}"


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (b"\xff\xfe", "UTF-8"),
        (b"\xef\xbb\xbf" + PAPER.read_bytes(), "byte order mark .*; save it as UTF-8 without BOM"),
        (b"a = " + b"[" * 5000, "expected TOML"),
        (b"a = " + b"9" * 5000, "expected TOML"),
        (b'"\\u0000\\n" = 1\n' + PAPER.read_bytes(), "an unknown key"),
        (("x" * 9000 + " = 1\n").encode() + PAPER.read_bytes(), "xx… in cell.toml"),
    ],
)
def test_odd_texts_are_refused_in_one_line(tmp_path: Path, raw: bytes, expected: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(raw)
    with pytest.raises(ConfigError, match=expected) as caught:
        load_cell(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("larger", [False, True])
@pytest.mark.parametrize(
    ("begin", "found", "remedy"),
    [
        (MAGIC, "a log (MCAP)", "name the cell's own file"),
        (gzip.compress(b"", mtime=0), "a file packed with gzip", "gunzip"),
        (zstandard.compress(b""), "a file packed with zstd", "unzstd"),
        (b"PK\x03\x04", "a zip archive", "unzip"),
        ("\ufeffformat".encode("utf-16-le"), "text in UTF-16", "save it as UTF-8"),
        ("\ufeffformat".encode("utf-16-be"), "text in UTF-16", "save it as UTF-8"),
    ],
)
def test_a_file_of_another_kind_is_told_by_its_kind(
    tmp_path: Path, begin: bytes, found: str, remedy: str, *, larger: bool
) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(begin)
    if larger:
        os.truncate(path, 20_000_000)
    with pytest.raises(ConfigError, match=re.escape(f": found {found}, expected text in UTF-8; ") + f".*{remedy}"):
        load_cell(path)


def test_a_letter_of_another_encoding_is_told_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(b"a = 1\nb = 'f\xfcnf'\n")
    with pytest.raises(ConfigError, match=r"a byte in line 2 that is no UTF-8 \(0xfc\)"):
        load_cell(path)


@pytest.mark.parametrize("name", ["/dev/zero", "/", "/dev/null"])
def test_what_is_no_file_is_not_read(name: str) -> None:
    with pytest.raises(ConfigError, match="no regular file"):
        load_cell(Path(name))


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="no regular file"):
        load_cell(tmp_path / "pipe")


def test_a_file_of_another_kind_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(ConfigError, match="found 20 MB, expected a file of at most 16 MB"):
        load_cell(path)


@pytest.mark.parametrize("path", ["/dev/zero", "/", "a\\u0000b", "none.csv"])
def test_a_motion_from_what_is_no_file_is_refused(tmp_path: Path, path: str) -> None:
    text = PAPER.read_text()
    begin, end = text.index('kind = "sinusoid"'), text.index("[controller]")
    cell = tmp_path / "cell.toml"
    cell.write_text(f'{text[:begin]}kind = "file"\npath = "{path}"\n{text[end:]}')
    with pytest.raises(TrajectoryError, match=r"trajectory file .*expected a readable CSV file"):
        load_cell(cell)


def test_shipped_cells_go_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_cell(Path("paper")).fingerprint == load_cell(PAPER).fingerprint
    (tmp_path / "paper").mkdir()
    assert load_cell(Path("paper")).file.name == "paper"


@pytest.mark.parametrize("name", ["mine", "mine.toml", "."])
def test_a_folder_of_the_name_of_no_cell_is_told_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if name != ".":
        (tmp_path / name).mkdir()
    with pytest.raises(ConfigError, match="found no regular file, expected a file"):
        load_cell(Path(name))


def test_a_file_of_that_name_wins_over_a_shipped_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").write_text(PAPER.read_text().replace('name = "paper"', 'name = "mine"'))
    assert load_cell(Path("paper")).file.name == "mine"


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("papr", "did you mean paper?"), ("paper.toml", "did you mean paper?"), ("qqq", "give the path")],
)
def test_an_unknown_name_lists_the_shipped_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, remedy: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"expected a cell file, or one of four_wx250s, .*two_wx200; ") as caught:
        load_cell(Path(name))
    assert caught.value.remedy.startswith(remedy)


def test_a_motion_of_two_thousand_years_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"trajectory\.motion_s in .*less than or equal to 1000000"):
        load_cell(IDENTIFY, ["trajectory.motion_s=6e10"])


def test_a_long_motion_is_examined_in_part_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "NAMED_MAX", 600)  # of 6000, which take a second
    report = examine(load_cell(IDENTIFY, ["trajectory.motion_s=200", "duration_s=200"]))
    found = next(f for f in report.findings if f.what == "instants examined")
    assert (found.verdict, found.found) == (Verdict.WARNING, "600 of 881")
    assert not any(f.what == "instants examined" for f in examine(load_cell(IDENTIFY)).findings)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("kind = 'sinusid'", r"found 'sinusid', expected sinusoid or rest_to_rest or .*; did you mean sinusoid\?"),
        ("kind = 'zzz'", "found 'zzz', expected sinusoid or .*; name one of these kinds"),
        ("", "found nothing, expected which kind of table it is; add the key"),
    ],
)
def test_a_kind_of_motion_that_there_is_not_is_told_by_its_key(tmp_path: Path, kind: str, said: str) -> None:
    own = tmp_path / "own.toml"
    own.write_text((configs.CELLS_DIR / "paper.toml").read_text().replace('kind = "sinusoid"', kind))
    with pytest.raises(ConfigError, match=rf"^trajectory\.kind in own\.toml: {said}"):
        load_cell(own)


def test_a_refusal_is_one_line_whatever_is_in_it() -> None:
    text = str(Refusal("a\nb", found="\x1b[31m\t\u202e", expected="c\u2028d", remedy="e"))
    assert text == "a b: found \ufffd[31m \ufffd, expected c d; e"


def test_one_number_that_stands_for_three_is_wrong_once_and_by_its_key() -> None:
    with pytest.raises(ConfigError) as one:
        load_cell(PAPER, ["controller.k_p_per_s=1e7"])
    assert str(one.value).startswith("controller.k_p_per_s in paper.toml")
    with pytest.raises(ConfigError) as second:
        load_cell(PAPER, ["controller.k_p_per_s=[1.0, -1.0, 2.0]"])
    assert str(second.value).startswith("controller.k_p_per_s.1 in paper.toml")
    assert "\n" not in str(one.value) + str(second.value)


def test_all_missing_and_wrong_keys_are_named_at_once() -> None:
    text = PAPER.read_text().replace("mass_kg", "mas_kg", 1).replace("p_object_ee_m", "# p_object_ee_m", 1)
    text = text.replace("rate_hz = ", "rate_hz = -", 1).replace("load_share = 0.5", 'load_share = "half"', 1)
    with pytest.raises(WrongKeys) as caught:
        cell_from_toml(text.encode(), "mine.toml")
    found = {p.what: (p.found, p.expected, p.remedy) for p in caught.value.problems}
    assert set(found) == {
        "object.mas_kg in mine.toml", "arms.left.p_object_ee_m in mine.toml", "rate_hz in mine.toml",
        "arms.left.load_share in mine.toml",
    }  # fmt: skip
    assert found["object.mas_kg in mine.toml"][2] == "did you mean mass_kg?"
    assert found["arms.left.p_object_ee_m in mine.toml"] == ("nothing", "a value", "add the key")
    assert caught.value.lines == [str(p) for p in caught.value.problems]
    assert str(caught.value).startswith("object.mas_kg in mine.toml (and 3 more: ")


@pytest.mark.parametrize(
    ("change", "found", "expected"),
    [
        ("controller=3", "3", "a table"),
        ("trajectory=3", "3", "a table"),
        ("simulation.push=[3]", "3", "a table"),
        ("simulation.push=3", "3", "a list"),
        ("object.p_start_m=1", "1", "a list"),
        ("object.p_start_m=[1, 2, 3, 4]", "[1, 2, 3, 4]", "at most 3 of them"),
        ("object.p_start_m=[1, 2]", "nothing", "a value; add it to the list"),
        ("arms=[]", "[]", "at least 1 of them"),
        ("arms.left.locked_rad=3", "3", "a table"),
        ('controller.k_p_per_s="fast"', "'fast'", "a number, or a list of three: x, y, z"),
        ("rate_hz=true", "true", "a number"),
        ("simulation.substeps_per_cycle=1.5", "1.5", "a whole number"),
        ("controller.friction_feedforward=1", "1", "true or false"),
        ("name=5", "5", "text in quotes"),
    ],
)
def test_a_value_of_another_kind_is_told_in_words_of_the_file(change: str, found: str, expected: str) -> None:
    """Not in those of a programming language."""
    with pytest.raises(ConfigError) as refused:
        load_cell(Path("paper"), [change])
    line = str(refused.value)
    assert f": found {found}, expected {expected}" in line
    assert not re.search("tuple|dictionary|instance|boolean|string|validation", line, re.IGNORECASE)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("arms.left.name=Left", "a to z, then a to z, 0 to 9 and _, 32 at most"),
        ("arms.left.model=../wx200", "a letter or digit, then letters, digits, _ . and -, 64 at most"),
        ("arms.left.host=my_host", "a letter or digit, then letters, digits, . and -, 253 at most"),
        ("arms.left.dynamixel.port=/dev/my arm", "no blank in it"),
    ],
)
def test_a_name_that_is_none_is_told_in_words(change: str, expected: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_cell(Path("two_wx200"), [change])
    assert f"expected {expected};" in str(refused.value)


def test_what_a_command_changes_is_not_said_to_stand_in_the_file() -> None:
    for change in ("duration_s=0", "duration=3", 'arms.left.model="nothing"'):
        with pytest.raises(ConfigError, match=r"in paper\.toml with the changes asked for(:| )"):
            load_cell(Path("paper"), [change])
    with pytest.raises(ConfigError, match=r"in mine\.toml: "):
        cell_from_toml(PAPER.read_bytes() + b"[moon]", "mine.toml")


def test_every_arm_that_cannot_be_is_named_at_once() -> None:
    text = PAPER.read_text().replace('model = "widowx_mk2"', 'model = "nothing"')
    with pytest.raises(WrongKeys, match="model of arm left") as caught:
        cell_from_toml(text.encode(), "mine.toml")
    assert [p.what.split(" in ")[0] for p in caught.value.problems] == ["model of arm left", "model of arm right"]


def test_of_very_many_wrong_keys_a_screenful_is_shown() -> None:
    text = "".join(f"k{i} = 1\n" for i in range(60)) + PAPER.read_text()
    with pytest.raises(WrongKeys) as caught:
        cell_from_toml(text.encode(), "mine.toml")
    assert caught.value.lines[-1] == "and 20 more"
    assert len(caught.value.lines) == 41
    assert len(str(caught.value)) < 1000
