"""Motions from pose to pose, through way-points and from a file: continuous, at rest at both ends, or refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import configs
from agent.config.cell import Cell, ConfigError, cell_from_toml, load_cell
from agent.config.trajectory import sample_times, waypoint_times
from agent.control.quaternion import Quat, angle_between, conjugate, from_axis_angle, multiply
from agent.control.trajectory import Desired, Trajectory
from agent.control.trajectory_file import COLUMNS, SpeedLimits, read
from agent.control.trajectory_rest import RestToRest
from agent.control.trajectory_spline import PoseSpline, TrajectoryError, quintic, same_hemisphere
from agent.verify import check
from agent.verify.check import Verdict, examine
from drivers.interface import Refusal
from tests.support.control.oracle import rate_at
from tests.support.control.strategies import examples, random_pose, random_unit

SEEDS = st.integers(0, 2**32 - 1)
LIMITS = SpeedLimits(0.5, 2.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0,) * 6


def spline_of(seed: int, count: int = 6) -> PoseSpline:
    """Way-points up to a radian apart, with the sign of each quaternion as it comes."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 3.0, count)).tolist()
    positions = [tuple(rng.uniform(-0.2, 0.2, 3).tolist()) for _ in times]
    quats: list[Quat] = [tuple(x.tolist()) for x in rng.normal(size=(1, 4)) / 2.0]
    quats = [tuple(np.array(quats[0]) / np.linalg.norm(quats[0]))]
    for _ in times[1:]:
        turn = from_axis_angle(tuple(random_unit(rng).tolist()), float(rng.uniform(0.0, 1.0)))
        flip = rng.choice([-1.0, 1.0])
        quats.append(tuple(flip * x for x in multiply(turn, quats[-1])))
    return PoseSpline(times, positions, quats)


def rest_of(seed: int) -> RestToRest:
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(2):
        T = random_pose(rng, 0.3)
        x, y, z, w = pin.Quaternion(T.rotation).coeffs().tolist()
        poses += [tuple(T.translation.tolist()), (w, x, y, z)]
    move, wait = rng.uniform(2.0, 5.0), rng.choice([0.0, 1.0])
    return RestToRest(*poses, float(move), float(wait), and_back=bool(rng.random() < 0.5))


MOTIONS: list[Callable[[int], Trajectory]] = [spline_of, rest_of]


def state(d: Desired) -> np.ndarray:
    """(19,) all that must be continuous."""
    return np.array([*d.p, *d.quat, *d.v, *d.a])


@pytest.mark.parametrize("motion", MOTIONS)
@given(seed=SEEDS, where=st.floats(0.02, 0.98))
@examples(60)
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(
    motion: Callable[[int], Trajectory], seed: int, where: float
) -> None:
    trajectory = motion(seed)
    t = where * trajectory.period_s
    now = trajectory.at(t)

    def pose(s: float) -> np.ndarray:
        d = trajectory.at(s)
        return np.array([*d.p, *(2.0 * x for x in multiply(d.quat, conjugate(now.quat))[1:])])

    assert rate_at(pose, t) == pytest.approx(now.v, abs=1e-6)
    assert rate_at(lambda s: np.array(trajectory.at(s).v), t) == pytest.approx(now.a, abs=2e-3)  # the jerk may jump
    assert math.hypot(*now.quat) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("motion", MOTIONS)
@given(seed=SEEDS)
@examples(40)
def test_pose_twist_and_acceleration_are_continuous_and_the_quaternion_never_flips(
    motion: Callable[[int], Trajectory], seed: int
) -> None:
    trajectory = motion(seed)
    instants = np.linspace(-0.1, trajectory.period_s + 0.1, 4001)
    states = np.array([state(trajectory.at(float(t))) for t in instants])
    steps = np.abs(np.diff(states, axis=0))
    scale = np.abs(states).max(axis=0) + 1e-9
    assert (steps.max(axis=0) <= 0.05 * scale + 1e-9).all()
    assert np.einsum("ij,ij->i", states[1:, 3:7], states[:-1, 3:7]).min() > 0.99


