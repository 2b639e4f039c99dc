"""The first motion of an arm: the real driver on emulated servos, mounted rightly and wrongly, in virtual time."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.doctor import doctor
from agent.doctor.doctor import Diagnosis, DoctorOptions, MoveError, move_arm
from agent.doctor.move import (
    AT_REST,
    LIFTED,
    MOVED_RAD,
    Joint,
    Motion,
    first_motion,
    joints_of,
    judge,
    judge_rest,
    map_of,
    move,
)
from agent.host import stops
from agent.verify.finding import Finding, Verdict
from drivers.interface import Vector
from tests.support.command import coop
from tests.support.servos.dxl_rig import WX200, Rig, build

MAP = replace(WX200, joints=tuple(replace(j, start_rad=None, tau_max_Nm=min(j.tau_max_Nm, 1.2)) for j in WX200.joints))
JOINTS = [
    Joint("shoulder", (2, 3), 1.2, 0.2, "forward"),
    Joint("elbow", (4,), 0.6, 0.1, "down"),
    Joint("wrist_angle", (5,), 0.6, 0.1, "down"),
    Joint("wrist_rotate", (6,), 0.2, 0.05, None),
]
NAMES = [joint.name for joint in JOINTS]
CELL = load_cell(Path("two_wx200"))


class Person:
    """Looks at the joints of the rig, and knows which way each is to go first."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.asked = rig, 0
        self.start = self.angles()
        self.most = 0.0
        self.first: dict[str, float] = {}
        write = rig.driver.write

        def watched(tau: Vector) -> Vector:
            self.look()
            return write(tau)

        rig.driver.write = watched  # type: ignore[method-assign]

    def angles(self) -> dict[str, float]:
        return {j.name: j.free.q_rad for j in self.rig.cell.arms[0].joints if j.free is not None}

    def look(self) -> None:
        for name, angle in self.angles().items():
            away = angle - self.start[name]
            self.most = max(self.most, abs(away))
            if abs(away) > 0.5 * MOVED_RAD:
                self.first.setdefault(name, away)

    def __call__(self, question: str) -> bool:
        self.asked += 1
        assert self.rig.driver._phase.name != "ENABLED", "torque is off while a person thinks"
        name = question.removeprefix("Joint ").partition(":")[0]
        return self.first[name] > 0.0


def tried(spoil: Callable[[Rig], None] = lambda _: None) -> tuple[list[Finding], Person, Rig]:
    rig = build(MAP)
    spoil(rig)
    person = Person(rig)
    rig.driver.connect()
    found = move("left", JOINTS, rig.driver, rig.clock, MAP.period_ns, person)
    person.look()
    return found, person, rig


def mount(rig: Rig, joint: str, *, servos: tuple[int, ...] = (0,)) -> None:
    """Turn servos of a joint round; what they report begins anew."""
    arm = rig.cell.arms[0]
    for entry in arm.joints:
        if entry.name == joint:
            for i in servos:
                entry.mounts[i].sign *= -1.0
    arm.power_up([])


def current(rig: Rig, servo: int) -> None:
    motor = rig.servo(servo).firmware.body.motor
    motor.data = replace(motor.data, torque_constant_Nm_per_A=-motor.data.torque_constant_Nm_per_A)


def wrong(found: list[Finding]) -> list[Finding]:
    return [f for f in found if f.verdict is Verdict.REFUSED]


def test_a_sound_arm_moves_each_joint_a_little_both_ways_and_torque_is_off_at_the_end() -> None:
    found, person, rig = tried()
    assert not wrong(found), [f.line for f in wrong(found)]
    assert [f.what for f in found if f.what.endswith("motion")] == [f"joint {name}: motion" for name in NAMES]
    assert person.asked == 3
    assert set(person.first) >= set(NAMES)
    assert person.most < 0.05
    assert rig.driver._phase.name == "CONNECTED"
    assert all(f.verdict is Verdict.OK for f in found), [f.line for f in found if f.verdict is not Verdict.OK]


