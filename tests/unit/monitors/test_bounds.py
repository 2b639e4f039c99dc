"""The bounds of an arm's monitors are what the page says: from the arm's files, the motion and the tolerance."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.config import monitors
from agent.config.cell import Cell, load_cell
from agent.config.friction import lifting_Nm
from agent.config.monitors import bounds
from agent.config.reading import ConfigError
from agent.control import ik
from agent.control.trajectory_rest import minimum_jerk
from agent.monitors.bounds import Bounds, Name
from drivers.dynamixel.servo.models import SERVOS
from drivers.interface import Vector
from tests.support.arm_files import pressed_on, with_figures
from tests.support.control.level_wx200 import LEVEL


def load(name: str, *overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", overrides)


def of_left(*overrides: str) -> Bounds:
    cell = load("two_wx200", *overrides)
    return bounds(cell, cell.arm("left"))


Q_NEAR = np.array(load("two_wx200").arm("left").entry.q_near_rad)
STILL = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")


def test_they_follow_from_servos_and_urdf() -> None:
    b, xm430 = of_left(*STILL), SERVOS["XM430-W350"]
    assert b.joints == ("shoulder", "elbow", "wrist_angle")
    assert b.stall_Nm == (8.2, 4.1, 4.1)
    assert b.speed_rad_per_s == pytest.approx([0.2 * xm430.no_load_rad_per_s] * 3)
    assert b.power_W == pytest.approx([0.5 * stall * xm430.no_load_rad_per_s / 4.0 for stall in b.stall_Nm])
    np.testing.assert_allclose(b.position_rad[0], [-1.884956 + 0.02, 1.972222 - 0.02])
    assert b.frozen_Nm == pytest.approx([0.6, 0.3, 0.3])
    assert b.object_weight_N == pytest.approx((0.0, 0.0, 0.062 * 9.81))
    assert (b.load_share_of_weight, b.period_s, b.watched) == (0.5, 0.005, frozenset(Name))


def test_those_of_all_arms_are_those_of_each() -> None:
    cell = load("two_models")
    assert monitors.bounds_of_all(cell) == [bounds(cell, arm) for arm in cell.arms]


def test_a_motion_may_be_twice_as_fast_and_no_faster_than_servos_are() -> None:
    slow, once = np.array(of_left(*STILL).speed_rad_per_s), np.array(of_left().speed_rad_per_s)
    twice = np.array(of_left("trajectory.period_s=4.5").speed_rad_per_s)
    assert (once > slow + 0.05).all()
    np.testing.assert_allclose(twice - slow, 2.0 * (once - slow), rtol=0.02)
    top = 0.85 * SERVOS["XM430-W350"].no_load_rad_per_s
    assert of_left("trajectory.period_s=0.3").speed_rad_per_s == pytest.approx([top] * 3)


class Sought:
    """Poses of the motion that joints were looked for, from where on, and what was found."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *overrides: str) -> None:
        self.cell = load("two_wx200", *overrides)
        self.places: list[Vector] = []
        self.near: list[Vector] = []
        self.found: list[Vector] = []
        solve = ik.solve

        def seen(model: Any, T_world_object: Any, q_near: Vector) -> Vector:
            self.places.append(T_world_object.translation.copy())
            self.near.append(q_near.copy())
            self.found.append(solve(model, T_world_object, q_near))
            return self.found[-1]

        monkeypatch.setattr(ik, "solve", seen)
        arm = self.cell.arms[0]
        self.fastest = monitors.speeds_of_motion(self.cell, arm, self.cell.model(arm))

    def speeds(self, times: Vector) -> Vector:
        """(k, n) rad/s at the joints found."""
        model, at = self.cell.model(self.cell.arms[0]), self.cell.trajectory().at
        twists = [model.task_basis @ np.array(at(t).v) for t in times.tolist()[: len(self.found)]]
        return np.array([np.linalg.solve(model.jacobian(q), v) for q, v in zip(self.found, twists, strict=True)])