@pytest.mark.parametrize("motion", MOTIONS)
@given(seed=SEEDS)
@examples(30)
def test_motions_begin_and_end_at_rest_and_stay_there(motion: Callable[[int], Trajectory], seed: int) -> None:
    trajectory = motion(seed)
    first, last, later = (trajectory.at(t) for t in (0.0, trajectory.period_s, trajectory.period_s + 1e3))
    for d in (first, last, later):
        assert d.v == pytest.approx(STILL, abs=1e-9)
        assert d.a == pytest.approx(STILL, abs=1e-8)
    assert later.p == pytest.approx(last.p, abs=1e-12)
    assert angle_between(later.quat, last.quat) < 1e-9


@given(SEEDS)
@examples(40)
def test_the_spline_passes_its_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = [0.0, 1.0, 1.5, 4.0]
    positions = [tuple(p) for p in rng.uniform(-0.2, 0.2, (4, 3)).tolist()]
    quats = [from_axis_angle(tuple(random_unit(rng).tolist()), 0.4) for _ in times]
    spline = PoseSpline(times, positions, [q if k % 2 else tuple(-x for x in q) for k, q in enumerate(quats)])
    for t, p, quat in zip(times, positions, quats, strict=True):
        assert spline.at(t).p == pytest.approx(p, abs=1e-12)
        assert angle_between(spline.at(t).quat, quat) < 1e-7
    assert spline.period_s == 4.0


@pytest.mark.parametrize("count", [2, 3, 4, 7, 60])
@pytest.mark.parametrize("unevenness", [0.0, 1.5])
def test_the_spline_is_that_of_scipy(count: int, unevenness: float) -> None:
    """All coefficients, as parts of the values; times between neighbours differ up to thirty-fold."""
    from scipy.interpolate import make_interp_spline  # half a second, of which every worker would have its own

    rng = np.random.default_rng(count)
    times = np.cumsum(10.0 ** rng.uniform(-unevenness, 0.0, count))
    values, still = rng.normal(size=(count, 7)), [(1, np.zeros(7)), (2, np.zeros(7))]
    theirs = make_interp_spline(times, values, k=5, bc_type=(still, still))
    parts = np.diff(times)[:, None, None] ** np.arange(6.0)[None, :, None]
    expected = np.stack([theirs(times[:-1], nu=k) / math.factorial(k) for k in range(6)], axis=1) * parts
    found = quintic(times.tolist(), values) * parts
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


@given(SEEDS)
@examples(30)
def test_moving_all_poses_moves_the_motion(seed: int) -> None:
    """The spline does not depend on the world frame: T · motion(poses) = motion(T · poses)."""
    rng = np.random.default_rng(seed)
    times, T = [0.0, 1.0, 2.5, 3.0], random_pose(rng, 1.0)
    x, y, z, w = pin.Quaternion(T.rotation).coeffs().tolist()
    positions = rng.uniform(-0.2, 0.2, (4, 3))
    quats = [from_axis_angle(tuple(random_unit(rng).tolist()), 0.5) for _ in times]
    here = PoseSpline(times, [tuple(p) for p in positions.tolist()], quats)
    there = PoseSpline(times, [tuple(T.act(p).tolist()) for p in positions], [multiply((w, x, y, z), q) for q in quats])
    for t in np.linspace(0.0, 3.0, 13).tolist():
        a, b = here.at(t), there.at(t)
        assert T.act(np.array(a.p)) == pytest.approx(b.p, abs=1e-10)
        assert angle_between(multiply((w, x, y, z), a.quat), b.quat) < 1e-7
        turned = np.kron(np.eye(2), T.rotation)
        assert turned @ a.v == pytest.approx(b.v, abs=1e-9)
        assert turned @ a.a == pytest.approx(b.a, abs=1e-8)