@pytest.mark.parametrize(
    ("spoil", "joint", "key"),
    [
        (lambda rig: mount(rig, "elbow"), "elbow", "`reverse` of joint elbow"),
        (lambda rig: mount(rig, "shoulder", servos=(0, 1)), "shoulder", "`reverse` of joint shoulder"),
        (lambda rig: current(rig, 4), "elbow", "exchange the servo"),
        (lambda rig: current(rig, 3), "shoulder", "`reverse` and `ids` of joint shoulder"),
    ],
    ids=["reversed", "swapped pair", "sign of current", "sign of current in one of a pair"],
)
def test_what_is_wrong_is_found_before_much_motion_with_joint_and_remedy(
    spoil: Callable[[Rig], None], joint: str, key: str
) -> None:
    found, person, rig = tried(spoil)
    assert len(wrong(found)) == 1
    assert found[-1] is wrong(found)[0], "the first joint that is wrong is the last that moves"
    assert f"joint {joint}" in found[-1].line
    assert key in found[-1].line
    assert person.most < 0.05
    assert rig.driver._phase.name == "CONNECTED"


def test_an_arm_that_sinks_is_stopped() -> None:
    def heavy(rig: Rig) -> None:
        for joint in rig.cell.arms[0].joints:
            if joint.name == "elbow" and joint.free is not None:
                joint.free.gravity_Nm = 0.5

    found, _, rig = tried(heavy)
    assert "support the arm" in found[-1].line
    assert "at most 0.04 rad" in found[-1].line
    assert rig.driver._phase.name == "CONNECTED"


@pytest.mark.parametrize(
    ("q", "told"),
    [
        ({"shoulder": -1.8, "elbow": 1.5, "wrist_angle": 0.0}, None),
        ({"shoulder": 1.85, "elbow": 1.5, "wrist_angle": 0.0}, ("shoulder", "`reverse` of joint shoulder")),
        ({"shoulder": -1.88, "elbow": 1.5, "wrist_angle": 1.57}, ("wrist_angle", "zero_tick of joint wrist_angle")),
        ({"shoulder": -1.88, "elbow": 0.9, "wrist_angle": 0.0}, ("elbow", "rest pose")),
    ],
)
def test_the_rest_pose_tells_reversed_joints_and_zeros_without_torque(
    q: dict[str, float], told: tuple[str, str] | None
) -> None:
    rest = {"shoulder": -1.88, "elbow": 1.5, "wrist_angle": 0.0}
    problems = wrong(judge_rest("left", rest, q))
    if told is None:
        assert not problems
    else:
        assert len(problems) == 1
        assert all(word in problems[0].line for word in told)


def place(rig: Rig, q: dict[str, float]) -> None:
    for joint in rig.cell.arms[0].joints:
        if joint.free is not None and joint.name in q:
            joint.free.q_rad, joint.free.dq_rad_per_s = q[joint.name], 0.0
    rig.cell.arms[0].power_up([])


SLEEP = dict(CELL.arms[0].file.sleep_rad)


def lay(spoil: Callable[[Rig], None], lifted: dict[str, float], *, says: bool = True) -> tuple[list[Finding], int, int]:
    """A whole first motion of an arm that lies at rest; how often torque came on, and how many questions there were."""
    arm = CELL.arms[0]
    rig = build(map_of(CELL, arm, "virtual"))
    place(rig, SLEEP)
    spoil(rig)
    person, asked, on = Person(rig), 0, 0
    enable = rig.driver.enable

    def ask(question: str) -> bool:
        nonlocal asked
        asked += 1
        if question == LIFTED:
            rig.clock.sleep_until(rig.clock.now_ns() + 3_000_000_000)
            place(rig, lifted)
            person.start = person.angles()
        return says if question in (AT_REST, LIFTED) else person.first[question.split()[1].strip(":")] > 0.0

    def counted() -> None:
        nonlocal on
        on += 1
        enable()

    rig.driver.enable = counted  # type: ignore[method-assign]
    found = first_motion(CELL, arm, rig.driver, rig.clock, ask)
    assert not rig.port.is_open
    return found, on, asked


def test_a_whole_first_motion_goes_from_rest_to_lifted_to_every_joint() -> None:
    found, on, asked = lay(lambda _: None, {"shoulder": -0.6, "elbow": 0.7, "wrist_angle": 0.4})
    assert not wrong(found), [f.line for f in wrong(found)]
    assert on > 0
    assert asked == 2 + 3


@pytest.mark.parametrize(
    ("spoil", "lifted", "says", "told"),
    [
        (lambda rig: mount(rig, "shoulder", servos=(0, 1)), {}, True, "`reverse` of joint shoulder"),
        (lambda rig: place(rig, {"elbow": 1.5 - 1.57}), {}, True, "zero_tick of joint elbow"),
        (lambda _: None, SLEEP, True, "end stops"),
        (lambda _: None, {}, False, "a person's yes"),
    ],
    ids=["reversed", "zero by 90 degrees", "not lifted", "no"],
)
def test_no_torque_before_rest_pose_room_and_a_yes(
    spoil: Callable[[Rig], None], lifted: dict[str, float], says: bool, told: str
) -> None:
    found, on, _ = lay(spoil, lifted, says=says)
    assert on == 0
    assert told in found[-1].line or any(told in f.line for f in wrong(found))


