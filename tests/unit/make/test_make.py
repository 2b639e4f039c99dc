"""Cells that `coop new` makes run at the first try; what cannot be met is said in one line, by name."""

from __future__ import annotations

import functools
import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import configs
from agent.cli.main import dispatch
from agent.config.cell import ConfigError, cell_from_toml, load_cell
from agent.make.make import Made, Maker
from agent.make.place import grasp
from agent.make.wish import (
    ArmWish,
    MotionKind,
    MotionWish,
    ObjectWish,
    ShapeKind,
    Vec3,
    Wish,
    WishError,
    arm_wishes,
    points_of,
    vector,
)
from agent.verify import stiffest
from agent.verify.check import examine
from agent.verify.finding import Verdict
from agent.verify.tune import Tuner
from tests.support.few import long
from tests.support.plant.inprocess import simulate

CARRY = MotionWish(MotionKind.CARRY, (0.03, 0.02, 0.03), 2.0)
UP = MotionWish(MotionKind.LIFT, (0.0, 0.0, 0.6))
LIFT = MotionWish(MotionKind.LIFT, (0.0, 0.0, 0.04), 2.0)


def wish(arms: list[str], mass: float, size: Vec3, motion: MotionWish = LIFT, height: float | None = None) -> Wish:
    return Wish("mine", arm_wishes(arms), ObjectWish(mass, size), motion, height)


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """What reality may make of a cell takes a second, and is looked into where another test asks for its verdict."""
    monkeypatch.setattr("agent.make.make.examine", lambda cell, **_: examine(cell, wired=True, thorough=False))


CELLS = {
    "tray": wish(["wx250s", "wx250s"], 0.3, (0.3, 0.2, 0.02)),
    "bar": wish(["wx200", "wx200"], 0.1, (0.2, 0.03, 0.03), MotionWish(MotionKind.SINUSOID, (0.03, 0.0, 0.0), 8.0)),
    "box": wish(["wx250s"] * 3, 0.5, (0.2, 0.14, 0.06), CARRY, 0.15),
    "mixed": wish(["wx200", "wx250s"], 0.1, (0.2, 0.03, 0.03), height=0.2),
}


@functools.cache
def made(which: Wish) -> Made:
    """With the gains of the cells that ship; the search for better ones has tests of its own."""
    return Maker(which).make(tune=False)


@pytest.mark.parametrize(
    "name", ["mixed", *(pytest.param(name, marks=pytest.mark.long) for name in ("tray", "bar", "box"))]
)
def test_a_made_cell_runs_within_a_millimetre_at_the_first_try(name: str) -> None:
    cell = made(CELLS[name])
    assert all(f.verdict is not Verdict.REFUSED for f in cell.report.findings)
    distance, angle = simulate(cell.cell, 3.0).after(2.0)
    assert distance < 1e-3
    assert angle < 3e-3


@pytest.mark.long  # tests/unit/verify/test_tune.py
def test_gains_are_searched_by_the_robust_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiffest, "TRIES", 30)  # enough to find some
    usual, tuned = made(CELLS["mixed"]), Maker(CELLS["mixed"]).make()
    assert usual.report.robustness is not None
    assert tuned.report.robustness is not None
    assert tuned.report.robustness.criterion.radius < 0.9999 < usual.report.robustness.criterion.radius
    assert "# stiffer is more exact" in tuned.text, "comments stay"
    assert usual.text.splitlines()[0] == tuned.text.splitlines()[0]


SLOW = replace(CELLS["mixed"], rate_hz=80.0)


def test_usual_gains_that_a_slow_loop_cannot_take_are_refused() -> None:
    with pytest.raises(WishError, match=r"spectral radius at 80 Hz.*; leave out --no-tune, or give a higher --rate"):
        Maker(SLOW).make(tune=False)