@given(SEEDS)
@examples(20)
def test_two_way_points_are_the_minimum_jerk_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (tuple(rng.uniform(-0.3, 0.3, 3).tolist()) for _ in range(2))
    spline, line = PoseSpline([0.0, 2.0], [a, b], [UPRIGHT] * 2), RestToRest(a, UPRIGHT, b, UPRIGHT, 2.0, 0.0, False)
    for t in (0.3, 1.0, 1.7):
        assert spline.at(t).p == pytest.approx(line.at(t).p, abs=1e-12)
        assert spline.at(t).a == pytest.approx(line.at(t).a, abs=1e-10)


def test_rest_to_rest_takes_the_short_way_round_and_comes_back() -> None:
    far: Quat = tuple(-x for x in from_axis_angle((0.0, 0.0, 1.0), 0.5))
    motion = RestToRest((0.0, 0.0, 0.0), UPRIGHT, (0.1, 0.0, 0.0), far, 2.0, 1.0, and_back=True)
    assert motion.period_s == 6.0
    middle = motion.at(2.0)
    assert middle.p == pytest.approx((0.05, 0.0, 0.0))
    assert angle_between(middle.quat, UPRIGHT) == pytest.approx(0.25)
    assert middle.v[0] == pytest.approx(0.1 * 1.875 / 2.0)  # 15/8 of the mean speed
    assert motion.at(3.5).p == pytest.approx((0.1, 0.0, 0.0))
    assert motion.at(5.0).v[0] == pytest.approx(-middle.v[0])
    assert angle_between(motion.at(3.5).quat, far) < 1e-9
    assert angle_between(motion.at(6.0).quat, UPRIGHT) < 1e-9


def test_without_a_way_to_go_nothing_moves() -> None:
    motion = RestToRest((0.1, 0.2, 0.3), UPRIGHT, (0.1, 0.2, 0.3), UPRIGHT, 1.0, 0.0, and_back=False)
    assert motion.at(0.5).v == STILL
    assert motion.at(0.5).quat == UPRIGHT


def test_signs_are_made_to_agree() -> None:
    quats = np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [0.8, 0.6, 0, 0], [-0.8, -0.6, 0, 0]])
    assert (same_hemisphere(quats)[:, 0] > 0.0).all()


