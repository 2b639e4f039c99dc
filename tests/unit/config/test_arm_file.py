"""Arm file and URDF: what cannot be is refused with file, key, value and remedy, and never half taken."""

from __future__ import annotations

import math
import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import configs
from agent.config.cell import Cell, ConfigError, cell_from_toml
from agent.config.files import load_arm_file, load_own_arm_file
from agent.config.servo_map import fingers_of, resting_joints
from agent.config.urdf_joints import refuse_odd_joints
from agent.control.models import ModelError
from agent.verify.check import examine
from drivers.dynamixel.arm_map import ArmMap
from drivers.interface import Refusal

CELL = (configs.CELLS_DIR / "two_wx200.toml").read_bytes()
ARM = (configs.ARMS_DIR / "wx200.toml").read_text()
URDF = (configs.ARMS_DIR / "wx200.urdf").read_text()
GRIPPER = ARM[ARM.index("[gripper]") :]


def loaded(folder: Path, arm: str = ARM, urdf: str | bytes = URDF, cell: bytes = CELL) -> Cell:
    """The cell of two WidowX-200 with these files of theirs."""
    arms = folder / "arms"
    shutil.copytree(configs.ARMS_DIR, arms, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    (arms / "wx200.toml").write_text(arm)
    (arms / "wx200.urdf").write_bytes(urdf if isinstance(urdf, bytes) else urdf.encode())
    return cell_from_toml(cell, "two_wx200.toml", arms)


def arm_with(old: str, new: str) -> str:
    assert old in ARM
    return ARM.replace(old, new, 1)


def test_the_files_that_ship_pass(tmp_path: Path) -> None:
    assert examine(loaded(tmp_path)).ok


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('servo = "XM430-W350"', 'servo = "XM430-W35"', "joints.waist.servo in wx200.toml: .*did you mean XM430-W350"),
        ("baud = 1000000", "baud = 0", "baud in wx200.toml: found 0, expected one of 9600,"),
        ("protocol = 2.0", "protocol = 3.0", "protocol in wx200.toml: found 3.0, expected 2.0;"),
        ("ids = [1]", "ids = [2]", "joints in wx200.toml: found ID 2 more than once"),
        ("ids = [1]", "ids = [254]", r"joints.waist.ids.0 in wx200.toml: found 254"),
        ("ids = [1]", "ids = []", "joints.waist.ids in wx200.toml"),
        ("reverse = [false]", "reverse = [false, true]", "joints.waist.reverse in .*2 entries for 1 servos"),
        ('name = "waist"', 'name = "shoulder"', "joints in wx200.toml: found name 'shoulder' more than once"),
        ("zero_tick = 2048", "zero_tick = 1000000000", "joints.waist.zero_tick in wx200.toml: found 1000000000"),
        ("zero_tick = 2048", "zero_tick = -1", "joints.waist.zero_tick in wx200.toml: found -1"),
        ("[0, 4095]", "[4095, 0]", "position_limit_ticks in wx200.toml: found 4095 to 0"),
        ("coulomb_Nm = { value = 0.1", "coulomb_Nm = { value = -0.1", "joints.waist.coulomb_Nm.value in .* -0.1"),
        (
            "viscous_Nm_s_per_rad = { value = 0.05", "viscous_Nm_s_per_rad = { value = -1.0",
            "joints.waist.viscous_Nm_s_per_rad.value in .*greater than or equal to 0",
        ),
        ("{ value = 1.783", "{ value = 0.0", "joints.waist.torque_constant_Nm_per_A.value in .*greater than 0"),
        ("{ value = 1.783", "{ value = -1.0", "joints.waist.torque_constant_Nm_per_A.value in .*greater than 0"),
        ("[sleep_rad]", "[sleep_rad]\nwrist_angel = 0.0", "sleep_rad in wx200.toml: .*did you mean wrist_angle"),
        (GRIPPER, "", "gripper in wx200.toml: found nothing"),
        (GRIPPER, "[gripper]\nids = [7]\n", "gripper.servo in wx200.toml .*found nothing"),
        ("closed_tick = 1802", 'closed_tick = "shut"', "gripper.closed_tick in wx200.toml: found 'shut'"),
        ("rod_length_m = 0.024", "rod_length_m = 0.014", "gripper.rod_length_m in .*beside horn_radius_m of 0.014"),
        ("rod_length_m = 0.024", "rod_length_m = 0.013", "gripper.rod_length_m in .*a rod longer than the radius"),
        ("rod_length_m = 0.024", "rod_length_m = 1e-4", "gripper.rod_length_m in .*found 0.0001"),
        ("horn_radius_m = 0.014", "horn_radius_m = 1e-4", "gripper.horn_radius_m in .*found 0.0001"),
        ("horn_radius_m = 0.014", "horn_radius_m = 2.0", "gripper.horn_radius_m in .*found 2.0"),
        ("open_tick = 2875", "open_tick = 1802", "gripper.open_tick in .*-246 ticks from zero_tick, where .* -246"),
        ("open_tick = 2875", "open_tick = 1801", "gripper.open_tick in .*fingers that go apart all the way"),
        ("open_tick = 2875", "open_tick = 3072", "gripper.open_tick in .*does not pass ±90°"),
        ("closed_tick = 1802", "closed_tick = 1024", "gripper.open_tick in .*-1024.*does not pass ±90°"),
        (
            "zero_tick = 2048\nposition_limit_ticks = [0, 4095]\nclosed_tick = 1802",
            "zero_tick = 4095\nposition_limit_ticks = [0, 4095]\nclosed_tick = 1802",
            "gripper.open_tick in .*-1220 ticks",
        ),
        ("horn_radius_m", "horn_radius_mm", "gripper.horn_radius_mm in .*did you mean horn_radius_m"),
        ('urdf = "wx200.urdf"', 'urdf = "../arms/wx200.urdf"', "urdf in wx200.toml: found '../arms/wx200.urdf'"),
        ('urdf = "wx200.urdf"', 'urdf = "none.urdf"', "none.urdf: found No such file"),
        ("format = 1", "format = 2", "format in wx200.toml: found 2, expected 1"),
    ],
)  # fmt: skip
def test_what_an_arm_file_cannot_say_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, arm_with(old, new))


