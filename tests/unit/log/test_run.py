"""`load` gives the rows of the file by arm, name and time, and columns whose names have component and unit."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import numpy as np
import pytest

from agent.control.regressor import arm_parameters
from agent.log import Run, load
from agent.log.columns import ColumnFileError
from agent.log.flat import Members, flat_columns
from agent.log.read import LogError
from agent.log.run import MissingPackage, NoSuchField
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT
from tests.support.runner_rig import paper
from tests.support.telemetry.log_maker import LogMaker, make_log
from tests.support.telemetry.telemetry_cell import make_rows

ARMS = ("left", "right")
JOINTS = ("waist", "shoulder", "elbow")
NAMES = Members(ARMS, (JOINTS, JOINTS[:2]))


Made = tuple[Run, dict[str, np.ndarray]]


@pytest.fixture
def made(tmp_path: Path) -> Made:
    rows = make_log(tmp_path / "run.mcap")
    return load(str(tmp_path / "run.mcap")), rows


def test_arrays_are_the_rows_without_what_is_not_there(made: Made) -> None:
    run, rows = made
    assert run.arms == ARMS
    for name in ARMS:
        own = run[name]
        assert len(own) == 100
        for field in own.fields:
            expected = rows[name][field]
            if expected.ndim == 2 and expected.shape[1] == 7:
                expected = expected[:, :3]
            assert np.array_equal(own[field], expected), field
    assert run.plant is not None
    assert np.array_equal(run.plant["grasp_wrench"], rows["plant"]["grasp_wrench"])
    assert (run.complete, run.problems, run.gaps["left"]) == (True, (), ())


def test_rows_are_chosen_by_time_and_by_anything(made: Made) -> None:
    run, rows = made
    some = run["left"].between(0.1, 0.2)
    assert np.array_equal(some["sequence"], np.arange(20, 40)), "the first second is in, the last is not"
    assert np.array_equal(
        some.where(some["q"][:, 0] > 0)["tau_cmd"], rows["left"][20:40][some["q"][:, 0] > 0]["tau_cmd"][:, :3]
    )
    assert len(run["left"].between(5.0, 6.0)) == 0
    assert repr(some) == "<left: 20 rows, 0.100 s to 0.195 s, 62 fields>"


def waited(path: Path) -> Run:
    """A log in which the arms waited a quarter of a second for the start, which is where their time begins."""
    maker = LogMaker(path)
    for member in (*ARMS, PLANT):
        rows = make_rows(member, 100)
        rows["t"] -= 0.0 if member == PLANT else 0.25
        maker.write(member, rows)
    maker.flush()
    maker.finish()
    return load(path)


def test_the_plant_s_rows_of_a_time_are_those_of_the_arms(tmp_path: Path) -> None:
    run = waited(tmp_path / "run.mcap")
    assert run.plant is not None
    left, plant = run["left"].between(0.0, 0.1), run.plant.between(0.0, 0.1)
    assert np.array_equal(left["stamp_ns"], plant["stamp_ns"])
    assert plant["sequence"].tolist() == list(range(50, 70))
    assert run.plant.frame("energy").index[0] == pytest.approx(-0.25)
    assert run.plant.about("t") == run["left"].about("t") == "time since the trajectory's zero [s]"


def test_a_frame_has_the_columns_under_their_names_and_the_time_as_index(
    made: Made,
) -> None:
    run, rows = made
    frame = run["right"].frame("q", "e_eta")
    assert list(frame.columns) == ["q_joint_1_rad", "q_joint_2_rad", "q_joint_3_rad", "e_eta"]
    assert frame.index.name == "t_s"
    assert np.array_equal(frame.index, rows["right"]["t"])
    assert np.array_equal(frame["q_joint_2_rad"], rows["right"]["q"][:, 1])


def test_without_pandas_a_frame_is_refused_and_arrays_are_not(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackage, match=r"widowx-coop\[analysis\]"):
        made[0]["left"].frame("q")
    assert list(made[0]["left"].columns("t")) == ["t_s"]


def test_what_is_not_there_is_named_with_what_is(made: Made) -> None:
    run, _ = made
    with pytest.raises(KeyError, match="found 'middle', expected one of left, right, plant"):
        run["middle"]
    for ask in (run["left"].__getitem__, run["left"].about, run["left"].frame):
        with pytest.raises(NoSuchField, match="found 'nothing', expected one of sequence, stamp_ns"):
            ask("nothing")


def test_a_field_says_what_it_means(made: Made) -> None:
    assert made[0]["left"].about("tau_sent") == "what the driver says it really commanded [N·m]"
    assert made[0]["left"].about("e_eta") == "scalar part of the attitude error quaternion"


def test_friction_says_which_way_it_acts_where_one_name_has_two_signs(made: Made) -> None:
    run, _ = made
    assert (
        run["left"].about("tau_friction")
        == "friction feed-forward, along the motion: against the joint's friction [N·m]"
    )
    assert run["plant"].about("tau_friction") == "friction as it acts on the joint, against the motion [N·m]"


def test_the_temporary_file_goes_with_the_run(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap")
    with load(tmp_path / "run.mcap", folder=tmp_path) as run:
        q = run["left"]["q"]
    with pytest.raises(ColumnFileError, match="found a run that has been closed"):
        run["left"]["q"]
    assert q.shape == (100, 3)
    run.close()
    load(tmp_path / "run.mcap")
    gc.collect()  # a file that nobody closed would warn, and a warning is an error here


def test_rows_keep_their_run_open(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap")
    rows = load(tmp_path / "run.mcap")["left"].between(0.1, 0.2)
    gc.collect()
    assert rows["q"].shape == (20, 3)


def test_no_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot read"):
        load(tmp_path / "nothing.mcap")


# ------------------------------------------------------------------------------------------------------- column names


def names(member: str) -> dict[str, list[str]]:
    layout = PLANT_STATE if member == "plant" else AGENT_STATE
    found: dict[str, list[str]] = {}
    for c in flat_columns(layout.fields, member, NAMES):
        found.setdefault(c.field, []).append(c.name)
    return found


def test_names_of_an_arms_columns_have_component_and_unit_once() -> None:
    left, right = names("left"), names("right")
    assert left["t"] == ["t_s"]
    assert left["late_s"] == ["late_s"]
    assert left["stamp_ns"] == ["stamp_ns"]
    assert left["dq"] == ["dq_waist_rad_per_s", "dq_shoulder_rad_per_s", "dq_elbow_rad_per_s"]
    assert right["tau_cmd"] == ["tau_cmd_waist_Nm", "tau_cmd_shoulder_Nm"]
    assert left["quat_object"] == [f"quat_object_{axis}" for axis in "wxyz"]
    assert left["e_p"] == ["e_p_x_m", "e_p_y_m", "e_p_z_m"]
    assert left["a_object_des"][2:4] == ["a_object_des_z_m_per_s2", "a_object_des_rx_rad_per_s2"]
    assert left["wrench_cmd"][2:4] == ["wrench_cmd_z_N", "wrench_cmd_rx_Nm"]
    assert left["unexpected"] == ["unexpected_0_N", "unexpected_1_Nm", "unexpected_2_N", "unexpected_3_Nm"]
    assert len(left["theta_arm"]) == 48
    assert len(right["theta_arm"]) == 32


def test_each_number_of_an_estimate_says_what_it_is_in_the_order_that_the_law_has() -> None:
    model, joints = paper().model(paper().arms[0]), JOINTS
    found = {c.name: c for c in flat_columns(AGENT_STATE.fields, "left", Members(("left",), (joints,)))}
    theta = arm_parameters(model)
    inertias = [model.model.inertias[j] for j in range(1, model.n + 1)]
    at = {c.doc.rpartition(": ")[2]: (c.index, c.unit) for c in found.values() if c.field == "theta_arm"}
    for j, inertia in enumerate(inertias):
        assert theta[at[f"mass of link {joints[j]}"][0]] == inertia.mass
        assert theta[at[f"first moment y of link {joints[j]}"][0]] == pytest.approx(inertia.mass * inertia.lever[1])
    assert at["inertia zz of link elbow"] == (29, "kg·m²")
    assert at["rotor inertia of joint waist"] == (30, "kg·m²")
    assert at["viscous friction of joint shoulder"] == (34, "N·m·s/rad")
    assert at["breakaway load of joint elbow"] == (47, "")
    told = found["theta_object_8"]
    assert (told.doc, told.unit) == ("adaptive object estimate before this tick: inertia yz of the object", "kg·m²")
    assert (found["theta_arm_47"].index, len([c for c in found.values() if c.field == "theta_object"])) == (47, 10)


def test_names_of_the_plants_columns_have_the_arm() -> None:
    plant = names("plant")
    assert plant["contact_error_m"] == ["contact_error_left_m", "contact_error_right_m"]
    assert plant["grasp_wrench"][5:7] == ["grasp_wrench_left_rz_Nm", "grasp_wrench_right_x_N"]
    assert plant["q"] == [
        "q_left_waist_rad",
        "q_left_shoulder_rad",
        "q_left_elbow_rad",
        "q_right_waist_rad",
        "q_right_shoulder_rad",
    ]
    assert plant["energy"] == ["energy_J"]


@pytest.mark.parametrize("member", ["left", "right", "plant"])
def test_no_two_columns_have_one_name_and_none_needs_quotes(member: str) -> None:
    found = [name for own in names(member).values() for name in own]
    assert len(found) == len(set(found))
    assert all(name.isidentifier() and name.isascii() for name in found)


def test_a_column_is_the_number_that_its_name_says() -> None:
    layout = PLANT_STATE
    rows = np.arange(2 * 56.0).reshape(2, 56)
    q = {c.name: c for c in flat_columns(layout.fields, "plant", NAMES) if c.field == "q"}
    assert q["q_right_shoulder_rad"].of(rows).tolist() == [8.0, 64.0]