@pytest.mark.parametrize(
    ("times", "quats", "message"),
    [
        ([0.0, 1.0, 1.0], [UPRIGHT] * 3, "time of pose 3: found 1 s after 1 s"),
        ([0.0, 2.0, 1.0], [UPRIGHT] * 3, "times that increase"),
        ([0.0, 0.9e-4, 1.0], [UPRIGHT] * 3, "found 9e-05 s after 0 s, expected times that increase, by 0.0001 s"),
        ([0.0, 1.0, 2.0], [UPRIGHT, (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)], "3.14 rad apart"),
    ],
)
def test_way_points_that_are_no_motion_are_refused(times: list[float], quats: list[Quat], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        PoseSpline(times, [(0.0, 0.0, 0.0)] * 3, quats)


def test_attitudes_whose_interpolation_would_collapse_are_refused() -> None:
    """Each turn alone is allowed; at these times the spline of the quaternion swings towards zero."""
    x, z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    quats: list[Quat] = [UPRIGHT]
    for axis, angle in ((z, -2.5), (x, 2.5), (x, 2.5), (x, -2.5)):
        quats.append(multiply(from_axis_angle(axis, angle), quats[-1]))
    with pytest.raises(TrajectoryError, match="interpolation shrinks to"):
        PoseSpline([0.0, 2.25, 2.5, 3.5, 5.25], [(0.0, 0.0, 0.0)] * 5, quats)
    PoseSpline([0.0, 1.0, 2.0, 3.0, 4.0], [(0.0, 0.0, 0.0)] * 5, quats)


def csv(rows: list[str], header: str = ",".join(COLUMNS)) -> str:
    return "\n".join([header, *rows]) + "\n"


GOOD = ["0,0.1,0,0,1,0,0,0", "1,0.11,0,0,1,0,0,0", "2,0.12,0,0.01,-0.99995,-0.01,0,0", "3,0.12,0,0,1,0,0,0"]


def test_a_file_of_poses_is_the_spline_through_them() -> None:
    text = csv(["# a comment", "", *GOOD])
    spline = read(text, "way.csv", LIMITS)
    assert spline.period_s == 3.0
    assert spline.at(2.0).p == pytest.approx((0.12, 0.0, 0.01))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "columns of way.csv: found nothing, expected t_s,x_m"),
        (csv(GOOD, "t,x,y,z,qx,qy,qz,qw"), "columns of way.csv: found t,x,y,z"),
        (
            "\ufeff" + csv(GOOD),  # as some spreadsheets write it
            "way.csv: found a byte order mark before the first line, .*save it as UTF-8 without BOM",
        ),
        (csv([*GOOD[:2], "2,0.12,0,0,1,0,0", GOOD[3]]), "line 4 of way.csv: found 7 values, expected 8"),
        (csv([*GOOD[:2], "2,0.12,0,zero,1,0,0,0"]), "line 4 of way.csv: .*could not convert"),
        (csv([*GOOD[:2], "2,0.1_2,0,0,1,0,0,0"]), "line 4 of way.csv: found 2,0.1_2,.* expected numbers"),
        (csv([GOOD[0], "nan,0,0,0,1,0,0,0"]), "line 3 of way.csv: .*finite"),
        (csv(["-1,0.1,0,0,1,0,0,0", *GOOD]), "line 2 of way.csv: .*t_s ≥ 0"),
        (csv([*GOOD, "1.1e6,0.1,0,0,1,0,0,0"]), "line 6 of way.csv: .*at most 1e.06"),
        (csv([GOOD[0], "3,0,-101,0,1,0,0,0"]), "line 3 of way.csv: .*within 100 m"),
        (csv([GOOD[0], "3,0,0,inf,1,0,0,0"]), "line 3 of way.csv: .*finite numbers"),
        (csv([GOOD[0], "3,0,0,0,nan,0,0,0"]), "quaternion in line 3 of way.csv: found norm nan"),
        (csv([GOOD[1], GOOD[0]]), "time in line 3 of way.csv: found 0 s after 1 s, expected times that increase"),
        (csv([GOOD[0], GOOD[0]]), "time in line 3 of way.csv: found 0 s after 0 s"),
        (csv([GOOD[0], "1,0.7,0,0,1,0,0,0"]), "jump in line 3 of way.csv: found 600 mm"),
        (csv([GOOD[0], "0.1,0.1,0,0,0.98,0.198997,0,0"]), "jump in line 3 of way.csv: .*mrad within 0.1 s"),
        (csv([GOOD[0], "1,0.1,0,0,1.1,0,0,0"]), "quaternion in line 3 of way.csv: found norm 1.1"),
        (csv([GOOD[0]]), "rows of way.csv: found 1, expected at least 2"),
        (csv([GOOD[0], "1,0.1,0,0,1,0,0,0", "1.01,0.104,0,0,1,0,0,0", "2,0.104,0,0,1,0,0,0"]), "motion between"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_motion_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(TrajectoryError, match=message) as caught:
        read(text, "way.csv", LIMITS)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, Refusal)


PAPER = (configs.CELLS_DIR / "paper_ideal.toml").read_text(encoding="utf-8")
START = PAPER.index("[trajectory]")
END = PAPER.index("[controller]")
FILE = '[trajectory]\nkind = "file"\npath = "way.csv"\n\n'
WAY = csv(["0,0.301,0.123,0,1,0,0,0", "5,0.32,0.12,0,1,0,0,0", "10,0.3,0.12,0,1,0,0,0"])


def cell_with(tmp_path: Path, trajectory: str, way: str | None = None) -> Path:
    path = tmp_path / "cell.toml"
    path.write_text(PAPER[:START] + trajectory + PAPER[END:], encoding="utf-8")
    if way is not None:
        (tmp_path / "way.csv").write_text(way, encoding="utf-8")
    return path


