"""The files a calibration writes: loaded again they are the calibrated cell, and its arms strain each other less."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import configs
from agent.atomic import WriteError
from agent.calibrate.chain import CalibrateError, chain_of
from agent.calibrate.result import Calibrated, arm_toml, calibrated, cell_toml
from agent.calibrate.run import calibrate, urdf_names, write
from agent.calibrate.show import lines
from agent.config.cell import Cell, cell_from_toml, load_cell
from agent.config.reality import reality_of
from agent.config.schema.reality import ArmReality, Reality
from agent.process.floating_cell import FloatOptions, floating_cell
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.servo.counts import TICK_RAD
from sim_backend.physics.snapshot import Observation
from tests.support.calibrate_rig import UNSURE, rig
from tests.support.command import coop
from tests.support.drawn_once import drawn_once
from tests.support.few import long
from tests.support.full_disk import full_for
from tests.support.plant.inprocess import simulate
from tests.support.telemetry.run_log import write_run

LOG = Path("run.mcap")
SEED = 0
LEFT_FLOATS = 'floating.arms=["left"]'
LEFT_AND_RIGHT = Path("two_wx200")
HOLDING = "floating.holding=true"
SOFT = ("simulation.reality.pads_N_per_m=1e4", "simulation.reality.pads_Nm_per_rad=50.0")


@pytest.fixture(scope="module", autouse=True)
def one_picture() -> Iterator[None]:
    with drawn_once("agent.calibrate.run", "figure"):
        yield


@cache
def in_error(name: str = "two_wx200") -> tuple[Calibrated, Cell]:
    """The calibration of a rig, and the rig's cell with its truth as the reality of a simulated one."""
    made = rig(name, SEED)
    real = {}
    for link, x in zip(made.chain.links, made.chain.parts(made.truth), strict=True):
        base, grasp = link.base @ x[: link.m], link.grasp @ x[link.m : 2 * link.m]
        real[link.arm.name] = ArmReality(
            base_m=tuple(base[:3]), base_rad=tuple(base[3:]), grasp_m=tuple(grasp[:3]), grasp_rad=tuple(grasp[3:]),
            zeros_rad=tuple(x[link.zeros]),
        )  # fmt: skip
    keys = [
        f"simulation.reality.arms.{arm}.{key}={list(value)}"
        for arm, reality in real.items()
        for key, value in reality.model_dump().items()
        if isinstance(value, tuple) and value
    ]
    cell = load_cell(Path(name), [*UNSURE, *keys, *SOFT, "controller.alignment.enabled=false"])
    return calibrated(cell, made.chain, made.poses), cell


def strain(cell: Cell, duration_s: float = 1.5) -> float:
    """Force with which two arms of equal shares pull against each other, rms once they have settled, N."""
    pulls: list[float] = []

    def see(t: float, truth: Observation) -> None:
        if t > 0.7:
            pulls.append(0.5 * float(np.linalg.norm((truth.grasp_wrench[0] - truth.grasp_wrench[1])[:3])))

    simulate(cell, duration_s, see=see)
    return float(np.sqrt(np.mean(np.square(pulls))))


def test_the_calibrated_cell_strains_a_quarter_of_what_it_did(tmp_path: Path) -> None:
    result, cell = in_error()
    files = write(result, [LOG], tmp_path)
    after = load_cell(files.cell)
    assert strain(after) <= 0.25 * strain(cell)


def test_the_truth_of_a_simulated_cell_stays_where_it_was(tmp_path: Path) -> None:
    result, cell = in_error()
    after = load_cell(write(result, [LOG], tmp_path).cell)
    before, rest = reality_of(cell), reality_of(after)
    assert isinstance(before, Reality)
    assert isinstance(rest, Reality)
    assert rest.pads_N_per_m == before.pads_N_per_m
    for old, new in zip(cell.arms, after.arms, strict=True):
        was, left = before.arms[old.name], rest.arms[old.name]
        np.testing.assert_allclose(
            np.add(new.entry.p_world_base_m, left.base_m), np.add(old.entry.p_world_base_m, was.base_m), atol=1e-6
        )
        np.testing.assert_allclose(
            np.add(new.entry.p_object_ee_m, left.grasp_m), np.add(old.entry.p_object_ee_m, was.grasp_m), atol=1e-6
        )
        ticks = np.array([n.zero_tick - o.zero_tick for n, o in zip(new.servos, old.servos, strict=True)])
        assert np.abs(ticks).max() > 0
        np.testing.assert_allclose(np.add(TICK_RAD * ticks, left.zeros_rad), was.zeros_rad, atol=1e-9)


def test_nothing_is_overwritten_and_nothing_written_beside_it(tmp_path: Path) -> None:
    result, _ = in_error()
    there = tmp_path / "two_wx200_calibrated_right.toml"
    there.write_text("mine")
    with pytest.raises(WriteError, match="right"):
        write(result, [LOG], tmp_path)
    assert list(tmp_path.iterdir()) == [there]
    assert there.read_text() == "mine"