@pytest.mark.parametrize(("closed", "opened"), [(1802, 2875), (1025, 3071), (4095, 3073), (1023, 0)])
def test_a_horn_opens_the_fingers_with_ticks_up_or_where_it_points_the_other_way_down(
    tmp_path: Path, closed: int, opened: int
) -> None:
    arm = re.sub(r"closed_tick = .*\nopen_tick = \d+", f"closed_tick = {closed}\nopen_tick = {opened}", ARM)
    fingers = fingers_of(loaded(tmp_path, arm).arms[0].file)
    assert fingers is not None
    assert fingers.closed_m < fingers.width(0.5 * (fingers.closed_rad + fingers.open_rad)) < fingers.open_m


def test_an_arm_file_of_protocol_1_is_refused_with_its_servos_and_their_firmware(tmp_path: Path) -> None:
    said = (
        r"protocol in wx200\.toml: found 1\.0, whose servos cannot be driven, expected 2\.0, .*; "
        r"give waist \(XM430-W350\), .*, gripper \(XL430-W250\) firmware of Protocol 2\.0 \(DYNAMIXEL Wizard\), "
        r"then write 2\.0 here$"
    )
    with pytest.raises(ConfigError, match=said):
        loaded(tmp_path, arm_with("protocol = 2.0", "protocol = 1.0"))


def test_of_an_arm_file_of_protocol_1_servos_without_other_firmware_are_named_as_such(tmp_path: Path) -> None:
    mk2 = (configs.ARMS_DIR / "widowx_mk2.toml").read_text().replace("protocol = 2.0", "protocol = 1.0")
    path = tmp_path / "mine.toml"
    path.write_text(mk2)
    with pytest.raises(ConfigError, match=r"; give waist \(.*; none exists for wrist_rotate \(AX-12A\), gripper \(AX"):
        load_own_arm_file(path)


def test_an_arm_none_of_whose_servos_is_controlled_is_refused_before_it_is_wired(tmp_path: Path) -> None:
    cell = loaded(tmp_path)
    with pytest.raises(Refusal, match=r"joints: .*at least one controlled"):
        ArmMap("left", "none", 1_000_000, 200.0, resting_joints(cell.arms[0].file))