def test_a_cell_carries_its_trajectory_file_and_its_fingerprint_covers_it(tmp_path: Path) -> None:
    path = cell_with(tmp_path, FILE, WAY)
    cell = load_cell(path)
    (tmp_path / "way.csv").write_text(WAY.replace("0.32", "0.33"), encoding="utf-8")
    other = load_cell(path)
    assert cell.fingerprint != other.fingerprint
    assert other.trajectory().at(5.0).p[0] == pytest.approx(0.33)
    (tmp_path / "way.csv").unlink()
    alone = cell_from_toml(cell.toml, "from a log")  # a replay has the log and nothing else
    assert alone.fingerprint == cell.fingerprint
    assert alone.trajectory().at(5.0) == cell.trajectory().at(5.0)
    path.write_bytes(cell.toml)
    assert load_cell(path).fingerprint == cell.fingerprint
    assert examine(cell).ok


def test_overrides_reach_a_cell_with_a_trajectory_file(tmp_path: Path) -> None:
    cell = load_cell(cell_with(tmp_path, FILE, WAY), ["duration_s=12.0", "trajectory.speed_max_m_per_s=0.4"])
    assert cell.file.duration_s == 12.0
    assert cell.trajectory().period_s == 10.0


@pytest.mark.parametrize(
    ("trajectory", "way", "message"),
    [
        (FILE, None, "trajectory file way.csv: found No such file"),
        (FILE, WAY.replace("5,", "12,", 1), "time in line 4 of way.csv"),
        (FILE + "speed_max_m_per_s = 1e-3\n", WAY, "jump in line 3 of way.csv"),
        ('[trajectory]\nkind = "spiral"\n', None, "'spiral'.*expected"),
        ('[trajectory]\nkind = "waypoints"\npoints = [{ t_s = 0.0, p_m = [0.3, 0.1, 0.0] }]\n', None, "at least 2"),
    ],
)
def test_cells_whose_motion_is_wrong_are_refused_while_loading(
    tmp_path: Path, trajectory: str, way: str | None, message: str
) -> None:
    with pytest.raises((TrajectoryError, ConfigError), match=message) as caught:
        load_cell(cell_with(tmp_path, trajectory, way))
    assert "\n" not in str(caught.value)


def test_a_cell_that_names_a_file_it_does_not_carry_cannot_come_from_a_log(tmp_path: Path) -> None:
    raw = cell_with(tmp_path, FILE, WAY).read_bytes()
    with pytest.raises(TrajectoryError, match="not in the cell's bytes"):
        cell_from_toml(raw, "from a log")


def test_a_way_point_out_of_reach_is_refused_with_arm_and_time(tmp_path: Path) -> None:
    """It is visited for an instant only, between two samples of the check."""
    points = [(0.0, 0.301), (20.0, 0.31), (20.4, 0.9), (20.8, 0.31), (45.0, 0.3)]
    listed = ",".join(f"{{ t_s = {t}, p_m = [{x}, 0.12, 0.0] }}" for t, x in points)
    path = cell_with(tmp_path, f'[trajectory]\nkind = "waypoints"\npoints = [{listed}]\n\n')
    with pytest.raises(ConfigError, match=r"grasp of arm left at t = .*unreachable by"):
        examine(load_cell(path))


def test_a_move_between_long_waits_is_examined(tmp_path: Path) -> None:
    """There and back within a tenth of a second each, between samples that lie two seconds apart."""
    poses = "p_from_m = [0.301, 0.123, 0.0]\np_to_m = [0.33, 0.13, 0.0]\nmove_s = 0.1\nwait_s = {}\nand_back = true\n\n"
    for wait_s in (0.05, 50.0):
        path = cell_with(tmp_path, '[trajectory]\nkind = "rest_to_rest"\n' + poses.format(wait_s))
        cell = load_cell(path, ["duration_s=120.0"])
        assert peak_torque_fraction(cell) == pytest.approx(0.56, abs=0.02), f"whatever the arms wait: {wait_s} s"
        assert not examine(cell).ok


def sampled(cell: Cell, steps: int) -> list[float]:
    """To the nanosecond, so that instants which only rounding tells apart are one."""
    times = sample_times(cell.file, cell.trajectory(), steps)
    assert times == sorted(times)
    return instants(times)


def instants(*times: Iterable[float]) -> list[float]:
    return sorted({round(t, 9) for some in times for t in some})


