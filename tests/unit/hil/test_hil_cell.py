"""[hil] in a cell file: what is read, what is refused in one line, and what the check says of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import configs
from agent.cli.main import app
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.schema.driver import DriverKind
from agent.process.build import Connection, build_driver
from agent.process.rehearse import bridge, driver_of, holds, require_wall_clock, taken
from agent.process.run import RunOptions, run_cell
from agent.process.run_kind import RunKind
from agent.process.simulated import actuator_spec, lone_spec, plant_spec
from agent.verify.check import CheckReport, examine
from agent.verify.finding import Verdict
from agent.verify.rehearsal import examine_rehearsal
from drivers.interface import ConnectError
from sim_backend.hil.touch import Borne
from tests.support.starts import start_joints
from tests.support.stops import stop_flag

LOOP = 'hil.arms=["left"]'
SQUEEZE = (("left", 3.0), ("right", -3.0))


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
    q = start_joints(looped)[0]
    with pytest.raises(ConnectError, match="port of arm left: found none"):
        build_driver(looped, arm, DriverKind.DYNAMIXEL, Connection(plant_socket=Path("plant.sock")), q, print)
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
    with pytest.raises(ConfigError, match="found a run in lockstep, expected a rehearsal at the wall clock's pace"):
        require_wall_clock(cell(LOOP), real_time=False)
    require_wall_clock(cell(), real_time=False)
    for kind in set(RunKind) - {RunKind.HIL}:
        options = RunOptions(Path("two_wx200"), (LOOP,), 1.0, tmp_path / "out", 0, kind)
        refused = pytest.raises(ConfigError, match=f"found a run in {kind.value}, .*coop run CELL --hil")
        with stop_flag() as stop, refused:
            run_cell(options, stop, _Quiet())
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
        q = start_joints(looped)
        assert [set(arm.masses.tolist()) for arm in plant_spec(looped, q).arms] == [{twin_mass}, {1.3}]
        assert set(lone_spec(looped, q).arms[0].masses.tolist()) == {1.2}


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


def told(report: CheckReport, what: str) -> float:
    """The number at the beginning of what a finding says."""
    return float(next(f.found for f in report.findings if what in f.what).split()[0].rstrip("%"))


def test_an_arm_on_its_own_believes_in_an_object_that_it_does_not_hold() -> None:
    """So a heavier one makes it less stable; in the cell it is the other way round."""
    light, heavy = (examine(cell(LOOP, *more, name="paper")) for more in ((), ("object.mass_kg=0.5",)))
    assert told(light, "on its own") == pytest.approx(1.41, abs=0.01)
    assert told(heavy, "on its own") > told(light, "on its own") + 0.1


def test_what_the_object_asks_of_a_joint_is_its_weight_and_the_internal_force() -> None:
    squeezed = [f"arms.{arm}.internal_wrench_N_Nm=[{force},0.0,0.0,0.0,0.0,0.0]" for arm, force in SQUEEZE]
    assert told(examine(cell(LOOP)), "of the largest addition") <= 4.0
    assert told(examine(cell(LOOP, *squeezed)), "of the largest addition") >= 15.0


def test_an_arm_stands_against_the_touch_that_no_joint_must_give_more_for_than_it_may() -> None:
    """Found by trying all directions."""
    looped = cell(LOOP)
    arm, q = looped.arms[0], start_joints(looped)
    models = [looped.model(a) for a in looped.arms]
    findings = examine_rehearsal(looped, models, [[of_arm] for of_arm in q], [0.0])
    (found,) = [f.found for f in findings if "touch" in f.what]
    model, bound = models[0], actuator_spec(looped, arm).tau_max_Nm
    J = (model.task_basis.T @ model.jacobian(q[0]))[:3]
    lifted = np.array([0.0, 0.0, arm.entry.load_share * looped.file.object.mass_kg * 9.81])
    held = model.evaluate(q[0], np.zeros(arm.n)).g + J.T @ lifted
    away = [np.array([np.cos(a), 0.0, np.sin(a)]) for a in np.linspace(0.0, 2.0 * np.pi, 721)]
    least_N = min(float(((bound - np.sign(J.T @ to) * held) / np.abs(J.T @ to)).min()) for to in away)
    assert float(found.split()[0]) == pytest.approx(least_N, rel=0.02)


class _Clock:
    utc_offset_ns = 0

    def now_ns(self) -> int:
        return 0

    def sleep_until(self, deadline_ns: int) -> None: ...


def test_the_bridge_is_as_the_cell_says() -> None:
    said = (
        "tau_share=0.4",
        "damping_ratio=0.9",
        "ramp_s=0.5",
        "apart_max_rad=0.2",
        "touch_max_N=3.0",
        "touch_max_s=0.4",
    )
    looped = cell(LOOP, *(f"hil.{key}" for key in said), "hil.gripper_share_max=0.25", "hil.extra_cycles=1.0")
    arm, q = looped.arms[0], start_joints(looped)[0]
    nothing: Any = object()  # no driver is called
    made, emulated = (bridge(looped, arm, nothing, nothing, _Clock(), emulated=how) for how in (False, True))
    settings = made.coupling.settings
    np.testing.assert_allclose(settings.clamp_Nm, 0.4 * actuator_spec(looped, arm).tau_max_Nm)
    assert settings.frequency_rad_per_s == pytest.approx(0.2 / 0.0125)
    assert (settings.period_s, settings.damping_ratio, settings.ramp_s) == (0.005, 0.9, 0.5)
    assert (settings.apart_max_rad, settings.touch) == (0.2, Borne(3.0, 0.4))
    assert (made._patience.stale_s, emulated._patience.stale_s, made._patience.watchdog_s) == (0.015, 0.5, 0.2)
    assert made._gripper is not None
    carried, model = made._gripper._carried, looped.model(arm)
    assert carried.share_max == 0.25
    assert carried.friction_Nm.tolist() == [servo.coulomb_Nm.value for servo in arm.servos]
    rise = [
        [(looped.file.object.mass_kg * 9.81) * model.object_pose(q + dq).translation[2] for dq in (step, -step)]
        for step in 1e-5 * np.eye(arm.n)
    ]
    lifts = np.array([(up - down) / 2e-5 for up, down in rise])
    np.testing.assert_allclose(carried.weight(q), lifts, rtol=1e-4, atol=1e-6)


class _Quiet:
    def phase(self, what: str, *, still: bool = False) -> None: ...

    def note(self, text: str) -> None: ...

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None: ...