def first_number(of: str, instead: str) -> str:
    """The URDF with the first value of an attribute replaced."""
    begin = URDF.index(f'{of}="') + len(of) + 2
    return URDF[:begin] + instead + URDF[URDF.index('"', begin) :]


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        (b"\xff\xfe", "wx200.urdf: found text in UTF-16"),
        (b"<robot>\xff</robot>", "wx200.urdf: .*expected XML in UTF-8"),
        ("<robot><link", "wx200.urdf: found unclosed token: line 1"),
        (first_number("mass value", "0,5"), r"mass of link base_link in wx200.urdf: found '0,5', expected a number"),
        (first_number("mass value", "nan"), "mass of link base_link in wx200.urdf: found 'nan'"),
        (first_number("mass value", "-0.1"), "mass of link base_link in .*not below 0"),
        (first_number("mass value", "101"), "mass of link base_link in .*not below 0 and at most 100"),
        (first_number("ixy", "-1e30"), "ixy of link base_link in .*expected a number within ±100"),
        (first_number("origin xyz", "0 1e9 0"), "xyz of link base_link in .*expected 3 numbers within ±100"),
        (first_number("ixx", "-1e-5"), "ixx of link base_link in .*not below 0"),
        (first_number("ixx", ""), "ixx of link base_link in wx200.urdf: found ''"),
        (URDF.replace(" izz=", " ixz2=", 1), "izz of link base_link in wx200.urdf: found nothing"),
        (first_number("axis xyz", "0 1"), "xyz of joint .*expected 3 numbers"),
    ],
)
def test_a_urdf_with_a_number_that_cannot_be_read_is_refused(tmp_path: Path, urdf: str | bytes, message: str) -> None:
    """Its parser would leave the weight out and go on."""
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, urdf=urdf)


def with_joint(joint: str, old: str, new: str) -> str:
    """The URDF with the first such text behind the name of this joint replaced."""
    begin = URDF.index(f'<joint name="{joint}"')
    assert re.search(old, URDF[begin:])
    return URDF[:begin] + re.sub(old, new, URDF[begin:], count=1)


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        (
            with_joint("elbow", '<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'),
            "axis of joint elbow in wx200.urdf: found 0 0",
        ),
        (with_joint("waist", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1.0015"/>'), "axis of joint waist .*of length 1"),
        (with_joint("elbow", "revolute", "prismatic"), r"joints of arm left .*: found elbow, which slides"),
        (with_joint("elbow", "<limit [^>]*/>", ""), "limit lower of joint elbow in wx200.urdf: found nothing.*rad/s"),
        (with_joint("elbow", 'velocity="', 'speed="'), "limit velocity of joint elbow in wx200.urdf: found nothing"),
        (with_joint("elbow", 'effort="[^"]*"', 'effort="much"'), "limit effort of joint elbow .*: found 'much'"),
        (with_joint("waist", 'lower="[^"]*"', 'lower="3.2"'), "limits of joint waist .*: found 3.2 to 3.14.*exchange"),
        (
            with_joint("waist", 'lower="[^"]*"', 'lower="3.141583"'),
            "limits of joint waist .*: found 3.14158 to 3.14158",
        ),
        (
            with_joint("left_finger", "fixed", "prismatic"),
            "limit lower of joint left_finger .*found nothing, .*N and m/s",
        ),
        (with_joint("waist", 'lower="[^"]*"', 'lower="-180"'), "limits of joint waist .*: found -180 to .*in rad"),
        (
            with_joint("waist", 'upper="[^"]*"', 'upper="6.3"'),
            "limits of joint waist .*: found -3.14158 to 6.3, .*turn",
        ),
        (
            URDF.replace("</robot>", '<x:arm xmlns:x="http://www.ros.org/wiki/xacro"/></robot>'),
            r"wx200.urdf: found elements of xacro: arm, .*expand it: `xacro ",
        ),
    ],
)
def test_a_joint_that_cannot_move_as_it_says_is_refused_by_name(tmp_path: Path, urdf: str, message: str) -> None:
    """Degrees would leave the joint without a limit, and a parser of URDF leaves macros out."""
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, urdf=urdf)