def even(end_s: float, steps: int) -> Iterable[float]:
    return np.linspace(0.0, end_s, steps + 1)


def move(begin_s: float, length_s: float = 0.1) -> Iterable[float]:
    return np.linspace(begin_s, begin_s + length_s, 25)


REST = (
    '[trajectory]\nkind = "rest_to_rest"\np_from_m = [0.301, 0.123, 0.0]\np_to_m = [0.33, 0.13, 0.0]\n'
    "move_s = 0.1\nwait_s = 50.0\nand_back = true\n\n"
)


def test_a_motion_is_sampled_evenly_and_where_that_would_hide_a_move(tmp_path: Path) -> None:
    """A move is hidden that takes less than eight of the even steps."""
    path = cell_with(tmp_path, REST)
    whole, half = (load_cell(path, [f"duration_s={duration_s}"]) for duration_s in (120.0, 50.05))
    assert sampled(whole, 50) == instants(even(100.2, 50), move(50.0), move(100.1))
    assert sampled(whole, 8_000) == instants(even(100.2, 8_000), move(50.0), move(100.1))
    assert sampled(whole, 8_032) == instants(even(100.2, 8_032))
    assert sampled(half, 50) == instants(even(50.05, 50), (t for t in move(50.0) if t <= 50.05))
    one_way = load_cell(path, ["duration_s=120.0", "trajectory.and_back=false"])
    assert sampled(one_way, 50) == instants(even(50.1, 50), move(50.0))


def test_a_lift_before_a_long_motion_is_a_move_and_those_of_the_motion_come_later_by_it(tmp_path: Path) -> None:
    lifted = load_cell(cell_with(tmp_path, REST), ["duration_s=200.0", "session.lift_s=2.0"])
    assert sampled(lifted, 50) == instants(even(102.2, 50), move(0.0, 2.0), move(52.0), move(102.1))
    assert sampled(lifted, 408) == instants(even(102.2, 408), move(0.0, 2.0), move(52.0), move(102.1))
    assert sampled(lifted, 409) == instants(even(102.2, 409), move(52.0), move(102.1))


def test_of_a_spline_the_quickest_short_segments_are_sampled(tmp_path: Path) -> None:
    """Of those that a run gets to; later than in its file where the object is lifted first."""
    steps = [(20.0, 0.302), (40.0, 0.305), (60.0, 0.309), (80.0, 0.314)]
    points, x = [(0.0, 0.301)], 0.301
    for t, following in steps:
        points += [(t, x), (t + 0.1, following)]
        x = following
    listed = ",".join(f"{{ t_s = {t}, p_m = [{x}, 0.12, 0.0] }}" for t, x in [*points, (100.0, x)])
    path = cell_with(tmp_path, f'[trajectory]\nkind = "waypoints"\npoints = [{listed}]\n\n')

    def cell(*overrides: str) -> Cell:
        return load_cell(path, list(overrides))

    quickest = [move(t) for t in (40.0, 60.0, 80.0)]
    assert sampled(cell("duration_s=100.0"), 50) == instants(even(100.0, 50), *quickest)
    assert sampled(cell("duration_s=100.0"), 990) == instants(even(100.0, 990), *quickest)
    assert sampled(cell("duration_s=100.0"), 1_010) == instants(even(100.0, 1_010))
    assert sampled(cell("duration_s=70.0"), 50) == instants(even(70.0, 50), *(move(t) for t in (20.0, 40.0, 60.0)))
    lifted = sampled(cell("duration_s=81.5", "session.lift_s=2.0"), 50)
    assert lifted == instants(even(81.5, 50), move(0.0, 2.0), *(move(t) for t in (22.0, 42.0, 62.0)))