def test_an_arm_is_laid_as_its_cell_says_that_it_rests() -> None:
    cell = load_cell(Path("two_wx200"), ["arms.left.rest_rad={elbow=1.0}"])
    rig = build(map_of(cell, cell.arms[0], "virtual"))
    place(rig, SLEEP | {"elbow": 1.0})
    found = first_motion(cell, cell.arms[0], rig.driver, rig.clock, lambda question: question == AT_REST)
    assert not wrong(found)
    assert found[-1].what == "first motion", "a no to the second question"
    assert "1.00 ± 0.35 rad" in next(f.wanted for f in found if "elbow" in f.what)


def test_what_is_to_be_seen_is_the_way_of_the_gripper() -> None:
    arm = CELL.arms[0]
    model = CELL.model(arm)
    q, step = np.array(arm.entry.q_near_rad), 1e-4
    R = arm.T_world_base.rotation
    words = {"forward": (0, 1), "backward": (0, -1), "up": (2, 1), "down": (2, -1)}
    for j, joint in enumerate(joints_of(arm, model, q)):
        before, after = (model.object_pose(q + s * step * np.eye(3)[j]) * arm.T_object_ee for s in (-1.0, 1.0))
        way = R.T @ (after.translation - before.translation) / (2.0 * step)
        axis, sign = words[joint.seen or ""]
        assert axis == np.argmax(np.abs(way))
        assert np.sign(way[axis]) == sign
        assert joint.bound_Nm <= 0.151 * arm.tau_stall_Nm[j]


def test_the_map_of_a_first_motion_has_small_torques_and_no_start_pose() -> None:
    servos = map_of(CELL, CELL.arms[0], "virtual")
    assert all(joint.start_rad is None for joint in servos.joints)
    for joint in servos.controlled:
        assert joint.tau_max_Nm <= 0.151 * joint.model.stall_torque_Nm * len(joint.ids)


@pytest.mark.parametrize("arms", [(), ("left", "right")])
def test_a_first_motion_is_of_one_arm(arms: tuple[str, ...]) -> None:
    with pytest.raises(MoveError, match="--arm NAME"):
        move_arm(CELL, DoctorOptions(arms), lambda _: pytest.fail("no question"), Diagnosis("cell", ""))


def test_an_arm_of_which_something_is_refused_is_not_tried() -> None:
    out = Diagnosis("cell", "", [Finding("servos", "left", "5", "6", Verdict.REFUSED)])
    move_arm(CELL, DoctorOptions(("left",)), lambda _: pytest.fail("no question"), out)
    assert (out.findings[-1].verdict, out.findings[-1].found) == (Verdict.WARNING, "not tried")


@pytest.mark.parametrize(
    ("torque_Nm", "measured_Nm", "told"),
    [(0.2, 0.2, None), (0.35, 0.35, "coulomb_Nm of joint elbow"), (0.2, 0.1, "torque_constant_Nm_per_A of elbow")],
)
def test_implausible_friction_and_current_are_warnings(torque_Nm: float, measured_Nm: float, told: str | None) -> None:
    up, down = Motion(0.013, torque_Nm, measured_Nm), Motion(-0.013, -torque_Nm, -measured_Nm)
    found = judge("left", JOINTS[1], up, down, lambda _: True)
    warned = [f.line for f in found if f.verdict is not Verdict.OK]
    assert len(warned) == (told is not None)
    assert told is None or told in warned[0]


@pytest.mark.parametrize("move", [True, False])
def test_a_first_motion_is_not_suspended_by_ctrl_z(monkeypatch: pytest.MonkeyPatch, move: bool) -> None:
    monkeypatch.setattr(doctor, "diagnose", lambda *_: Diagnosis("cell", ""))
    heard = list[object]()
    monkeypatch.setattr(doctor, "move_arm", lambda *_: heard.append(signal.getsignal(signal.SIGTSTP)))
    before = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
    try:
        coop("doctor", "two_wx200", "--arm", "left", *(["--move"] if move else []))
    finally:
        signal.signal(signal.SIGTSTP, before)
    assert heard == [stops._interrupt] * move