@pytest.mark.parametrize("name", [".png", *map(long, ("_left.toml", "_right.toml", ".json")), "_calibrated.toml"])
def test_a_disk_that_is_full_is_told_with_the_file_and_the_next_attempt_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    result, _ = in_error()
    with monkeypatch.context() as patch:
        full_for(patch, name)
        with pytest.raises(WriteError, match=f"{name}: found No space left on device, expected room for it"):
            write(result, [LOG], tmp_path)
    assert not list(tmp_path.iterdir())
    assert load_cell(write(result, [LOG], tmp_path).cell).file.name == "two_wx200"


def test_what_does_not_agree_better_is_not_written(tmp_path: Path) -> None:
    result, _ = in_error()
    off_m, off_rad = result.after
    worse = replace(result, before=(5.0 * off_m, 5.0 * off_rad), after=(5.1 * off_m, 5.1 * off_rad))
    with pytest.raises(CalibrateError, match="nothing is written"):
        write(worse, [LOG], tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["two_wx200", "three_wx250s"])
@pytest.mark.parametrize("noise_rad", [0.0, 2e-3])
def test_a_calibrated_cell_calibrated_again_is_no_refusal_and_is_kept(
    tmp_path: Path, name: str, noise_rad: float
) -> None:
    """The fit is as far as it can be, so a second one does not mend what is left."""
    made = rig(name, SEED, noise_rad)
    found = calibrated(made.cell, made.chain, made.poses)
    again = replace(found, before=found.after)
    assert again.settled
    assert write(again, [LOG], tmp_path / "new") is None
    assert not list(tmp_path.iterdir())
    assert any("agrees already" in line for line in lines(again))
    assert not any("agrees already" in line for line in lines(found))


def test_the_command_says_that_a_file_agrees_already_and_ends_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, _ = in_error()
    monkeypatch.setattr("agent.calibrate.run.calibrate", lambda *_, **__: replace(result, before=result.after))
    (tmp_path / "run.mcap").touch()
    done = coop("calibrate", "run.mcap", "--out", "new", cwd=tmp_path)
    assert (done.code, "it is kept, and nothing is written" in done.out) == (0, True)
    found = json.loads(coop("calibrate", "run.mcap", "--out", "new", "--json", cwd=tmp_path).out)
    assert (found["settled"], found["better"], found["written"]) == (True, False, None)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("what", [0, 1], ids=["m", "rad"])
def test_what_readings_do_not_leave_by_themselves_is_not_called_settled(what: int) -> None:
    result, _ = in_error()
    assert not result.settled, "it is better"
    level = result.readings
    for times, settled in ((0.98, True), (1.02, False)):
        size = [0.5 * of for of in level]
        size[what] = times * level[what]
        same = tuple(np.full_like(v, of) for v, of in zip(result.before, size, strict=True))
        assert replace(result, before=same, after=same).settled == settled
    mended = tuple(np.full_like(v, 0.5 * of) for v, of in zip(result.before, level, strict=True))
    little = tuple(0.8 * v for v in mended)
    assert not replace(result, before=mended, after=little).settled, (
        "what is better is written, however little it was off"
    )
    assert result.readings == tuple(2.0 * of for of in result.grid)
    assert 1e-4 < result.grid[0] < 1.5e-4
    assert 5e-4 < result.grid[1] < 6e-4


def alone() -> Calibrated:
    """What comes of arms that move each by itself and stand far apart, with a wide tolerance for the fit."""
    made = rig("two_wx200", SEED)
    left, right = made.poses.q
    chain = replace(
        made.chain, links=tuple(replace(li, scale=np.where(li.scale > 0.0, 0.05, 0.0)) for li in made.chain.links)
    )
    return calibrated(load_cell(LEFT_AND_RIGHT), chain, replace(made.poses, q=(left, right[::-1] + 0.3)))


def test_arms_that_move_each_by_itself_calibrate_nothing_however_wide_the_tolerance_of_the_fit(tmp_path: Path) -> None:
    found = alone()
    assert found.better, "as is nearly every fit of arms that stood far apart"
    assert found.left[0] > found.explained[0]
    with pytest.raises(CalibrateError, match="see that every arm holds the object") as refused:
        write(found, [LOG], tmp_path)
    assert "disagreement of most poses held out: found" in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("what", [0, 1], ids=["m", "rad"])
def test_a_place_that_disagrees_is_refused_as_a_turn_is(tmp_path: Path, what: int) -> None:
    result, _ = in_error()
    most = [2.0 * left for left in result.left]
    assert replace(result, explained=(most[0], most[1])).agrees
    most[what] = 0.5 * result.left[what]
    with pytest.raises(CalibrateError, match="most poses held out"):
        write(replace(result, explained=(most[0], most[1])), [LOG], tmp_path)