@pytest.mark.parametrize(
    ("steps", "period_s", "ramp_s", "leads"), [(99, 9.0, 3.0, 99), (11, 2.0, 2.0, 8), (99, 1.4, 1.45, 124)]
)
def test_speeds_are_those_at_the_joints_of_the_motion_each_looked_for_ahead_of_the_last(
    monkeypatch: pytest.MonkeyPatch, steps: int, period_s: float, ramp_s: float, leads: int
) -> None:
    """Ahead by what the last speed makes of the time between, unless that is far: some of 11 steps are.

    The last motion has instants beside the even ones.
    """
    assert monitors.STEPS == 99
    monkeypatch.setattr(monitors, "STEPS", steps)
    sought = Sought(
        monkeypatch, "duration_s=3.0", f"trajectory.period_s={period_s}", f"trajectory.ramp_s={ramp_s}"
    )  # fmt: skip
    times = np.linspace(0.0, min(3.0, period_s + 0.5 * ramp_s), steps + 1)
    if ramp_s > period_s:
        times = np.unique([*times, *np.linspace(ramp_s, ramp_s + period_s, 25)])
        times = times[times <= 3.0]
    np.testing.assert_allclose(sought.places, [sought.cell.trajectory().at(t).p for t in times], atol=1e-12)
    speeds = sought.speeds(times)
    np.testing.assert_allclose(sought.fastest, np.abs(speeds).max(axis=0), rtol=1e-9)
    ways = speeds[:-1] * np.diff(times)[:, None]
    far = np.abs(ways).max(axis=1) > 0.1
    led = np.array(sought.near[1:]) - np.array(sought.found[:-1])
    np.testing.assert_allclose(led, np.where(far[:, None], 0.0, ways), atol=1e-12)
    assert (~far).sum() == leads
    if period_s == 9.0:
        usual = 0.2 * SERVOS["XM430-W350"].no_load_rad_per_s
        assert of_left("duration_s=3.0").speed_rad_per_s == pytest.approx(usual + 2.0 * sought.fastest)


def with_motion(tmp_path: Path, motion: str, poses: str = "") -> Cell:
    text = (configs.CELLS_DIR / "two_wx200.toml").read_text()
    (tmp_path / "cell.toml").write_text(re.sub(r"\[trajectory\]\n(.+\n)+", f"[trajectory]\n{motion}\n", text))
    (tmp_path / "way.csv").write_text(poses)
    return load_cell(tmp_path / "cell.toml", ["duration_s=130.0"])


def quick_file(begins_s: float) -> str:
    """Rows ten times a second through minutes of rest, and more often through a way out and back of 0.3 s each."""
    times = sorted({*np.arange(0.0, 120.05, 0.1).round(3), *(begins_s + np.arange(0.0, 0.605, 0.01)).round(3)})
    ways = [0.05 * (minimum_jerk(t - begins_s, 0.3)[0] - minimum_jerk(t - begins_s - 0.3, 0.3)[0]) for t in times]
    rows = [f"{t},{0.225 + way:.9f},0,0.25,1,0,0,0" for t, way in zip(times, ways, strict=True)]
    return "\n".join(["t_s,x_m,y_m,z_m,qw,qx,qy,qz", *rows]) + "\n"


def test_a_quick_move_is_as_fast_however_long_the_arms_wait(tmp_path: Path) -> None:
    """Between instants more than a second apart; an arm would hold for the speed of its own motion."""
    move = (
        'kind="rest_to_rest"\np_from_m=[0.225, 0.0, 0.25]\np_to_m=[0.275, 0.0, 0.27]\n'
        "move_s=0.5\nwait_s={}\nand_back=true"
    )
    found = [bounds(c, c.arms[0]) for c in (with_motion(tmp_path, move.format(wait_s)) for wait_s in (0.5, 30.0, 60.0))]
    for longer in found[1:]:
        assert longer.speed_rad_per_s == pytest.approx(found[0].speed_rad_per_s, rel=0.01)
        assert longer.workspace_m == found[0].workspace_m
    of_files = [
        with_motion(tmp_path, 'kind="file"\npath="way.csv"', quick_file(begins_s)) for begins_s in (60.45, 60.9)
    ]  # at one of the even instants, and between two
    seen, hidden = (monitors.speeds_of_motion(c, c.arms[0], c.model(c.arms[0])) for c in of_files)
    assert hidden.max() > 1.5
    np.testing.assert_allclose(hidden, seen, rtol=0.02)
    for one in of_files:
        assert bounds(one, one.arms[0]).workspace_m[0] == pytest.approx((0.125, 0.375), abs=1e-3)


def test_an_arm_alone_may_be_as_fast_as_its_session_says_and_lie_as_it_rests() -> None:
    no_load = SERVOS["XM430-W350"].no_load_rad_per_s
    without = of_left(*STILL)
    assert without.speed_alone_rad_per_s == pytest.approx([0.2 * no_load + 0.6] * 3), "as a session is by itself"
    assert without.position_alone_rad == without.position_rad
    quick = of_left("session.speed_max_rad_per_s=1.5", "session.off_max_rad=0.31")
    assert quick.speed_alone_rad_per_s == pytest.approx([0.2 * no_load + 1.5] * 3)
    assert of_left("session.speed_max_rad_per_s=2.0", "safety.monitors.speed_share=0.8").speed_alone_rad_per_s == (
        pytest.approx([0.85 * no_load] * 3)
    )
    rest = [load("two_wx200").arm("left").file.sleep_rad[joint] for joint in quick.joints]
    wanted = [(min(a, r - 0.31), max(b, r + 0.31)) for (a, b), r in zip(quick.position_rad, rest, strict=True)]
    np.testing.assert_allclose(quick.position_alone_rad, wanted)
    wider = np.array(quick.position_alone_rad) != np.array(quick.position_rad)
    assert wider.any(axis=0).all(), "below and above"