@pytest.mark.parametrize(("rate_hz", "substeps"), [(20.0, 9), (30.0, 6), (36.0, None)])
def test_a_cell_of_a_slow_loop_is_written_with_steps_that_the_plant_takes(rate_hz: float, substeps: int | None) -> None:
    text = Maker(replace(CELLS["mixed"], rate_hz=rate_hz))._placed()[0]
    assert tomllib.loads(text)["simulation"].get("substeps_per_cycle") == substeps
    assert cell_from_toml(text.encode(), "mine.toml").file.rate_hz == rate_hz


@pytest.mark.long  # a search for others is above
def test_usual_gains_that_a_slow_loop_cannot_take_do_not_keep_others_from_being_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stiffest, "TRIES", 60)
    assert Maker(SLOW).make().report.ok


def test_what_gains_cannot_mend_is_said_before_they_are_searched(
    unhurried: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Tuner, "propose", lambda *_: pytest.fail("searched"))
    fast = replace(CELLS["mixed"], rate_hz=1500.0)
    with pytest.raises(WishError, match=r"rate on the servo bus .*lower rate_hz"):
        Maker(fast).make()


@pytest.mark.parametrize(
    ("which", "match"),
    [
        (wish(["wx200", "wx200"], 3.0, (0.2, 0.03, 0.03), height=0.2), r"left: \w+ needs \d+% of its torque bound"),
        (wish(["wx200 base=-0.3,0,0,0"], 0.1, (0.2, 0.03, 0.03), height=0.9), "left: the grasp is out of reach"),
        (wish(["wx250s base=1.5,0,0,0"], 0.1, (0.2, 0.03, 0.03), height=0.2), "left: the grasp is out of"),
        (wish(["wx200 base=-0.36,0,0,0"], 0.1, (0.2, 0.03, 0.03), UP, 0.2), "out of reach along"),
        (wish(["wx250s"] * 2, 0.1, (0.2, 0.03, 0.03), height=0.012), "distance"),
        long((wish(["wx250s face=-x", "wx250s face=-x name=b"], 0.1, (0.2, 0.1, 0.03), height=0.2), "distance of the")),
        (wish(["wx200"] * 3, 0.1, (0.2, 0.1, 0.03)), "at most two, at -x and "),
        (wish(["wx200", "wx200 face=+y"], 0.1, (0.2, 0.1, 0.03)), "move in the plane of x and z"),
        (wish(["wx200"] * 2, 0.1, (0.2, 0.1, 0.03), MotionWish(MotionKind.LIFT, (0, 0.1, 0))), "x and z alone"),
        (wish(["wx250s share=0.8", "wx250s share=0.8"], 0.1, (0.2, 0.1, 0.03)), "a sum of 1.6"),
        (wish(["wx250s", "wx250s"], 0.0, (0.2, 0.1, 0.03)), r"object\.mass_kg in mine\.toml .*: found 0\.0"),
    ],
)  # fmt: skip
def test_what_cannot_be_met_is_named(which: Wish, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        Maker(which).make(tune=False)


@pytest.mark.parametrize(
    ("texts", "match"),
    [
        ([], "arms: found 0"),
        (["wx200"] * 5, "arms: found 5"),
        (["wx2000"], "did you mean wx200"),
        (["face=-x wx200"], "a model 'face=-x'.* name a described arm, or its file, first"),
        (["wx250s,face=-x"], 'by spaces: --arm "wx250s face=-x"'),
        (["wx200 fac=-x"], "did you mean face"),
        (["wx200 face=up"], "face of arm wx200: found up"),
        (["wx200 down=200"], "down of arm wx200: found 200"),
        (["wx200 base=1,2"], "base of arm wx200: found '1,2'"),
        (["wx200 pose=a"], "pose of arm wx200: found 'a'"),
        (["wx200 pose=0.1,0,0,0,0,0,0"], "a quaternion of norm 0"),
        (["wx200 share=nan"], "share of arm wx200"),
        (["wx200 face=-x", "wx200 face=-x"], "names that differ"),
        (["wx200 face=-x face=+x"], "found face= twice, expected one face="),
        (['wx200 name=a"b'], "name of arm wx200: found 'a\"b', expected a to z, then"),
        (["wx200 name=1"], "name of arm wx200: found '1'"),
    ],
)
def test_words_that_say_nothing_are_refused(texts: list[str], match: str) -> None:
    with pytest.raises(WishError, match=match):
        arm_wishes(texts)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """The file of an arm that does not ship, in a folder beside that of the cells, and its URDF."""
    (tmp_path / "arms").mkdir()
    (tmp_path / "cells").mkdir()
    for file in ("wx200.toml", "wx200.urdf"):
        text = (configs.ARMS_DIR / file).read_text().replace("wx200", "ours")
        text = text.replace("coulomb_Nm = { value = 0.2,", "coulomb_Nm = { value = 0.25,")
        (tmp_path / "arms" / file.replace("wx200", "ours")).write_text(text)
    return tmp_path / "arms" / "ours.toml"


@pytest.mark.parametrize("tune", [False, True])
def test_an_arm_file_stands_in_place_of_a_model_and_the_cell_names_it_as_it_is_found_from_there(
    unhurried: None, own: Path, monkeypatch: pytest.MonkeyPatch, *, tune: bool
) -> None:
    """Its text is not in the cell file, so that what is changed in it later counts."""
    monkeypatch.setattr(Tuner, "propose", lambda self, *_: SimpleNamespace(toml=self.cell.toml.decode))
    cells = own.parent.parent / "cells"
    monkeypatch.chdir(own.parent.parent)
    wanted = replace(wish(["arms/ours.toml", "wx200"], 0.1, (0.2, 0.03, 0.03), height=0.2), folder=Path("cells"))
    found = Maker(wanted).make(tune=tune)
    (cells / "mine.toml").write_text(found.text)
    assert "embedded" not in found.text
    cell = load_cell(cells / "mine.toml")
    assert [(arm.entry.model, arm.entry.arm_file) for arm in cell.arms] == [
        ("ours", "../arms/ours.toml"), ("wx200", None),
    ]  # fmt: skip
    assert [arm.servos[0].coulomb_Nm.value for arm in cell.arms] == [0.25, 0.2]
    assert cell.fingerprint == found.cell.fingerprint


def test_arms_in_a_plane_with_joints_of_other_names_are_refused_with_those_that_are_needed(own: Path) -> None:
    for file in (own, own.with_suffix(".urdf")):
        file.write_text(file.read_text().replace("wrist_angle", "wrist"))
    which = wish([str(own)], 0.1, (0.2, 0.03, 0.03), height=0.2)
    with pytest.raises(WishError, match=r"a ours: found no joint wrist_angle, expected .*name its joints so"):
        Maker(which)


def test_an_arm_file_that_is_none_or_lacks_its_urdf_is_refused_with_what_to_do(own: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: found No such file.* give the path of an arm file"):
        arm_wishes([f"{own.parent}/none.toml"])
    own.with_suffix(".urdf").unlink()
    with pytest.raises(ConfigError, match=r"ours\.urdf: found No such file.* put it beside .*arms/ours\.toml"):
        Maker(wish([str(own)], 0.1, (0.2, 0.03, 0.03), height=0.2)).make(tune=False)


def test_faces_and_names_are_dealt_out() -> None:
    found = arm_wishes(["wx250s", "wx250s face=-x down=30", "wx250s name=mine share=0.2"])
    assert [(a.name, a.face) for a in found] == [("right", "+x"), ("left", "-x"), ("mine", "+y")]
    assert (found[1].down_deg, found[2].share) == (30.0, 0.2)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (ShapeKind.BOX, (0.6 * (0.04 + 0.09) / 12, 0.6 * (0.01 + 0.09) / 12, 0.6 * (0.01 + 0.04) / 12)),
        (ShapeKind.CYLINDER, (0.5 * 0.6 * 0.01, 0.6 * (0.03 + 0.01) / 12, 0.6 * (0.03 + 0.01) / 12)),
    ],
)
def test_inertia_is_that_of_the_solid(shape: ShapeKind, expected: Vec3) -> None:
    assert ObjectWish(0.6, (0.1, 0.2, 0.3), shape).moments() == pytest.approx(expected)
    assert ObjectWish(0.6, (0.1, 0.2, 0.3), shape, (1.0, 2.0, 3.0)).moments() == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(("face", "p"), [("-x", (-0.135, 0, 0)), ("+x", (0.135, 0, 0)), ("+y", (0, 0.085, 0))])
