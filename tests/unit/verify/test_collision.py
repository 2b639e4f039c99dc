"""How near bodies come: what is reported is no more than the true distance, names what is near, and refuses."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, ConfigError, load_cell, placement
from agent.config.solids import body_of
from agent.verify.check import examine, start_configurations
from agent.verify.collision.findings import PLACES_MAX, _places, collisions
from agent.verify.collision.scene import Scene
from agent.verify.collision.way import Way
from agent.verify.finding import Finding, Verdict
from tests.support.control.level_wx200 import LEVEL

WX200 = (configs.ARMS_DIR / "wx200.urdf").read_text()


def scene_of(name: str, *overrides: str) -> tuple[Cell, Scene]:
    cell = load_cell(Path(name), overrides)
    return cell, Scene(cell, [cell.model(arm) for arm in cell.arms])


def still(cell: Cell, scene: Scene) -> Way:
    """One place: the start."""
    return scene.way([start_configurations(cell, scene._models)], [cell.T_world_object_start])


def found(name: str, *overrides: str) -> dict[tuple[str, str], Finding]:
    """Of the start alone, by what and where."""
    cell = load_cell(Path(name), overrides)
    models = [cell.model(arm) for arm in cell.arms]
    paths = [[q] for q in start_configurations(cell, models)]
    return {(f.what, f.where): f for f in collisions(cell, models, paths, [0.0])}


def size_mm(finding: Finding) -> float:
    return float(re.findall(r"-?\d+\.\d+", finding.found)[0]) * (-1.0 if "overlap" in finding.found else 1.0)


def nearest(way: Way, pairs: list[tuple[int, int]]) -> float:
    near = way.nearest(pairs)
    assert near is not None
    return near.distance_m


def test_distances_are_those_of_the_shapes() -> None:
    cell, scene = scene_of("two_wx200", *LEVEL, "table.z_m=0.0")
    way = still(cell, scene)
    index = {shape.label: i for i, shape in enumerate(scene.shapes)}
    # both grippers are level and point at each other; a finger is 40 mm long
    left, right = index["left left_finger_link"], index["right right_finger_link"]
    gap = np.linalg.norm(way.p[0, left] - way.p[0, right]) - 0.04
    assert nearest(way, [(left, right)]) == pytest.approx(gap, abs=1e-6)
    # the object is 44 mm high and its centre at 0.25 m
    assert nearest(way, scene.standing()) == pytest.approx(0.25 - 0.022, abs=1e-6)
    # fingers are 24 mm high
    assert nearest(way, [(left, index["table"])]) == pytest.approx(0.25 - 0.012, abs=1e-6)


@pytest.mark.parametrize("name", ["two_wx200", "three_wx250s"])
def test_what_is_reported_is_a_lower_bound_of_the_whole_way(name: str) -> None:
    cell, scene = scene_of(name, "table.z_m=0.0")
    rng = np.random.default_rng(3)
    q0 = start_configurations(cell, scene._models)
    goal = [q + rng.uniform(-0.4, 0.4, len(q)) for q in q0]

    def way(count: int) -> Way:
        along = [[(1 - s) * a + s * b for a, b in zip(q0, goal, strict=True)] for s in np.linspace(0, 1, count)]
        return scene.way(along, [placement([0.4 * s, 0.0, 0.25], [1, 0, 0, 0]) for s in np.linspace(0, 1, count)])

    coarse, fine = way(6), way(201)
    groups = [scene.between(0, 1), scene.itself(0), scene.with_object(1), scene.with_table(0), scene.standing()]
    for pairs in groups:
        low, near = coarse.nearest(pairs), fine.nearest(pairs)
        assert low is not None
        assert near is not None
        assert low.distance_m <= near.distance_m + 1e-3
        assert low.distance_m > near.distance_m - 0.06, "and not far below"


@pytest.mark.parametrize(
    ("overrides", "what", "where", "names"),
    [
        (("object.size_m=[0.4, 0.4, 0.3]",), "distance to the object", "left", "left .*, object"),
        (("table.z_m=0.15",), "distance to the table", "left", "left .*, table"),
        (("table.z_m=0.18",), "distance of object and table", "cell", "object, table"),
        (
            ("arms.front.p_object_ee_m=[0.04, 0.06, 0.0]", "arms.front.p_world_base_m=[0.04, -0.27, 0.0]"),
            "distance of the arms", "back and front", "back .*finger.*, front .*finger",
        ),
    ],
)  # fmt: skip
def test_what_overlaps_is_refused_by_name(overrides: tuple[str, ...], what: str, where: str, names: str) -> None:
    before, after = found("three_wx250s", "table.z_m=0.0")[what, where], found("three_wx250s", *overrides)[what, where]
    assert before.verdict is Verdict.OK
    assert after.verdict is Verdict.REFUSED, after
    assert re.search(names, after.found), after.found
    assert size_mm(after) < size_mm(before)


def test_an_arm_that_folds_into_itself_is_seen() -> None:
    cell, scene = scene_of("three_wx250s")
    q = list(start_configurations(cell, scene._models))
    clear = scene.way([q], [cell.T_world_object_start]).nearest(scene.itself(0))
    q[0] = np.array([0.0, -1.5, 1.5, 0.0, 2.1, 0.0])  # the gripper points down beside the base
    near = scene.way([q], [cell.T_world_object_start]).nearest(scene.itself(0))
    assert clear is not None
    assert near is not None
    assert clear.distance_m > 0.02
    assert near.distance_m < 0.0
    assert {scene.shapes[i].owner for i in near.pair} == {"left"}


@pytest.mark.parametrize(("margin", "verdict"), [(0.06, Verdict.OK), (0.09, Verdict.REFUSED)])
def test_the_margin_is_what_the_cell_asks_for(margin: float, verdict: Verdict) -> None:
    finding = found("two_wx200", f"safety.collision_margin_m={margin}")["distance to the object", "left"]
    assert 60.0 < size_mm(finding) < 90.0
    assert finding.verdict is verdict
    assert finding.wanted == f"≥ {margin * 1e3:g} mm"


def test_a_check_refuses_a_cell_whose_bodies_meet() -> None:
    cell = load_cell(Path("two_wx200"), ["table.z_m=0.24"])
    report = examine(cell, wired=False, thorough=True)
    with pytest.raises(ConfigError, match=r"distance to the table \(left\): found overlap by"):
        report.require()
    assert examine(cell, wired=False, thorough=False).ok, "a simulated run has no contacts"


def test_an_object_may_stand_on_its_table_but_not_in_it() -> None:
    what = ("distance of object and table", "cell")
    assert found("two_wx200", "table.z_m=0.228")[what].verdict is Verdict.OK
    assert found("two_wx200", "table.z_m=0.2301")[what].verdict is Verdict.REFUSED


def test_a_table_wants_a_world_whose_z_points_up() -> None:
    with pytest.raises(ConfigError, match=r"table in paper\.toml with the changes asked for: found gravity"):
        load_cell(Path("paper"), ["table.z_m=0.0"])


def test_links_that_touch_at_zero_are_left_out_and_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = WX200.replace('<box size="0.065 0.035 0.035"/>', '<box size="0.5 0.035 0.035"/>')
    cell = load_cell(Path("two_wx200"))
    monkeypatch.setattr("agent.verify.collision.scene.body_of", lambda _, name: body_of(wide, name))
    models = [cell.model(arm) for arm in cell.arms]
    findings = collisions(cell, models, [[q] for q in start_configurations(cell, models)], [0.0])
    listed = [f.found for f in findings if f.what.startswith("links that touch")]
    assert listed
    assert "upper_arm_link–wrist_link" in listed[0]


def test_a_pair_with_one_joint_between_is_not_compared() -> None:
    _, scene = scene_of("three_wx250s")
    links = {tuple(scene.shapes[i].link for i in pair) for pair in scene.itself(0)}
    assert ("base_link", "shoulder_link") not in links
    assert ("gripper_link", "left_finger_link") not in links
    assert ("base_link", "left_finger_link") in links


MESH = '<geometry><mesh filename="package://nowhere/finger.stl"/></geometry>'


@pytest.mark.parametrize(
    ("change", "solids", "unknown"),
    [
        (lambda x: x, 15, ()),
        (lambda x: x.replace('<geometry><box size="0.065 0.035 0.035"/></geometry>', MESH), 14, ("wrist_link",)),
        (lambda x: x.replace("<visual>", "<collision>").replace("</visual>", "</collision>"), 15, ()),
        (lambda x: x.replace("</robot>", f'<link name="e"><visual>{MESH}</visual></link></robot>'), 15, ("e",)),
    ],
)
def test_shapes_come_from_the_urdf_alone(change: Callable[[str], str], solids: int, unknown: tuple[str, ...]) -> None:
    body = body_of(change(WX200), "mine.urdf")
    assert (len(body.solids), body.unknown) == (solids, unknown)
    assert body.rigidly_below("gripper_link") >= {"gripper_link", "left_finger_link", "ee"}
    assert "wrist_link" not in body.rigidly_below("gripper_link")


@pytest.mark.parametrize(
    ("was", "now"),
    [('size="0.13 0.11 0.05"', 'size="0.13 0.11"'), ('size="0.13 0.11 0.05"', 'size="0.13 0.11 -0.05"'),
     ('radius="0.035" length="0.022"', 'radius="0.035" length="x"'),
     ('radius="0.035" length="0.022"', 'radius="nan" length="1"')],
)  # fmt: skip
def test_a_shape_that_cannot_be_read_is_refused(was: str, now: str) -> None:
    with pytest.raises(ConfigError, match=r"of link base_link in mine.urdf: found"):
        body_of(WX200.replace(was, now, 1), "mine.urdf")


def test_between_two_places_a_third_is_looked_at_and_many_are_thinned() -> None:
    path = [np.array([0.0, 1.0]), np.array([2.0, 5.0]), np.array([4.0, 5.0])]
    times, along = _places([path], [0.0, 1.0, 3.0])
    assert times == [0.0, 0.5, 1.0, 2.0, 3.0]
    assert along[1][0].tolist() == [1.0, 3.0]
    assert along[4][0].tolist() == [4.0, 5.0]
    times, along = _places([[np.zeros(2)] * 5001], [float(k) for k in range(5001)])
    assert len(times) == len(along) <= PLACES_MAX + 1
    assert times[0] == 0.0
    assert times[-1] == 5000.0


def test_a_quick_motion_is_looked_at_as_finely_as_it_asks() -> None:
    """The object of this cell keeps 65 mm from the wrist that turns it; steps of 0.8 s made an overlap of that."""
    cell = load_cell(Path("identify_wx250s"))
    distances = {f.what: size_mm(f) for f in examine(cell, thorough=True).findings if f.found.endswith(" s)")}
    assert 50.0 < distances["distance to the object"] < 65.6
    assert 25.0 < distances["distance of the arm to itself"] < 32.0
