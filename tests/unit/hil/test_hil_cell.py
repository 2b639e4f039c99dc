"""[hil] in a cell file: what is read, what is refused in one line, and what the check says of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

import configs
from agent.cli.main import app
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.schema.cell import DriverKind
from agent.process.build import Connection, build_driver
from agent.process.rehearse import driver_of, holds, require_wall_clock, taken
from agent.process.run import RunOptions, run_cell
from agent.process.run_kind import RunKind
from agent.process.simulated import lone_spec, plant_spec
from agent.verify.check import CheckReport, examine
from agent.verify.finding import Verdict
from drivers.interface import ConnectError

LOOP = 'hil.arms=["left"]'


def cell(*changes: str, name: str = "two_wx200") -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", changes)


def test_nothing_is_in_the_loop_unless_the_file_says_so() -> None:
    assert cell().file.hil is None
    assert not [f for f in examine(cell()).findings if "twin" in f.what or "own" in f.what]
    hil = cell(LOOP).file.hil
    assert hil is not None
    assert (hil.arms, hil.frequency(200.0), hil.tau_share) == (["left"], 25.0, 1.0)
    slower = cell(LOOP, "hil.extra_cycles=2.0").file.hil
    assert slower is not None
    assert slower.frequency(200.0) == pytest.approx(0.2 / 0.0175)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (('hil.arms=["middle"]',), "hil.arms.*found middle, expected left or right"),
        (("hil.arms=[]",), "hil.arms"),
        (('hil.arms=["left", "left"]',), "expected different arms"),
        ((LOOP, "hil.frequency_rad_per_s=45.0"), "45 rad/s, 7.5 ms of delay: 0.34, expected a product ≤ 0.3"),
        ((LOOP, "hil.frequency_rad_per_s=25.0", "hil.extra_cycles=1.0"), "25 rad/s, 12.5 ms of delay: 0.31"),
        ((LOOP, "hil.tau_share=1.5"), "hil.tau_share"),
        ((LOOP, 'driver="dynamixel"'), 'expected driver = "sim"; .*remove .hil. for the real carry'),
    ],
)
def test_what_cannot_be_rehearsed_is_refused_in_one_line(changes: tuple[str, ...], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        cell(*changes)
    assert "\n" not in str(caught.value)


def test_an_arm_in_the_loop_needs_a_port_and_a_plant() -> None:
    looped = cell(LOOP)
    bare = looped.arms[0].entry.model_copy(update={"dynamixel": None})
    arm = type(looped.arms[0])(bare, *(getattr(looped.arms[0], k) for k in ("file", "toml", "urdf_xml", "servos")))
    q = examine(looped).q_start[0]
    with pytest.raises(ConnectError, match="port of arm left: found none"):
        build_driver(looped, arm, DriverKind.DYNAMIXEL, Connection(Path("plant.sock")), q, print)
    with pytest.raises(ConnectError, match="twin of arm left: found no plant socket"):
        build_driver(looped, looped.arms[0], DriverKind.DYNAMIXEL, Connection(), q, print)


def test_each_arm_has_the_driver_that_hil_gives_it_and_no_other() -> None:
    looped = cell(LOOP)
    assert driver_of(looped, "left", None) is DriverKind.DYNAMIXEL
    assert driver_of(looped, "right", None) is DriverKind.SIM
    assert driver_of(cell(), "left", DriverKind.DYNAMIXEL) is DriverKind.DYNAMIXEL
    for arm, asked in (("left", DriverKind.SIM), ("right", DriverKind.DYNAMIXEL)):
        with pytest.raises(ConfigError, match=f"driver of arm {arm}: found {asked.value}, .*by .hil."):
            driver_of(looped, arm, asked)


def test_real_arms_and_their_simulated_partners_hold_and_nothing_does_that_is_emulated() -> None:
    real, simulated = DriverKind.DYNAMIXEL, DriverKind.SIM
    for given, kind, emulated, expected in (
        (cell(LOOP), real, False, True),
        (cell(LOOP), simulated, False, True),
        (cell(LOOP), real, True, False),
        (cell(LOOP), simulated, True, False),
        (cell(), real, False, True),
        (cell(), simulated, False, False),
    ):
        assert holds(given, kind, emulated=emulated, asked=None) is expected
        assert holds(given, kind, emulated=emulated, asked=not expected) is not expected


def test_a_rehearsal_in_lockstep_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found a run in lockstep, expected one at the wall clock's pace"):
        require_wall_clock(cell(LOOP), real_time=False)
    require_wall_clock(cell(), real_time=False)
    options = RunOptions(Path("two_wx200"), (LOOP,), 1.0, tmp_path / "out", 0, RunKind.LOCKSTEP)
    with pytest.raises(ConfigError, match="coop run CELL --hil"):
        run_cell(options, lambda: False, _Quiet())
    assert not (tmp_path / "out").exists()


@pytest.mark.fault("H7")
def test_an_arm_of_which_nobody_says_that_its_gripper_is_empty_does_not_start(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(cell(LOOP).toml)
    ran = CliRunner().invoke(app, ["agent", str(file), "--arm", "left", "--ring", str(tmp_path / "ring")])
    assert "gripper of arm left: found nobody who says that it is empty" in str(ran.exception)
    assert not (tmp_path / "ring").exists()


def test_an_arm_without_a_port_does_not_start(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    shipped = (configs.CELLS_DIR / "two_wx200.toml").read_text().splitlines()
    file.write_text("\n".join([*(line for line in shipped if not line.startswith("dynamixel")), "[hil]", LOOP[4:]]))
    ran = CliRunner().invoke(
        app, ["agent", str(file), "--arm", "left", "--gripper-empty", "--ring", str(tmp_path / "r")]
    )
    assert "port of arm left: found none in the cell file" in str(ran.exception)
    assert not (tmp_path / "r").exists()


def test_a_word_counts_once(tmp_path: Path) -> None:
    word = tmp_path / "left"
    assert not taken(None)
    assert not taken(word)
    word.touch()
    assert taken(word)
    assert not taken(word)


def test_what_is_otherwise_about_an_arm_is_so_about_the_real_one_and_not_its_twin() -> None:
    off = "simulation.reality.arms={left={masses=1.2},right={masses=1.3}}"
    for looped, twin_mass in ((cell(off), 1.2), (cell(off, LOOP), 1.0)):
        q = examine(looped).q_start
        assert [arm.masses for arm in plant_spec(looped, q).arms] == [twin_mass, 1.3]
        assert lone_spec(looped, q).arms[0].masses == 1.2


def found(report: CheckReport, what: str) -> Verdict:
    return next(f.verdict for f in report.findings if what in f.what)


def test_the_check_knows_the_arm_on_its_own_and_the_clamp() -> None:
    good = examine(cell(LOOP))
    for what in ("on its own", "times its delay", "of the largest addition", "port of the arm"):
        assert found(good, what) is Verdict.OK, what
    assert good.ok
    lost = examine(cell(LOOP, name="paper"))
    assert found(lost, "on its own") is Verdict.REFUSED, "the printed gains are lost without the object"
    assert not lost.ok
    assert found(examine(cell(LOOP, "hil.tau_share=0.02")), "of the largest addition") is Verdict.REFUSED


class _Quiet:
    def phase(self, what: str) -> None: ...

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None: ...