@pytest.mark.parametrize("name", ["two_wx200", "three_wx250s"])
def test_an_honest_calibration_is_far_within_what_the_shipped_tolerance_has(name: str) -> None:
    made = rig(name, SEED, 2e-3)
    found = calibrated(load_cell(Path(name)), made.chain, made.poses)
    assert 5.0 * found.left[0] < found.explained[0] < 0.01
    assert 5.0 * found.left[1] < found.explained[1] < 0.05


def test_a_grasp_that_slips_in_a_few_poses_held_out_refuses_nothing() -> None:
    made = rig("two_wx200", SEED)
    q = [angles.copy() for angles in made.poses.q]
    q[0][np.flatnonzero(made.poses.held_out)[:4]] += 0.05
    found = calibrated(load_cell(LEFT_AND_RIGHT), made.chain, replace(made.poses, q=tuple(q)))
    assert found.judged[1] > found.explained[0], "their mean square is more than the tolerance has"
    assert found.agrees


def test_a_zero_beyond_the_scale_is_refused() -> None:
    arm = load_cell(Path("two_wx200")).arms[0]
    with pytest.raises(CalibrateError, match="zero of joint elbow"):
        arm_toml(arm, np.array([0.0, 4.0, 0.0]))


def test_changes_other_than_of_the_tolerance_are_refused() -> None:
    with pytest.raises(CalibrateError, match=r"tolerance\.KEY"):
        calibrate([LOG], ["rate_hz=100.0"])


def rows_at(second: int) -> NDArray[np.void]:
    """Three rows of an arm in that second."""
    rows = np.zeros(3, AGENT_STATE.dtype)
    rows["utc_ns"] = 1_000_000_000 * second + np.arange(3)
    return rows


def test_logs_of_two_cells_are_refused(tmp_path: Path) -> None:
    logs = []
    for number, changes in enumerate([[], ["arms.left.p_world_base_m=[0.001,0.0,0.23]"], [LEFT_FLOATS, HOLDING]]):
        cell = load_cell(LEFT_AND_RIGHT, changes)
        folder = tmp_path / str(number)
        folder.mkdir()
        logs.append(write_run(folder / "run.mcap", cell, {"left": rows_at(number)}))
    with pytest.raises(CalibrateError, match="found another one: arms differ"):
        calibrate(logs[:2])
    with pytest.raises(CalibrateError, match="no rows of right"):
        calibrate([logs[0], logs[2]])


def test_a_rehearsal_is_refused_whose_arms_agree_by_construction(tmp_path: Path) -> None:
    cell = load_cell(LEFT_AND_RIGHT, ['hil.arms=["left"]'])
    log = write_run(tmp_path / "run.mcap", cell, {arm: np.zeros(3, AGENT_STATE.dtype) for arm in ("left", "right")})
    with pytest.raises(CalibrateError, match=r"run.mcap: found a rehearsal: arms in the loop \(left\) follow"):
        calibrate([log])


@pytest.mark.parametrize("apart", [0, 1])
def test_arms_that_floated_without_the_object_are_refused_in_whichever_log(tmp_path: Path, apart: int) -> None:
    logs = []
    for number in range(2):
        cell = load_cell(LEFT_AND_RIGHT, [LEFT_FLOATS, *([] if number == apart else [HOLDING])])
        logs.append(write_run(tmp_path / f"{number}.mcap", cell, {"left": rows_at(number)}))
    told = rf"{apart}.mcap: found arms that float without the object \(left\), .*--holding"
    with pytest.raises(CalibrateError, match=told):
        calibrate(logs)


@pytest.mark.parametrize("again", ["itself", "a copy", "a link"])
def test_one_log_given_twice_is_refused(tmp_path: Path, again: str) -> None:
    log = write_run(tmp_path / "run.mcap", load_cell(LEFT_AND_RIGHT), {"left": rows_at(1)})
    other = log if again == "itself" else tmp_path / "other.mcap"
    if again == "a copy":
        other.write_bytes(log.read_bytes())
    elif again == "a link":
        other.symlink_to(log)
    with pytest.raises(CalibrateError, match=f"{other.name}: found rows of arm left that stand in both"):
        calibrate([log, other])


def test_arms_that_floated_work_by_the_calibrated_cell() -> None:
    result, _ = in_error()
    floated = floating_cell(FloatOptions(LEFT_AND_RIGHT, ("left", "right"), holding=True))
    written = cell_toml(replace(result, cell=floated), "a log", ["left.toml", "right.toml"])
    assert "floating" not in written
    assert "# the gripper points down" in written


