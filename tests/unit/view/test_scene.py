"""Everything in a picture stands where the log and the models say, and what is no number spoils nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from agent.config.cell import load_cell
from agent.config.reading import ConfigError
from agent.log.quaternions import product
from agent.log.read import RunLog
from agent.report.prepared import prepare
from agent.view.arm import ArmBody
from agent.view.drawing import drawing_of_cell, drawing_of_log
from agent.view.error import ViewError
from agent.view.motion import Motion, joined, motion_now, motion_of
from agent.view.pose import exaggerated, matrices, moved, poses, sizes
from agent.view.scene import ARROW_M, ARROW_MAX_M, DESIRED, OBJECT, Scene
from agent.view.shapes import Mesh, ball, box, box_edges, cylinder
from tests.support.telemetry.synthetic_run import OFFSETS, SQUEEZE_N
from tests.support.view_run import paper_cell, view_log, view_run

RED = (200, 0, 0)


def volume(mesh: Mesh) -> float:
    """By the divergence theorem: positive only when every face looks outward."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box(np.array([0.1, 0.2, 0.3]), RED), 0.006),
        (cylinder(0.1, 0.5, RED), np.pi * 0.01 * 0.5),
        (ball(0.2, RED), 4 / 3 * np.pi * 0.008),
    ],
)
def test_a_solid_encloses_its_volume(mesh: Mesh, expected: float) -> None:
    assert volume(mesh) == pytest.approx(expected, rel=0.06)
    assert mesh.vertices[mesh.faces].mean(axis=(0, 1)) == pytest.approx([0, 0, 0], abs=1e-12)


def test_a_cylinder_lies_along_z() -> None:
    assert np.ptp(cylinder(0.1, 0.5, RED).vertices, axis=0) == pytest.approx([0.2, 0.2, 0.5])