def test_a_spline_knows_its_quickest_segments_in_translation_and_in_rotation() -> None:
    def about_z(angle: float) -> Quat:
        return from_axis_angle((0.0, 0.0, 1.0), angle)

    places = [(0.0, 0.0, x) for x in (0.0, 0.1, 0.3, 0.3, 0.3, 0.9)]
    spline = PoseSpline([0.0, 1.0, 2.0, 3.0, 4.0, 9.0], places, [about_z(a) for a in (0.0, 0.1, 0.1, 0.1, 0.4, 0.4)])
    assert spline.quickest(1, 9.0, 2.0) == [(1.0, 1.0), (3.0, 1.0)]
    assert spline.quickest(2, 9.0, 2.0) == [(0.0, 1.0), (1.0, 1.0), (3.0, 1.0)]
    assert spline.quickest(1, 9.0, 5.1) == [(1.0, 1.0), (3.0, 1.0)], "0.12 m/s of the last one are less than 0.2"
    assert spline.quickest(2, 9.0, 5.1) == [(0.0, 1.0), (1.0, 1.0), (3.0, 1.0), (4.0, 5.0)]
    assert spline.quickest(1, 1.0, 2.0) == [(0.0, 1.0)]
    assert spline.quickest(3, 9.0, 1.0) == []


def test_a_motion_that_is_eased_in_for_long_is_examined_at_its_full_speed(tmp_path: Path) -> None:
    motion = (
        '[trajectory]\nkind = "sinusoid"\np_centre_m = [0.301, 0.123, 0.0]\np_amplitude_m = [0.0, 0.005, 0.0]\n'
        "axis = [0.0, 0.0, 1.0]\nangle_rad = 0.0\nperiod_s = 0.5\nramp_s = {}\n\n"
    )
    at_once, late = (
        peak_torque_fraction(load_cell(cell_with(tmp_path, motion.format(ramp_s)), ["duration_s=100.0"]))
        for ramp_s in (0.0, 40.0)
    )
    assert late == pytest.approx(at_once, rel=0.02)


def peak_torque_fraction(cell: Cell) -> float:
    """Largest torque that the check finds along the trajectory, of stall."""
    found = [f.found for f in examine(cell).findings if f.what.startswith("torque along")]
    return max(float(text.split()[2].rstrip("%")) for text in found) / 100.0


def test_a_row_out_of_reach_is_refused_with_arm_and_time(tmp_path: Path) -> None:
    """A file's rows are visited for an instant only, too."""
    rows = [f"{0.2 * k},{0.6 if k == 108 else 0.301},0.12,0,1,0,0,0" for k in range(226)]
    quick = FILE.replace("\n\n", "\nspeed_max_m_per_s = 2.0\n\n")
    with pytest.raises(ConfigError, match=r"grasp of arm left at t = 21\.(49|60) s.*unreachable by"):
        examine(load_cell(cell_with(tmp_path, quick, csv(rows))))
    examined = check._instants(load_cell(tmp_path / "cell.toml")).times
    assert {round(0.2 * k, 9) for k in range(226)} <= {round(t, 9) for t in examined}


def test_of_many_way_points_some_are_examined_evenly_and_the_check_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{0.01 * k},0.301,0.123,0,1,0,0,0" for k in range(351)]
    cell = load_cell(cell_with(tmp_path, FILE, csv(rows)))
    times, count = waypoint_times(cell.file, 100.0, 300)
    assert (len(times), count) == (300, 351)
    assert (times[0], times[-1]) == (0.0, 3.5)
    assert np.diff(times).max() < 0.021
    assert waypoint_times(cell.file, 0.025, 300) == ([0.0, 0.01, 0.02], 3)
    monkeypatch.setattr(check, "NAMED_MAX", 600)  # of 6000, which take two seconds
    thinned = next(f for f in examine(cell).findings if f.what == "instants examined")
    assert (thinned.found, thinned.verdict) == ("300 of 351", Verdict.WARNING)


def test_rest_to_rest_cell_is_examined_to_its_end(tmp_path: Path) -> None:
    poses = "p_from_m = [0.301, 0.123, 0.0]\np_to_m = [0.33, 0.13, 0.0]\nmove_s = 4.0\n\n"
    cell = load_cell(cell_with(tmp_path, '[trajectory]\nkind = "rest_to_rest"\n' + poses))
    assert cell.trajectory().at(4.0).p == pytest.approx((0.33, 0.13, 0.0))
    assert examine(cell).ok