def test_a_hand_points_at_its_face_from_above(face: str, p: Vec3) -> None:
    T = grasp(ArmWish("a", "wx250s", face, 30.0), (0.3, 0.2, 0.05), spatial=True)
    assert T.translation == pytest.approx(p)
    assert T.rotation.T @ T.rotation == pytest.approx(np.eye(3))
    assert np.linalg.det(T.rotation) == pytest.approx(1.0)
    forward = T.rotation[:, 0]
    assert forward[2] == pytest.approx(-0.5)  # 30° below the level
    assert forward @ np.array(p) < 0.0
    assert T.rotation[2, 2] == pytest.approx(math.cos(math.radians(30.0)))  # not upside down


def test_what_was_given_stands_in_the_file() -> None:
    arms = ["wx250s face=-x base=-0.4,0.01,0.0,3 share=0.7", "wx250s pose=0.1,0,0,0,0,0,1 base=0.5,0,0,180"]
    motion = MotionWish(MotionKind.WAYPOINTS, points=points_of(["2,0.01,0,0.02", "4,0,0.01,0.03"]))
    _, cell = Maker(Wish("mine", arm_wishes(arms), ObjectWish(0.1, (0.2, 0.1, 0.04)), motion, 0.2))._placed()
    left, right = cell.file.arms
    assert left.p_world_base_m == (-0.4, 0.01, 0.0)
    assert 2.0 * math.degrees(math.asin(left.quat_world_base[3])) == pytest.approx(3.0)
    assert (left.load_share, right.load_share) == (0.7, pytest.approx(0.3))
    assert right.p_object_ee_m == (0.1, 0.0, 0.0)
    assert cell.file.object.p_start_m == (0.0, 0.0, 0.2)
    assert cell.trajectory().at(4.0).p == pytest.approx((0.0, 0.01, 0.23))
    assert cell.file.duration_s == 6.0