def test_a_motion_out_of_reach_is_for_the_check_to_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    sought = Sought(monkeypatch, "trajectory.p_amplitude_m=[0.5, 0.0, 0.0]")
    assert len(sought.places) == len(sought.found) + 1 < 100, "nothing is looked for behind it"
    assert (sought.fastest > 0.0).all()


def test_the_box_is_around_motion_and_start_or_as_given() -> None:
    (x0, x1), (y0, y1), (z0, z1) = of_left().workspace_m
    assert (x0, x1) == pytest.approx((0.075, 0.375), abs=1e-3)
    assert (y0, y1, z0, z1) == pytest.approx((-0.1, 0.1, 0.15, 0.35))
    assert of_left(*STILL, "object.p_start_m=[0.21, 0.0, 0.25]").workspace_m[0] == pytest.approx((0.11, 0.325))
    short = ("trajectory.period_s=1.2", "duration_s=0.9")
    at = load("two_wx200", *short).trajectory().at
    along = [0.225, *(at(t).p[0] for t in np.linspace(0.0, 0.9, 100))]
    assert of_left(*short).workspace_m[0] == pytest.approx((min(along) - 0.1, max(along) + 0.1), abs=1e-12)
    given = "safety.monitors.workspace_m=[[0.1, 0.7], [-0.2, 0.2], [0.0, 0.5]]"
    assert of_left(given).workspace_m == ((0.1, 0.7), (-0.2, 0.2), (0.0, 0.5))
    with pytest.raises(ConfigError, match="low to high"):
        of_left("safety.monitors.workspace_m=[[0.7, 0.1], [-0.2, 0.2], [0.0, 0.5]]")


def test_the_box_is_around_way_points_between_its_samples_and_none_behind_the_run() -> None:
    # every 40 ms a way-point, quick to and fro in y but for two slower ways out in x; a sample every 0.3 s
    out = [max(0.0, 0.02 - abs(k - 364) / 150, 0.04 - abs(k - 780) / 150) for k in range(801)]
    points = ", ".join(
        f"{{t_s = {0.04 * k:.2f}, p_m = [{0.225 + x:.6f}, {0.02 * (k % 2 and not x):.2f}, 0.25]}}"
        for k, x in enumerate(out)
    )
    motion = (f'trajectory={{kind = "waypoints", points = [{points}]}}', "object.p_start_m=[0.225, 0.0, 0.25]")
    low, high = of_left(*motion, "duration_s=40.0").workspace_m[0]
    assert (low, high) == pytest.approx((0.125, 0.365), abs=2e-3)
    assert of_left(*motion, "duration_s=31.0").workspace_m[0][1] == pytest.approx(0.345, abs=2e-3)


def test_monitors_are_switched_off_by_name() -> None:
    b = of_left('safety.monitors.off=["speed", "gravity"]')
    assert frozenset(Name) - b.watched == {Name.SPEED, Name.GRAVITY}
    with pytest.raises(ConfigError, match="speed"):
        of_left('safety.monitors.off=["haste"]')


EXACT = (
    "tolerance.masses=0.0",
    "tolerance.torque_constant=0.0",
    "tolerance.friction=[1.0, 1.0]",
    "tolerance.object=0.0",
)


def test_weight_at_rest_may_be_off_by_what_the_tolerance_allows() -> None:
    """Each error alone, and all together as their quadratic sum."""

    cell = load("two_wx200", *LEVEL)
    k = cell.model(cell.arms[0]).evaluate(np.array([-0.35281558, 0.68875737, -0.33594179]), np.zeros(3))
    J_inv_T = np.linalg.inv(k.J).T
    weight = k.Jt[:, :3] @ np.array([0.0, 0.0, 0.031 * 9.81])
    friction = np.linalg.norm(J_inv_T * [0.2, 0.1, 0.1], axis=1)[1]
    parts = {
        "tolerance.masses=0.5": 0.5 * abs(J_inv_T @ k.g)[1],
        "tolerance.torque_constant=0.5": 0.5 * np.linalg.norm(J_inv_T * (k.g + weight), axis=1)[1],
        "tolerance.object=0.9": 0.9 * 0.031 * 9.81,
    }
    level = (*LEVEL, *EXACT)
    for given, part in parts.items():
        assert of_left(*level, given).gravity[2] == pytest.approx(1.4 * math.hypot(part, friction), rel=0.02), given
    both = math.hypot(*parts.values(), friction)
    assert of_left(*level, *parts).gravity[2] == pytest.approx(1.4 * both, rel=0.02)
    assert of_left(*level, "tolerance.friction=[1.0, 3.0]").gravity[2] == pytest.approx(1.4 * 3.0 * friction, rel=0.02)
    more = 2.0 * np.array([0.2, 0.1, 0.1]) + 0.05 * np.abs(k.g + weight)
    sticking = of_left(*level, "tolerance.breakaway=1.0", "tolerance.load_friction=0.05")
    wanted = 1.4 * np.linalg.norm(J_inv_T * more, axis=1)[1]
    assert sticking.gravity[2] == pytest.approx(wanted, rel=0.02), "beside what the files have"
    assert sticking.frozen_Nm == pytest.approx(3.0 * more, rel=0.02)


