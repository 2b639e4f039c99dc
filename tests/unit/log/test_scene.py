"""The frames of a cell, put together as a viewer does it, are where pinocchio has them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from rosbags.typesys import Stores, get_typestore

import configs
from agent.config.cell import Cell, load_cell
from agent.log import standard
from agent.log.diagnostics import Diagnostics, Health
from agent.log.scene import Joint, Pose, Transform, rotation, upright
from agent.modes import Mode
from agent.process.scene import scene_of
from agent.safety import Flag
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.telemetry.scenes import scene as made_up

STORE = get_typestore(Stores.ROS2_JAZZY)
CELLS = ["paper", "two_models", "three_wx250s"]


def se3(p, quat_scalar_first) -> pin.SE3:
    return pin.SE3(pin.Quaternion(*map(float, quat_scalar_first)), np.array(p, dtype=float))


class Tree:
    """What tf2 does: parents by child, put together on demand."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, pin.SE3]] = {}

    def hear(self, message: bytes) -> None:
        for t in STORE.deserialize_cdr(message, "tf2_msgs/msg/TFMessage").transforms:
            p, q = t.transform.translation, t.transform.rotation
            placed = t.header.frame_id, se3((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
            assert self._parents.setdefault(t.child_frame_id, placed)[0] == placed[0], "one parent"
            self._parents[t.child_frame_id] = placed

    def at(self, frame: str, root: str = "world") -> pin.SE3:
        T = pin.SE3.Identity()
        while frame != root:
            frame, T_parent_child = self._parents[frame]
            T = T_parent_child * T
        return T

    @property
    def children(self) -> set[str]:
        return set(self._parents)


def row_of(cell: Cell, i: int) -> tuple[np.ndarray, pin.SE3]:
    """A row of arm i at a random pose, and its end effector by pinocchio."""
    random, arm = np.random.default_rng(i), cell.arms[i]
    model = cell.model(arm)
    rows = np.zeros(1, AGENT_STATE.dtype)
    q = np.array(arm.entry.q_near_rad) + 0.3 * random.standard_normal(arm.n)
    T_world_object = model.object_pose(q)
    rows["q_measured"][0, : arm.n] = q
    rows["p_object"] = T_world_object.translation
    x, y, z, w = pin.Quaternion(T_world_object.rotation).coeffs()
    rows["quat_object"] = w, x, y, z
    rows["wrench_cmd"] = random.standard_normal(6)
    return rows, T_world_object * arm.T_object_ee


@pytest.mark.parametrize("name", CELLS)
def test_every_link_of_every_arm_is_where_pinocchio_has_it(name: str) -> None:
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml")
    scene, tree = scene_of(cell), Tree()
    tree.hear(standard.static_transforms(scene.statics(), 7))
    for i, described in enumerate(scene.arms):
        rows, T_world_ee = row_of(cell, i)
        topic = next(t for t in standard.arm_topics(described, is_first=False, has_plant=True) if t.topic == "/tf")
        out = np.frombuffer(bytearray(topic.template), topic.dtype)
        topic.fill(out, rows, standard.stamps(rows))
        tree.hear(out.tobytes())
        assert tree.at(f"{described.name}/{described.ee_link}").isApprox(T_world_ee, 1e-9)
        model = pin.buildModelFromXML(described.urdf_xml)
        links = {f"{described.name}/{f.name}" for f in model.frames if f.type == pin.FrameType.BODY}
        assert links <= tree.children


@pytest.mark.parametrize("name", CELLS)
def test_a_wrench_is_the_one_of_the_row_in_the_axes_of_the_end_effector(name: str) -> None:
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml")
    for i, described in enumerate(scene_of(cell).arms):
        rows, T_world_ee = row_of(cell, i)
        topic = next(
            t for t in standard.arm_topics(described, is_first=True, has_plant=True) if t.topic.endswith("/wrench")
        )
        out = np.frombuffer(bytearray(topic.template), topic.dtype)
        topic.fill(out, rows, standard.stamps(rows))
        decoded = STORE.deserialize_cdr(out.tobytes(), "geometry_msgs/msg/WrenchStamped")
        f, m = decoded.wrench.force, decoded.wrench.torque
        assert decoded.header.frame_id == f"{described.name}/ee"
        assert np.allclose(T_world_ee.rotation @ [f.x, f.y, f.z], rows["wrench_cmd"][0, :3], atol=1e-9)
        assert np.allclose(T_world_ee.rotation @ [m.x, m.y, m.z], rows["wrench_cmd"][0, 3:], atol=1e-9)


@pytest.mark.parametrize("gravity", [(0, -9.81, 0), (0, 0, -9.81), (9.81, 0, 0), (0, 0, 1.6), (1.0, -2.0, 3.0)])
def test_the_map_has_gravity_straight_down(gravity: tuple[float, float, float]) -> None:
    down = rotation(upright(gravity)) @ np.array(gravity) / np.linalg.norm(gravity)
    assert np.allclose(down, [0.0, 0.0, -1.0], atol=1e-12)


def test_a_cell_without_gravity_is_not_turned() -> None:
    assert upright((0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)


def test_a_prismatic_joint_slides_along_its_axis_as_it_is_mounted() -> None:
    quarter = (0.5**0.5, 0.0, 0.0, 0.5**0.5)  # about z
    joint = Joint("rail", "prismatic", "a", "b", Pose((1.0, 0.0, 0.0), quarter), (1.0, 0.0, 0.0))
    assert np.allclose(joint.pose(0.25).p, [1.0, 0.25, 0.0])
    many = standard._Joints([joint]).poses(np.array([[0.25], [-0.5]]))
    assert np.allclose(many[:, :3], [[1.0, 0.25, 0.0], [1.0, -0.5, 0.0]])
    assert np.allclose(many[:, 3:], [0.0, 0.0, 0.5**0.5, 0.5**0.5])


def test_static_frames_say_when_they_were_sent() -> None:
    message = standard.static_transforms([Transform("a", "b", Pose((1, 2, 3), (0.5, 0.5, -0.5, 0.5)))], 5_000_000_007)
    (t,) = STORE.deserialize_cdr(message, "tf2_msgs/msg/TFMessage").transforms
    assert (t.header.stamp.sec, t.header.stamp.nanosec) == (5, 7)
    assert (t.header.frame_id, t.child_frame_id) == ("a", "b")
    assert (t.transform.translation.z, t.transform.rotation.w, t.transform.rotation.y) == (3.0, 0.5, -0.5)


def diagnosed(modes: list[int], flags: list[int], period_ns: int = 20_000_000) -> list:
    rows = np.zeros(len(modes), AGENT_STATE.dtype)
    rows["mode"], rows["flags"] = modes, flags
    rows["utc_ns"] = 1_800_000_000_000_000_000 + np.arange(len(modes)) * period_ns
    rows["e_p"] = 0.003, 0.0, -0.004
    rows["bus_timeouts"] = np.arange(len(modes))
    found = []
    told = Diagnostics("left")
    for part in np.array_split(rows, 7):
        found += [(t, STORE.deserialize_cdr(m, "diagnostic_msgs/msg/DiagnosticArray")) for t, m in told.messages(part)]
    return found


def test_an_arm_is_diagnosed_once_a_second_and_at_every_change() -> None:
    track, hold = int(Mode.TRACK), int(Mode.HOLD)
    calm = diagnosed([track] * 150, [0] * 150)
    assert [t % 1_000_000_000 for t, _ in calm] == [0, 0, 0]
    stopped = diagnosed([track] * 25 + [hold] * 125, [0] * 20 + [int(Flag.OFF_TRACK)] * 5 + [0] * 125)
    assert [s.status[0].level for _, s in stopped] == [Health.OK, Health.WARN, Health.WARN, Health.WARN, Health.WARN]
    assert [s.status[0].message for _, s in stopped[:3]] == ["TRACK", "TRACK OFF_TRACK", "HOLD"]


def test_a_diagnosis_has_the_figures_behind_it() -> None:
    (_, first), *_ = diagnosed([int(Mode.FAULT)], [int(Flag.SATURATED)])
    (status,) = first.status
    values = {v.key: v.value for v in status.values}
    assert (status.level, status.name, status.hardware_id) == (Health.ERROR, "arm left", "left")
    assert (values["mode"], values["flags"], values["e_p_m"], values["bus_timeouts"]) == (
        "FAULT",
        "SATURATED",
        "0.005",
        "0",
    )


def test_a_locked_joint_stands_where_the_cell_has_it() -> None:
    scene, tree = made_up("any", {"left": ("waist", "shoulder", "elbow")}), Tree()
    tree.hear(standard.static_transforms(scene.statics(), 0))
    (arm,) = scene.arms
    model = pin.buildModelFromXML(arm.urdf_xml)
    data, q = model.createData(), np.zeros(model.nq)
    for name, value in arm.locked.items():
        assert value != 0.0
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    forearm, ee = (data.oMf[model.getFrameId(link)] for link in ("forearm_link", "ee"))
    assert tree.at("left/ee", "left/forearm_link").isApprox(forearm.actInv(ee), 1e-9)
