"""An arm file of one's own: read beside the cell, carried by its bytes, and apart from what ships."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import configs
from agent import atomic
from agent.atomic import WriteError, write_atomically
from agent.config.cell import Cell, ConfigError, cell_from_toml, load_cell
from agent.host.info import attachments
from agent.log.read import RunLog
from agent.replay.source import recorded_cell
from agent.view.drawing import drawing_of_cell, drawing_of_log

CELL = (configs.CELLS_DIR / "two_wx200.toml").read_text()
ARM = (configs.ARMS_DIR / "wx200.toml").read_text()
OTHER = (configs.ARMS_DIR / "wx250s.toml").read_text()
URDF = (configs.ARMS_DIR / "wx200.urdf").read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cell whose left arm has a file of its own, one folder below."""
    (tmp_path / "arms").mkdir()
    own = ARM.replace("coulomb_Nm = { value = 0.2,", "coulomb_Nm = { value = 0.31,")
    assert own != ARM
    (tmp_path / "arms/left.toml").write_text(own)
    (tmp_path / "cell.toml").write_text(
        CELL.replace('model = "wx200"\n', 'model = "wx200"\narm_file = "arms/left.toml"\n', 1)
    )
    return tmp_path


def coulomb(cell: Cell) -> list[float]:
    return [arm.servos[0].coulomb_Nm.value for arm in cell.arms]


def log_of(cell: Cell) -> RunLog:
    return RunLog(
        path=Path("run.mcap"), cell=cell.file.name, agents={}, plant=None, events=[],
        attachments=attachments(cell, b"{}"), metadata={}, complete=True, gaps={},
    )  # fmt: skip


def test_it_stands_for_this_arm_alone_and_the_cell_carries_it(folder: Path) -> None:
    cell = load_cell(folder / "cell.toml")
    assert coulomb(cell) == [0.31, 0.2]
    again = cell_from_toml(cell.toml, "cell.toml")
    assert coulomb(again) == [0.31, 0.2]
    assert again.fingerprint == cell.fingerprint
    assert "arms/left.toml" in tomllib.loads(cell.toml.decode())["embedded"]


def test_another_figure_is_another_fingerprint(folder: Path) -> None:
    before = load_cell(folder / "cell.toml").fingerprint
    (folder / "arms/left.toml").write_text(ARM)
    assert load_cell(folder / "cell.toml").fingerprint != before


def test_its_urdf_may_stand_beside_it_and_else_is_the_one_that_ships(folder: Path) -> None:
    lighter = URDF.replace('<mass value="0.540142"/>', '<mass value="0.5"/>')
    shipped = load_cell(folder / "cell.toml")
    (folder / "arms/wx200.urdf").write_text(lighter)
    own = load_cell(folder / "cell.toml")
    assert [arm.urdf_xml == URDF for arm in shipped.arms] == [True, True]
    assert [arm.urdf_xml == lighter for arm in own.arms] == [True, False]


@pytest.mark.parametrize("with_urdf", [False, True])
def test_a_log_carries_it_and_replays_and_shows_it(folder: Path, with_urdf: bool) -> None:
    if with_urdf:
        (folder / "arms/wx200.urdf").write_text(URDF.replace('<mass value="0.540142"/>', '<mass value="0.5"/>'))
    cell = load_cell(folder / "cell.toml")
    log = log_of(cell)
    again = recorded_cell(log)
    assert again.fingerprint == cell.fingerprint
    assert coulomb(again) == [0.31, 0.2]
    assert [arm.urdf_xml for arm in drawing_of_log(log).arms] == [arm.urdf_xml for arm in cell.arms]
    assert drawing_of_log(log) == drawing_of_cell(cell)
    # the right arm has the file that ships, and that is there whatever the left one has
    assert log.attachments["wx200.toml"] == ARM.encode()
    assert log.attachments["wx200.urdf"] == URDF.encode()