def test_torque_constants_that_are_off_make_something_of_a_squeeze_too() -> None:
    """Object axes, which are turned against the world's in this cell's start."""
    squeeze = {"left": [4.0, 0.0, 1.0], "right": [-4.0, 0.0, -1.0]}
    pressed = [f"arms.{arm}.internal_wrench_N_Nm={[*f, 0.0, 0.0, 0.0]}" for arm, f in squeeze.items()]
    turned = ("trajectory.angle_rad=0.0", "trajectory.quat_centre=[0.9937607, 0.0, 0.1115313, 0.0]")
    start = "object.quat_start=[0.9937607, 0.0, 0.1115313, 0.0]"
    cell = load("two_wx200", *EXACT, "tolerance.torque_constant=0.5", *pressed, *turned, start)
    sizes = []
    for arm in cell.arms:
        model = cell.model(arm)
        k = model.evaluate(ik.solve(model, cell.T_world_object_start, np.array(arm.entry.q_near_rad)), np.zeros(3))
        force = cell.T_world_object_start.rotation @ squeeze[arm.name] + [0.0, 0.0, 0.031 * 9.81]
        held = k.g + k.Jt[:, :3] @ force
        friction = [lifting_Nm(servo, tau) for servo, tau in zip(arm.servos, held.tolist(), strict=True)]
        J_inv_T = np.linalg.inv(k.J).T
        each = np.hstack([0.5 * J_inv_T * held, J_inv_T * friction])
        sizes.append(1.4 * np.linalg.norm(each, axis=1))
    found = bounds(cell, cell.arms[0]).gravity
    assert [found[0], found[2], found[4]] == pytest.approx(np.max(sizes, axis=0), rel=1e-3)


def test_a_joint_that_is_pressed_on_may_stick_as_its_load_at_the_start_lets_it(tmp_path: Path) -> None:
    """The object's part in that load is of its own sign."""
    cell = with_figures(load("two_wx200", *EXACT, "object.mass_kg=0.4"), tmp_path, pressed_on)
    arm = cell.arm("left")
    k = cell.model(arm).evaluate(ik.solve(cell.model(arm), cell.T_world_object_start, Q_NEAR), np.zeros(3))
    held = k.g + k.Jt[:, :3] @ np.array([0.0, 0.0, 0.5 * 0.4 * 9.81])
    friction = np.array([lifting_Nm(s, tau) for s, tau in zip(arm.servos, held.tolist(), strict=True)])
    unloaded = np.array([lifting_Nm(s, tau) for s, tau in zip(arm.servos, k.g.tolist(), strict=True)])
    assert (np.abs(friction - unloaded) > 0.01).all()
    found = bounds(cell, arm)
    assert found.frozen_Nm == pytest.approx(3.0 * friction)
    assert found.gravity[2] == pytest.approx(1.4 * np.linalg.norm(np.linalg.inv(k.J).T * friction, axis=1)[1])


def test_it_has_floors_a_factor_and_more_room_for_an_arm_that_learns() -> None:
    usual = np.array(of_left().gravity)
    assert usual[[1, 3, 5]] == pytest.approx([0.3, 0.03, 0.03])  # out of the plane
    assert of_left("safety.monitors.gravity_times=2.0").gravity == pytest.approx(2.0 * usual)
    learning = np.array(of_left("controller.kind=adaptive").gravity)
    assert learning[[0, 2, 4]] == pytest.approx(1.9 * usual[[0, 2, 4]])


def test_the_floors_hold_where_nothing_is_uncertain(tmp_path: Path) -> None:
    smooth = with_figures(load("two_wx200", *EXACT), tmp_path, lambda _: {"coulomb_Nm": 1e-6})
    assert bounds(smooth, smooth.arms[0]).gravity == pytest.approx((0.3, 0.3, 0.3, 0.03, 0.03, 0.03))


def test_a_start_out_of_reach_is_refused() -> None:
    with pytest.raises(ConfigError, match="start pose out of reach"):
        of_left("object.p_start_m=[3.0, 0.0, 0.25]")