def test_line_ends_of_the_cell_stay_and_its_comments_are_one_line_each() -> None:
    result, real = in_error()
    text, names = b"# once\xe2\x80\xa8[floating]\n" + real.toml, ["left.toml", "right.toml"]
    cells = [cell_from_toml(each, "of a log") for each in (text, text.replace(b"\n", b"\r\n"))]
    of_unix, of_dos = (cell_toml(replace(result, cell=cell), "a log", names) for cell in cells)
    assert of_unix.startswith("# once\u2028[floating]\n")
    assert "[simulation.reality" in of_unix
    assert of_dos == of_unix.replace("\n", "\r\n")


def test_comments_of_the_cell_stay_and_say_what_moved(tmp_path: Path) -> None:
    made = rig("three_wx250s", SEED)
    cell = load_cell(Path("three_wx250s"))
    files = write(calibrated(cell, made.chain, made.poses), [LOG], tmp_path)
    text = files.cell.read_text()
    assert "# Three WidowX-250 arms with six joints" in text
    assert text.count("# calibrated from run.mcap: moved by") == 6
    assert "# calibrated, was 2048" in files.arms[0].read_text()
    assert load_cell(files.cell).arms[0].entry.arm_file == files.arms[0].name
    assert "simulation.reality" not in text


def with_urdfs(folder: Path, named: str, urdfs: dict[str, str]) -> Calibrated:
    """The calibration of arms that have a file of their own in a folder of their own, with a URDF of this name there.

    urdfs: text by arm; an arm without one has the file that ships.
    """
    made = rig("two_wx200", SEED)
    arm = (configs.ARMS_DIR / "wx200.toml").read_text().replace('urdf = "wx200.urdf"', f'urdf = "{named}"')
    text = (configs.CELLS_DIR / "two_wx200.toml").read_text()
    for name, urdf in urdfs.items():
        own = folder / "source" / name
        own.mkdir(parents=True)
        (own / "arm.toml").write_text(arm)
        (own / named).write_text(urdf)
        text = text.replace(f'name = "{name}"\n', f'name = "{name}"\narm_file = "{name}/arm.toml"\n')
    (folder / "source" / "cell.toml").write_text(text)
    cell = load_cell(folder / "source" / "cell.toml", UNSURE)
    return calibrated(cell, chain_of(cell), made.poses)


URDF = (configs.ARMS_DIR / "wx200.urdf").read_text()
LIGHTER = URDF.replace('<mass value="0.540142"/>', '<mass value="0.5"/>')


@pytest.mark.parametrize(
    ("named", "urdfs", "written"),
    [
        ("my.urdf", {"left": URDF, "right": LIGHTER}, {"my.urdf": URDF, "my_right.urdf": LIGHTER}),
        ("my.urdf", {"left": LIGHTER, "right": LIGHTER}, {"my.urdf": LIGHTER}),
        ("wx200.urdf", {"left": LIGHTER}, {"wx200_left.urdf": LIGHTER}),
    ],
    ids=["two of one name", "one for both", "one named as that which ships"],
)
def test_each_arm_keeps_its_own_urdf(
    tmp_path: Path, named: str, urdfs: dict[str, str], written: dict[str, str]
) -> None:
    result = with_urdfs(tmp_path, named, urdfs)
    files = write(result, [LOG], tmp_path / "out")
    assert {path.name: path.read_text() for path in (tmp_path / "out").glob("*.urdf")} == written
    before, after = result.cell.arms, load_cell(files.cell).arms
    assert [arm.urdf_xml for arm in after] == [arm.urdf_xml for arm in before]
    for arm, path in zip(after, files.arms, strict=True):
        renamed = arm.own_urdf and arm.file.urdf != named
        assert (f"# was {named}, the name of another arm's" in path.read_text()) is renamed


def test_another_file_by_the_name_of_a_urdf_that_ships_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    result = with_urdfs(tmp_path, "my.urdf", {"left": URDF})
    out = tmp_path / "out"
    out.mkdir()
    (out / "wx200.urdf").write_text(LIGHTER)
    with pytest.raises(WriteError, match=r"wx200\.urdf: found another one than that of this name which ships"):
        write(result, [LOG], out)
    assert [path.name for path in out.iterdir()] == ["wx200.urdf"]
    (out / "wx200.urdf").write_text(URDF)
    write(result, [LOG], out)


def test_a_name_that_a_third_arm_has_is_not_taken_either() -> None:
    arms = load_cell(Path("three_wx250s")).arms
    own = [
        replace(arm, file=arm.file.model_copy(update={"urdf": name}), urdf_xml=text, own_urdf=True)
        for arm, name, text in zip(arms, ("my.urdf", f"my_{arms[2].name}.urdf", "my.urdf"), "abc", strict=True)
    ]
    assert urdf_names(own) == ["my.urdf", f"my_{arms[2].name}.urdf", f"my_{arms[2].name}_{arms[2].name}.urdf"]