def test_joints_of_a_turn_and_axes_of_few_digits_are_taken(tmp_path: Path) -> None:
    turn = f'upper="{2.0 * math.pi!r}"'
    assert loaded(tmp_path, urdf=with_joint("waist", 'upper="[^"]*"', turn)).arms
    assert loaded(tmp_path / "b", urdf=with_joint("waist", '<axis xyz="0 0 1"/>', '<axis xyz="0 0.01 0.9999"/>')).arms


SLIDES = 'prismatic"><limit lower="0" upper="7" effort="1" velocity="1"/'


def test_what_is_no_joint_that_turns_is_asked_for_what_it_needs_alone(tmp_path: Path) -> None:
    refuse_odd_joints(ET.fromstring(with_joint("left_finger", 'fixed"', SLIDES)), "wx200.urdf")
    assert loaded(tmp_path, urdf=with_joint("left_finger", 'fixed"', 'fixed"><axis xyz="0 0 0"/')).arms


def test_a_joint_that_moves_and_has_no_servo_is_refused_with_the_one_way_out(tmp_path: Path) -> None:
    """The cell was to lock it, and then to leave it out."""
    with pytest.raises(ConfigError, match=r"found left_finger, without a servo, .*give it one, or make it `fixed`"):
        loaded(tmp_path, urdf=with_joint("left_finger", 'fixed"', SLIDES))


@pytest.mark.parametrize("frame", ["wrist_angle", "ee_mount"])
def test_the_name_of_a_joint_is_no_end_effector_frame(tmp_path: Path, frame: str) -> None:
    cell = loaded(tmp_path, arm=arm_with('ee_frame = "ee"', f'ee_frame = "{frame}"'))
    with pytest.raises(ModelError, match=rf"end-effector frame, .*found '{frame}', expected one of .*name a link"):
        cell.model(cell.arms[0])


def with_inertia(xx: float, yy: float, zz: float, xy: float = 0.0, xz: float = 0.0, yz: float = 0.0) -> str:
    """The URDF with this inertia of its first link, kg·m²."""
    tensor = f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>'
    return re.sub(r"<inertia [^>]*/>", tensor, URDF, count=1)


@pytest.mark.parametrize(
    ("urdf", "moments"),
    [
        (with_inertia(1e-3, 1e-3, 2.1e-3), "0.001, 0.001, 0.0021"),
        (with_inertia(2.1e-3, 1e-3, 1e-3), "0.001, 0.001, 0.0021"),
        (with_inertia(1e-3, 1e-3, 1e-3, xy=1.1e-3), "-0.0001, 0.001, 0.0021"),
        (with_inertia(1e-3, 1e-3, 1e-3, xz=0.4e-3, yz=0.4e-3), "0.000434, 0.001, 0.00157"),
        (with_inertia(0.0, 0.0, 0.0, yz=1e-3), "-0.001, 0, 0.001"),
    ],
)
def test_a_link_that_no_body_can_be_is_refused(tmp_path: Path, urdf: str, moments: str) -> None:
    message = rf"inertia of link base_link in wx200.urdf: found principal moments {moments} kg·m², expected .*not above"
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, urdf=urdf)


@pytest.mark.parametrize(
    "urdf",
    [with_inertia(1e-3, 1e-3, 2.01e-3), with_inertia(0.0, 1e-3, 1e-3), with_inertia(0.0, 0.0, 0.0)],
    ids=["rounded", "a rod", "none"],
)
def test_a_thin_or_rounded_link_is_a_body(tmp_path: Path, urdf: str) -> None:
    assert loaded(tmp_path, urdf=urdf).arms


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        (URDF.replace('type="revolute"', 'type="continuous"', 1), "joints of the URDF, arm left .*found waist"),
        (
            with_joint("waist", 'type="revolute"', 'type="continuous"').replace("<limit", "<soft", 1),
            "joints of the URDF, arm left .*found waist",
        ),
        (
            URDF.replace('name="waist"', 'name="waste"'),
            "joint names, arm left .*found waist.*names among waste, shoulder",
        ),
        (
            '<robot name="r"><link name="ee"/></robot>',
            "joint names, .*joints that move: the URDF has none of them; give",
        ),
        (URDF.replace('<link name="ee"', '<link name="tip"').replace('link="ee"', 'link="tip"'), "end-effector frame"),
    ],
)
def test_a_urdf_of_another_arm_is_refused_with_arm_and_file(tmp_path: Path, urdf: str, message: str) -> None:
    cell = loaded(tmp_path, urdf=urdf)
    with pytest.raises(ModelError, match=message):
        cell.model(cell.arms[0])
    with pytest.raises(ConfigError, match=message):
        examine(cell)