def test_what_ships_keeps_its_name_in_a_log_whichever_arm_has_its_own(folder: Path) -> None:
    (folder / "arms/wx200.urdf").write_text(URDF.replace('<mass value="0.540142"/>', '<mass value="0.5"/>'))
    (folder / "right.toml").write_text(CELL)
    cell = load_cell(folder / "right.toml", ['arms.right.arm_file="arms/left.toml"'])
    files = attachments(cell, b"{}")
    assert (files["wx200.toml"], files["wx200.urdf"]) == (ARM.encode(), URDF.encode())
    assert recorded_cell(log_of(cell)).fingerprint == cell.fingerprint


def test_an_override_names_one_too(folder: Path) -> None:
    cell = load_cell(folder / "cell.toml", ['arms.right.arm_file="arms/left.toml"'])
    assert coulomb(cell) == [0.31, 0.31]


def test_a_cell_that_carries_one_takes_up_another(folder: Path) -> None:
    carried = load_cell(folder / "cell.toml").toml.decode()
    (folder / "arms/right.toml").write_text(ARM.replace("coulomb_Nm = { value = 0.2,", "coulomb_Nm = { value = 0.4,"))
    head, tail = carried.split('name = "right"', 1)
    (folder / "more.toml").write_text(f'{head}name = "right"\narm_file = "arms/right.toml"{tail}')
    assert coulomb(load_cell(folder / "more.toml")) == [0.31, 0.4]


@pytest.mark.parametrize(("load", "breakaway", "taken"), [(0.5, 0.49, True), (0.5, 0.5, False), (1.0, 0.0, False)])
def test_friction_that_grows_with_the_load_leaves_a_part_of_it(
    folder: Path, load: float, breakaway: float, *, taken: bool
) -> None:
    """At 1 no motor would move the joint, whatever it gives; the simulated joint knows no such friction either."""
    says = '{{ value = {}, status = "estimated", source = "our own" }}'.format
    keys = ("stribeck_rad_per_s", 1.0), ("load_friction", load), ("breakaway_load_friction", breakaway)
    text = "".join(f"{key} = {says(value)}\n" for key, value in keys)
    (folder / "arms/left.toml").write_text(
        ARM.replace("coulomb_Nm = { value = 0.2,", f"{text}coulomb_Nm = {{ value = 0.2,", 1)
    )
    if taken:
        assert load_cell(folder / "cell.toml").arms[0].servos[0].load_friction.value == load
        return
    with pytest.raises(
        ConfigError,
        match=r"load_friction in arms/left\.toml: found 1 with breakaway_load_friction, expected together less",
    ):
        load_cell(folder / "cell.toml")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda f: (f / "arms/left.toml").unlink(), r"arm left in cell\.toml: found arms/left\.toml: No such file"),
        (lambda f: (f / "arms/left.toml").write_bytes(b"\xff"), "not UTF-8 text"),
        (lambda f: (f / "arms/left.toml").write_text("= 1"), r"left\.toml: found .*expected TOML"),
        (lambda f: (f / "arms/left.toml").write_text("format = 1"), r"left\.toml.*found nothing"),
        (lambda f: (f / "arms/left.toml").write_text(OTHER), "a file of a wx250s"),
    ],
)  # fmt: skip
def test_one_that_cannot_be_is_refused_by_name(folder: Path, change: object, match: str) -> None:
    change(folder)  # type: ignore[operator]
    with pytest.raises(ConfigError, match=match):
        load_cell(folder / "cell.toml")


def test_bytes_without_it_are_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"whose text is not in the cell's bytes"):
        cell_from_toml((folder / "cell.toml").read_bytes(), "cell.toml")


def test_nothing_is_written_into_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site-packages" / "configs"
    (package / "arms").mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.setattr(atomic.configs, "__file__", str(package / "__init__.py"))
    with pytest.raises(WriteError, match="a place in the installed package"):
        write_atomically(package / "arms" / "wx200.toml", b"")
    (tmp_path / "link").symlink_to(package / "arms")
    with pytest.raises(WriteError, match="a place in the installed package"):
        write_atomically(tmp_path / "link" / "wx200.toml", b"")
    write_atomically(tmp_path / "wx200.toml", b"mine")
    (package.parent / "pyproject.toml").touch()  # a checkout: whoever works on the sources may
    write_atomically(package / "arms" / "wx200.toml", b"mine")