ASK = ("--arm", "wx200 base=-0.36,0,0,0", "--arm", "wx200 base=0.36,0,0,180", "--mass", "0.1",
       "--size", "0.2,0.03,0.03", "--height", "0.25", "--no-tune")  # fmt: skip


def test_the_command_writes_a_file_that_check_accepts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "my_cell.toml"
    assert dispatch(["new", str(path), *ASK, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["written"] == str(path)
    assert document["verdict"] in {"ok", "warning"}
    report = examine(load_cell(path), wired=True)
    assert report.ok
    assert "what tells arms apart" not in {finding.what for finding in report.findings}
    assert [arm.mark for arm in load_cell(path).file.arms] == [1, 2]
    assert tomllib.loads(path.read_text())["name"] == "my_cell"
    before = path.read_bytes()
    assert dispatch(["new", str(path), *ASK]) == 2
    assert "give --force" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_an_object_that_no_gripper_closes_on_is_warned_of_and_one_that_fits_is_not(
    unhurried: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for width, warned in (("0.03", True), ("0.04", False)):
        path = tmp_path / "cell.toml"
        assert dispatch(["new", str(path), *ASK, "--size", f"0.2,{width},0.03", "--force"]) == 0
        told = "warning: left: object between the fingers of arm left: found 30.0 mm, wanted 33.0 to 70.0 mm; as it is"
        assert (told in capsys.readouterr().out) == warned
        text = path.read_text().replace("# [session]\n# lift_m", "[session]\nlift_m").replace('"sim"', '"dynamixel"')
        cell = cell_from_toml(text.encode(), "cell.toml")
        assert cell.file.session is not None
        if warned:
            with pytest.raises(ConfigError, match=r"found 30\.0 mm, expected 33\.0 to 70\.0 mm"):
                examine(cell)
        else:
            assert "grip" in {finding.what for finding in examine(cell, thorough=False).findings}


def test_nothing_is_written_where_something_cannot_be_met(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more in (["--mass", "9"], ["--point", "1,0,0,0"], ["--motion", "waypoints"], ["--size", "1,2"]):
        assert dispatch(["new", str(tmp_path / "c.toml"), *ASK, *more]) == 2
        assert ": found " in capsys.readouterr().err
    assert dispatch(["new", str(tmp_path / "c.toml"), "--arm", "wx200"]) == 2
    assert "--mass KG and --size X,Y,Z" in capsys.readouterr().err
    for name in ('a"b', "my cell", "7", "lärm", "c\udcff"):
        assert dispatch(["new", str(tmp_path / f"{name}.toml"), *ASK]) == 2
        assert ", expected a to z, then a to z, 0 to 9 and _, 32 at most; give the file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_vector_is_three_numbers() -> None:
    assert vector("1,-2,3e-1", "--by") == (1.0, -2.0, 0.3)
    with pytest.raises(WishError, match="--by: found '1,2'"):
        vector("1,2", "--by")


def test_it_asks_on_a_terminal(unhurried: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from agent.cli import make
    from agent.cli.main import app

    monkeypatch.setattr(make, "_asks", lambda: True)
    answers = "9\ntwo\n2\nwx200\nwx200\n0.1\n0.2,0.03,0.03\nfly\nlift\n0,0,0.03\n"
    path = tmp_path / "asked.toml"
    result = CliRunner().invoke(app, ["new", str(path), "--no-tune", "--height", "0.25"], input=answers)
    assert result.exit_code == 0, result.output
    assert load_cell(path).trajectory().at(6.0).p[2] == pytest.approx(0.28)
    assert [arm.file.model for arm in load_cell(path).arms] == ["wx200", "wx200"]


def test_way_points_are_given_or_not_before_anything_is_asked(
    unhurried: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from typer.testing import CliRunner

    from agent.cli import make
    from agent.cli.main import app

    def asked(*words: str, said: str) -> Any:
        return CliRunner().invoke(app, ["new", str(tmp_path / "a.toml"), "--no-tune", *words], input=said)

    monkeypatch.setattr(make, "_asks", lambda: True)
    ways = ["--point", "3,0,0,0.02", "--point", "6,0,0,0"]
    made = asked("--motion", "waypoints", *ways, said="2\nwx200\nwx200\n0.1\n0.2,0.03,0.03\n")
    assert made.exit_code == 0, made.output
    assert "Motion" not in made.output
    for words, why in (
        (["--motion", "waypoints"], "found 0 way-points"),
        (ways, "found 2 way-points"),
        (["--motion", "waypoints", "--by", "0,0,1", *ways], "found --by beside --point"),
    ):
        refused = asked(*words, "--force", said="")
        assert isinstance(refused.exception, WishError)
        assert why in str(refused.exception)
        assert "How many arms" not in refused.output


def test_enter_takes_every_default_that_is_shown() -> None:
    from typer.testing import CliRunner

    from agent.cli import make

    with CliRunner().isolation(input="\n" * 7):
        found = make._asked(None, None, make.MotionName.LIFT, None)
    assert found == (["wx250s", "wx250s"], 0.2, "0.2,0.1,0.04", make.MotionName.LIFT, make.BY["lift"])