def linked(*joints: tuple[str, str, str], links: str = "abc") -> str:
    """A URDF of these links, and fixed joints: name, parent, child."""
    edges = (
        f'<joint name="{joint}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'
        for joint, parent, child in joints
    )
    return f'<robot name="r">{"".join(f"<link name={link!r}/>" for link in links)}{"".join(edges)}</robot>'


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        (
            URDF.replace('child link="forearm_link"', 'child link="forearm"'),
            r"child of joint elbow in wx.*: found 'forearm', a link .*, expected one of .*did you mean forearm_link",
        ),
        (
            URDF.replace('parent link="base_link"', 'parent link="floor"'),
            "parent of joint waist in wx200.urdf: found 'floor', .*; correct it, or add that <link>",
        ),
        (URDF.replace("<parent ", "<parents ", 1), "parent of joint waist in wx200.urdf: found nothing"),
        (URDF.replace("child link=", "child lnk=", 1), "child of joint waist in wx200.urdf: found nothing"),
        (URDF.replace("</robot>", '<link name="ee"/></robot>'), "link 'ee' in .*: found 2 of that name"),
        (URDF.replace('name="elbow"', 'name="waist"'), "joint 'waist' in .*: found 2 of that name"),
        (URDF.replace('<link name="ee"', "<link "), "a link in wx200.urdf: found no name"),
        (URDF.replace(' type="revolute"', "", 1), "type of joint waist in wx200.urdf: found nothing"),
        (URDF.replace('"revolute"', '"revolut"', 1), "type of joint waist in .*'revolut', .*; did you mean revolute"),
        (linked(("j", "a", "b"), ("k", "a", "c"), ("l", "b", "c")), "link c in .*: found the child of joints k, l,"),
        (linked(("j", "a", "b")), "links in .*: found a and c, none of them the child of a joint, expected one base"),
        (
            linked(("j", "b", "c"), ("k", "c", "b")),
            "joints in .*: found links that hang on each other .*: b, c, expected",
        ),
        (linked(("j", "a", "a"), links="a"), "joints in .*: found links that hang on each other in a ring: a,"),
        (linked(links=""), "links in .*: found none, expected one base"),
        ("<sdf/>", "wx200.urdf: found a root element 'sdf', expected <robot>, .*; give the URDF of the arm"),
        (URDF.replace("<robot ", '<robot xmlns="urn:x" ', 1), "wx200.urdf: found a root element '{urn:x}robot'"),
    ],
)
def test_a_urdf_whose_links_are_no_tree_is_refused_with_link_or_joint_before_its_parser_speaks(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], urdf: str, message: str
) -> None:
    assert urdf != URDF
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, urdf=urdf)
    assert capfd.readouterr() == ("", "")


def test_joints_of_transmissions_are_no_joints_of_the_tree(tmp_path: Path) -> None:
    more = '<transmission name="t"><joint name="waist"/></transmission></robot>'
    cell = loaded(tmp_path, urdf=URDF.replace("</robot>", more))
    assert cell.model(cell.arms[0]).n == cell.arms[0].n


def test_an_arm_that_some_motion_costs_no_torque_is_refused(tmp_path: Path) -> None:
    weightless = re.sub(r'<mass value="[^"]*"', '<mass value="0"', re.sub(r'(i[xyz][xyz])="[^"]*"', r'\1="0"', URDF))
    no_rotors = re.sub(r"rotor_inertia_kg_m2 = \{ value = [0-9.]+", "rotor_inertia_kg_m2 = { value = 0.0", ARM)
    assert examine(loaded(tmp_path / "with rotors", urdf=weightless)).q_start
    cell = loaded(tmp_path / "without", no_rotors, weightless)
    with pytest.raises(ModelError, match=r"inertia of the controlled joints, arm left .*smallest eigenvalue of"):
        cell.model(cell.arms[0])


def test_a_folder_without_arm_files_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"found 'wx200', expected an arm file in {tmp_path}; name a described arm"):
        load_arm_file("wx200", "model of arm left", tmp_path)