def test_the_edges_of_a_box_are_four_of_each_length() -> None:
    lengths = np.linalg.norm(np.diff(box_edges(np.array([1.0, 2.0, 3.0])), axis=1)[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx([1.0] * 4 + [2.0] * 4 + [3.0] * 4)


def turned(angle: float) -> list[float]:
    return [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]


def test_an_exaggerated_pose_is_so_many_times_as_far_and_as_turned() -> None:
    against = poses([1.0, 2.0, 3.0], turned(0.5))
    pose = poses([1.001, 2.0, 3.0], turned(0.52))
    expected = poses([1.01, 2.0, 3.0], turned(0.7))
    assert exaggerated(pose, against, 10.0) == pytest.approx(expected, abs=1e-12)
    other_sign = pose * [1, 1, 1, -1, -1, -1, -1]
    assert exaggerated(other_sign, against, 10.0) == pytest.approx(expected, abs=1e-12)
    assert exaggerated(pose, against, 1.0) is pose
    assert exaggerated(against, against, 100.0) == pytest.approx(against)


def test_an_exaggerated_turn_is_about_the_axis_it_had() -> None:
    against, turn = pin.exp3(np.array([0.4, -0.7, 1.1])), np.array([0.02, -0.03, 0.01])
    rotations = [against, pin.exp3(turn) @ against, pin.exp3(4.0 * turn) @ against]
    rows = [np.hstack([[[1.0, 2.0, 3.0]], [np.roll(pin.Quaternion(R).coeffs(), 1)]]) for R in rotations]
    found = exaggerated(rows[1], rows[0], 4.0)
    assert matrices(found[:, 3:])[0] == pytest.approx(rotations[2], abs=1e-12)


def test_an_exaggerated_turn_ends_at_half_a_turn() -> None:
    found = exaggerated(poses([0.0] * 3, turned(0.5)), poses([0.0] * 3, turned(0.0)), 100.0)
    assert found[0, 3:] == pytest.approx(turned(np.pi), abs=1e-12)


def test_matrices_and_products_are_pinocchios() -> None:
    a, b = pin.Quaternion(0.3, 0.5, -0.2, 0.7).normalized(), pin.Quaternion(0.9, 0.1, 0.4, -0.1).normalized()
    rows = [np.array([[q.w, q.x, q.y, q.z]]) for q in (a, b, a * b)]
    assert matrices(rows[0])[0] == pytest.approx(a.toRotationMatrix())
    assert product(rows[0], rows[1]) == pytest.approx(rows[2])
    assert moved(np.hstack([[1.0, 2.0, 3.0], rows[0][0]]), [[0.1, 0.2, 0.3]])[0] == pytest.approx(
        a.toRotationMatrix() @ [0.1, 0.2, 0.3] + [1.0, 2.0, 3.0]
    )


def test_a_length_beyond_all_measure_is_no_warning() -> None:
    found = sizes(np.array([[3.0, 4.0], [1e200, 1e200], [np.nan, 0.0]]))
    assert found[0] == 5.0
    assert np.isinf(found[1])
    assert np.isnan(found[2])


@pytest.mark.parametrize("name", ["paper", "two_models", "four_wx250s"])
def test_end_effectors_are_where_the_control_law_has_them(name: str) -> None:
    cell = load_cell(Path(name))
    for arm, drawing in zip(cell.arms, drawing_of_cell(cell).arms, strict=True):
        q = np.array([arm.entry.q_near_rad, np.array(arm.entry.q_near_rad) + 0.1])
        links, ee = ArmBody(drawing).placements(q)
        for row, angles in enumerate(q):
            T = cell.model(arm).object_pose(angles) * arm.T_object_ee
            assert ee[row, :3] == pytest.approx(T.translation, abs=1e-9)
            assert matrices(ee[row : row + 1, 3:])[0] == pytest.approx(T.rotation, abs=1e-9)
        assert links["base"][0] == pytest.approx([*arm.entry.p_world_base_m, *arm.entry.quat_world_base])


def test_links_have_the_solids_of_the_urdf_and_the_arms_own_colour() -> None:
    drawing = drawing_of_cell(paper_cell()).arms[0]
    body = ArmBody(drawing)
    assert list(body.links) == ["base", "waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate"]
    upper_arm = body.links["shoulder"]
    assert [mesh.colour for mesh in upper_arm] == [(115, 115, 122), drawing.colour], "what has one colour is one"
    assert [len(mesh.faces) for mesh in upper_arm] == [2 * 80, 2 * 12]
    assert upper_arm[1].vertices[:8].min(axis=0) == pytest.approx([-0.0175, -0.025, 0.071 - 0.071015])
    tube, box = upper_arm[0].vertices[-42:], upper_arm[1].vertices[-8:]
    assert np.ptp(tube, axis=0) == pytest.approx([0.044, 0.06, 0.044])  # its axis turned to y
    assert set(upper_arm[1].faces[-12:].ravel()) == set(range(8, 16)), "each face has the corners of its own solid"
    assert not np.array_equal(box, upper_arm[1].vertices[:8])
    gripper = np.vstack([mesh.vertices for mesh in body.links["wrist_rotate"]])
    assert gripper[:, 0].max() == pytest.approx(0.043 + 0.05)  # the fingers, behind a fixed joint


@cache
def the_scene() -> tuple[Scene, Motion]:
    run = view_run()
    motion = motion_of(run)
    return Scene.of(drawing_of_log(run.log), motion), motion


def test_object_desired_pose_and_beliefs_are_those_of_the_log() -> None:
    scene, motion = the_scene()
    placed, log = scene.place(motion), view_log()
    assert motion.t == pytest.approx(np.arange(40) / 20.0)
    rows, true = log.agents["right"][10:30:10], log.plant[10:30:10]  # type: ignore[index]
    assert placed.poses[OBJECT][1:3, :3] == pytest.approx(true["p_object"])
    assert placed.poses[DESIRED][1:3, 3:] == pytest.approx(rows["quat_object_des"])
    assert placed.poses["belief/right"][1:3, :3] == pytest.approx(rows["p_object"])


def test_grippers_stay_at_the_object_as_it_moves() -> None:
    scene, motion = the_scene()
    placed = scene.place(motion)
    assert np.ptp(placed.poses[OBJECT][:, 0]) > 0.02
    for name, side in (("left", -0.04), ("right", 0.04)):
        tail = placed.arrows[f"wrench/{name}"][:, 0]
        believed = placed.poses[f"belief/{name}"]
        assert tail == pytest.approx(believed[:, :3] + matrices(believed[:, 3:]) @ [side, 0.0, 0.0], abs=1e-6)


def test_arrows_are_the_forces_and_the_largest_has_full_length() -> None:
    scene, motion = the_scene()
    placed = scene.place(motion)
    way = {name: ends[:, 1] - ends[:, 0] for name, ends in placed.arrows.items()}
    assert max(np.linalg.norm(way[f"wrench/{a}"], axis=1).max() for a in OFFSETS) == pytest.approx(ARROW_M)
    assert max(np.linalg.norm(way[f"internal/{a}"], axis=1).max() for a in OFFSETS) == pytest.approx(ARROW_M)
    force = motion.arms["left"].force_cmd
    assert way["wrench/left"] / np.linalg.norm(way["wrench/left"], axis=1)[:, None] == pytest.approx(
        force / np.linalg.norm(force, axis=1)[:, None]
    )
    assert np.all(way["internal/left"][:, 0] > 0.0)  # both press on the object, the left one to the right
    assert np.all(way["internal/right"][:, 0] < 0.0)


def test_internal_force_is_the_realised_one_and_without_a_simulation_the_commanded_one() -> None:
    _, motion = the_scene()
    assert motion.arms["left"].internal[0] == pytest.approx([SQUEEZE_N, 0.0, 0.0])
    alone = motion_of(view_run(plant=False))
    assert alone.arms["left"].internal[3] == pytest.approx([SQUEEZE_N, 0.0, 0.0])
    assert alone.arms["right"].internal[3] == pytest.approx([-SQUEEZE_N, 0.0, 0.0])
    assert alone.true is None
    assert alone.object is alone.arms["left"].belief
    assert motion.arms["left"].internal[3, 0] == pytest.approx(SQUEEZE_N * (1 + 0.05 * np.sin(5 * 0.15)))


def test_exaggeration_moves_the_wires_and_nothing_else() -> None:
    scene, motion = the_scene()
    true, large = scene.place(motion), scene.place(motion, 10.0)
    assert large.poses[OBJECT] == pytest.approx(true.poses[OBJECT])
    assert large.poses["arms/left/elbow"] == pytest.approx(true.poses["arms/left/elbow"])
    apart = [placed.poses[DESIRED][:, :3] - placed.poses[OBJECT][:, :3] for placed in (true, large)]
    assert apart[1] == pytest.approx(10.0 * apart[0])
    assert np.linalg.norm(apart[0], axis=1).max() > 1e-3


def test_a_gap_shows_the_last_row_before_it_and_says_so() -> None:
    log = view_log()
    rows = log.agents["left"]
    log.agents["left"] = np.concatenate([rows[:100], rows[200:]])
    motion = motion_of(prepare(log))
    left = motion.arms["left"]
    assert list(np.flatnonzero(~left.fresh)) == list(range(10, 20))  # 0.5 to 0.95 s
    assert left.belief[15] == pytest.approx([*rows["p_object"][99], *rows["quat_object"][99]])
    assert motion.arms["right"].fresh.all()


def test_what_is_no_number_has_no_arrow_and_an_immense_force_a_long_one() -> None:
    scene, motion = the_scene()
    left = motion.arms["left"]
    force = left.force_cmd.copy()
    force[0], force[1], force[2] = np.nan, [np.inf, 0.0, 0.0], [0.0, 1e300, 0.0]
    broken = Motion(motion.t, {**motion.arms, "left": replace(left, force_cmd=force)}, motion.true)
    ends = scene.place(broken).arrows["wrench/left"]
    assert ends[:2, 1] == pytest.approx(ends[:2, 0])
    assert np.linalg.norm(ends[3, 1] - ends[3, 0]) < 1.01 * ARROW_M
    assert Scene.of(scene.cell, broken).place(motion).arrows["wrench/left"][3] == pytest.approx(ends[3], rel=0.5)
    force[2] = [0.0, 1e4, 0.0]
    ends = scene.place(broken).arrows["wrench/left"]
    assert np.linalg.norm(ends[2, 1] - ends[2, 0]) == pytest.approx(ARROW_MAX_M)


def test_up_is_against_gravity_and_z_without_any() -> None:
    scene, _ = the_scene()
    assert scene.up == pytest.approx([0, 1, 0])
    assert Scene(replace(scene.cell, gravity=(0.0, 0.0, 0.0)), force_N=0, internal_N=0).up == pytest.approx([0, 0, 1])


def test_the_floor_lies_under_the_lowest_base() -> None:
    scene, _ = the_scene()
    lines = scene.floor()
    assert lines[..., 1] == pytest.approx(np.full(lines.shape[:2], -0.125))
    low, high = lines.reshape(-1, 3).min(axis=0), lines.reshape(-1, 3).max(axis=0)
    assert low[0] < -0.2
    assert high[0] > 0.8


def test_one_instant_from_the_newest_rows_is_that_of_the_log() -> None:
    log = view_log()
    motion = motion_now({n: rows[200:201] for n, rows in log.agents.items()}, log.plant[200:201])  # type: ignore[index]
    assert motion is not None
    whole = motion_of(prepare(log)).within(1.0, 1.01)
    assert motion.t == pytest.approx(whole.t)
    assert motion.object == pytest.approx(whole.object)
    for name, arm in whole.arms.items():
        assert motion.arms[name].q == pytest.approx(arm.q)
        assert motion.arms[name].internal == pytest.approx(arm.internal)
    both = joined([motion, motion])
    assert len(both.t) == len(both.object) == len(both.arms["left"].q) == 2
    assert motion_now({}, None) is None


def test_rows_are_found_by_time() -> None:
    _, motion = the_scene()
    assert [motion.row_at(t) for t in (-1.0, 0.0, 0.049, 0.05, 99.0)] == [0, 0, 0, 1, 39]
    assert motion.within(0.5, 1.0).t == pytest.approx(np.arange(10, 20) / 20.0)


def without(log: RunLog, name: str) -> RunLog:
    del log.attachments[name]
    return log


@pytest.mark.parametrize("name", ["cell.toml", "widowx_mk2.toml", "widowx_mk2.urdf"])
def test_a_log_without_a_file_says_which(name: str) -> None:
    with pytest.raises(ViewError, match=name):
        drawing_of_log(without(view_log(0.1), name))


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        (b"p_world_base_m = [0.0,", b"p_world_base_m = [0.0, 1.0,", "4 numbers where 3 belong"),
        (b"[object]", b"[objects]", "no 'object'"),
        (b"name = ", b"name == ", "Invalid value"),
    ],
)
def test_a_cell_that_cannot_be_read_is_one_line(old: bytes, new: bytes, found: str) -> None:
    log = view_log(0.1)
    log.attachments["cell.toml"] = log.attachments["cell.toml"].replace(old, new)
    with pytest.raises(ViewError, match=found):
        drawing_of_log(log)


def test_a_urdf_without_a_name_that_is_used_is_refused() -> None:
    drawing = drawing_of_cell(paper_cell()).arms[0]
    with pytest.raises(ViewError, match="joint knee"):
        ArmBody(replace(drawing, controlled=("knee",)))
    with pytest.raises(ViewError, match="frame hand"):
        ArmBody(replace(drawing, ee_frame="hand"))
    with pytest.raises(ConfigError, match=r"widowx_mk2\.urdf"):
        ArmBody(replace(drawing, urdf_xml="<robot"))


def test_an_arm_without_rows_stands_still() -> None:
    log = view_log()
    del log.agents["right"]
    run = prepare(log)
    motion = motion_of(run)
    placed = Scene.of(drawing_of_log(log), motion).place(motion)
    assert "belief/right" not in placed.poses
    assert np.ptp(placed.poses["arms/right/elbow"], axis=0) == pytest.approx(np.zeros(7))
