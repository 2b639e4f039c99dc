"""What a run of a study counts as: figures from the transient's end to the first trip, against bounds of a cell."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.config.cell import Cell, load_cell
from agent.config.schema.fault import Fault, FaultKind
from agent.control.trajectory import Trajectory
from agent.safety import Flag
from agent.study import measure as module
from agent.study.lab import Trip
from agent.study.measure import RunResult, bounds_of, measure, run_once
from agent.study.plan import last_seen_s
from sim_backend.physics.spec import PlantError

STALL_NM = np.array([2.0, 2.0, 4.0, 4.0])
TRIP = Trip(3.0, "left", Flag.UNEXPECTED, "a blow")
GRASP = np.zeros((2, 6))
GRASP[0, :3], GRASP[1, :3] = (0.24, 0.0, 0.32), (-0.24, 0.0, -0.32)  # N, against each other


CHANGES = (
    "duration_s=8.0", "rate_hz=100.0", "trajectory.angle_rad=0.0",
    "report.transient_s=1.0", "simulation.observe_rate_hz=10.0", "simulation.ready_s=0.5",
)  # fmt: skip
UNLIKE = ("arms.left.load_share=0.1", "arms.right.load_share=0.9")


@cache
def cell() -> Cell:
    return load_cell(Path("paper"), CHANGES)


@cache
def motion() -> Trajectory:
    """Its trajectory, of which scripted runs ask eight thousand times."""
    return cell().trajectory()


Seen = tuple[float, float, float, float]  # errors of the object and of what the anchor sees of it: m, rad, m, rad


class Scripted:
    """A run in which the object is off as the test says, and arms trip when it says."""

    def __init__(self, off: Callable[[float], Seen], trips: Sequence[Trip], ends_s: float, skew_s: float) -> None:
        self.ready_ticks, self.tick = 50, 0
        self._off, self._trips, self._ends_s = off, trips, ends_s
        self.peak_Nm, self.observed = np.array([0.2, 0.2, 0.2, 1.6]), list[float]()
        anchor = SimpleNamespace(skew_s=skew_s)
        self.plant = SimpleNamespace(spec=SimpleNamespace(arms=[anchor, anchor]))
        self.places = [SimpleNamespace(sees=lambda: None), SimpleNamespace(sees=lambda: None)]
        self._skew_s = skew_s
        self.faults: Sequence[Fault] = ()
        self.blind = False  # whether the anchor sees nothing
        self.wrench = GRASP

    @property
    def t(self) -> float:
        return (self.tick - self.ready_ticks) * 0.01

    @property
    def trips(self) -> list[Trip]:
        return [trip for trip in self._trips if trip.t <= self.t]

    def observe(self) -> Any:
        self.observed.append(self.t)
        desired = motion().at(max(self.t + self._skew_s, 0.0))
        off_m, off_rad, own_m, own_rad = self._off(self.t)
        p = np.array(desired.p) + np.array([off_m, 0.0, 0.0])
        quat = about_z(off_rad)
        own = p + np.array([0.0, own_m, 0.0])
        seen = None if self.blind else (tuple(own), tuple(about_z(off_rad - own_rad)))
        self.places[cell().anchor].sees = lambda: seen
        return SimpleNamespace(p_object=p, quat_object=quat, grasp_wrench=self.wrench)

    def advance(self) -> None:
        if self.t >= self._ends_s:
            raise PlantError("the plant", found="nan", expected="numbers", remedy="none")
        self.tick += 1


def force_N(monkeypatch: pytest.MonkeyPatch, wrench: np.ndarray, *changes: str) -> float:
    """The internal force of a run of the cell with these changes, in which its grasps carry this all along."""
    run = Scripted(lambda _: (0.0,) * 4, (), math.inf, 0.0)
    run.wrench = wrench
    monkeypatch.setattr(module, "Run", lambda *_: run)
    shared: Any = SimpleNamespace(cell=load_cell(Path("paper"), [*CHANGES, *changes]), stall_Nm=STALL_NM)
    found = measure(shared, None)
    assert found.internal_force_mean_N == pytest.approx(found.internal_force_max_N)
    return found.internal_force_max_N


def off_at(errors_m: Mapping[float, float], usual_m: float) -> Callable[[float], Seen]:
    """An object that is so far off at some instants."""
    return lambda t: (dict(errors_m).get(round(t, 6), usual_m), 0.0, 0.0, 0.0)


def about_z(angle: float) -> np.ndarray:
    """The desired attitude of the cell, turned further."""
    w, x, y, z = motion().at(0.0).quat
    assert (x, y) == (0.0, 0.0)
    half = 0.5 * angle + math.atan2(z, w)
    return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])


def result(
    monkeypatch: pytest.MonkeyPatch,
    off: Callable[[float], Seen] = lambda _: (1e-3, 2e-3, 0.4e-3, 0.5e-3),
    *,
    trips: Sequence[Trip] = (),
    faults: Sequence[Fault] = (),
    ends_s: float = math.inf,
    skew_s: float = 0.0,
) -> tuple[RunResult, Scripted]:
    run = Scripted(off, trips, ends_s, skew_s)

    def begun(_lab: object, _reality: object, given: Sequence[Fault]) -> Scripted:
        run.faults = given
        return run

    monkeypatch.setattr(module, "Run", begun)
    lab: Any = SimpleNamespace(cell=cell(), stall_Nm=STALL_NM)
    return measure(lab, None, 4, 9, faults), run


def test_bounds_are_those_of_planar_and_spatial_cells() -> None:
    planar, spatial = (bounds_of(load_cell(Path(name))) for name in ("two_wx200", "three_wx250s"))
    assert planar == {
        "position_beyond_anchor_m": 1e-3, "attitude_beyond_anchor_rad": 6e-3, "internal_force_mean_N": 1.0,
        "peak_torque_fraction": 0.5,
    }  # fmt: skip
    assert spatial == planar | {"internal_force_mean_N": 4.0}


def test_figures_are_the_largest_and_beyond_what_the_anchor_sees_wrongly(monkeypatch: pytest.MonkeyPatch) -> None:
    found, run = result(monkeypatch)
    assert (found.index, found.seed, found.lost, found.tripped, found.within_bounds) == (4, 9, False, False, True)
    assert found.tracked_s == pytest.approx(8.0)
    assert found.position_error_m == pytest.approx(1e-3)
    assert found.attitude_error_rad == pytest.approx(2e-3, rel=1e-3)
    assert found.position_beyond_anchor_m == pytest.approx(0.6e-3)
    assert found.attitude_beyond_anchor_rad == pytest.approx(1.5e-3, rel=1e-3)
    assert found.internal_force_max_N == pytest.approx(0.4)
    assert found.internal_force_mean_N == pytest.approx(0.4)
    assert found.peak_torque_fraction == pytest.approx(0.4)
    assert (found.reaction_s, found.tripped_by, found.why) == (None, "", "")
    assert found.first_fault_s is None
    np.testing.assert_allclose(np.diff(run.observed), 0.1)
    assert (run.observed[0], run.tick) == (-0.5, 850)
    assert run.observed[-1] == pytest.approx(last_seen_s(cell().file)), "as a plan looks for it"


@pytest.mark.parametrize(
    ("off", "kept"),
    [
        ((1.99e-3, 0.0, 1e-3, 0.0), True), ((2.01e-3, 0.0, 1e-3, 0.0), False),
        ((0.0, 7.9e-3, 0.0, 2e-3), True), ((0.0, 8.1e-3, 0.0, 2e-3), False),
    ],
)  # fmt: skip
def test_a_run_is_within_bounds_when_every_figure_is(monkeypatch: pytest.MonkeyPatch, off: Seen, kept: bool) -> None:
    assert result(monkeypatch, lambda _: off)[0].within_bounds is kept


@pytest.mark.parametrize(("peak_Nm", "kept"), [(2.0, True), (2.01, False)])
def test_half_of_stall_is_within_bounds(monkeypatch: pytest.MonkeyPatch, peak_Nm: float, kept: bool) -> None:
    run = Scripted(lambda _: (0.0,) * 4, (), math.inf, 0.0)
    run.peak_Nm[3] = peak_Nm
    monkeypatch.setattr(module, "Run", lambda *_: run)
    lab: Any = SimpleNamespace(cell=cell(), stall_Nm=STALL_NM)
    assert measure(lab, None).within_bounds is kept
    assert (measure(lab, None).index, measure(lab, None).seed) == (0, 0)
    again = run_once(lab, 3, 11)
    assert (again.index, again.seed) == (3, 11)


def test_an_anchor_that_sees_nothing_excuses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Scripted(lambda _: (0.8e-3, 2e-3, 0.4e-3, 1e-3), (), math.inf, 0.0)
    run.blind = True
    monkeypatch.setattr(module, "Run", lambda *_: run)
    lab: Any = SimpleNamespace(cell=cell(), stall_Nm=STALL_NM)
    assert measure(lab, None).position_beyond_anchor_m == pytest.approx(0.8e-3)


def test_a_run_of_which_nothing_was_seen_is_lost_and_has_no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = result(monkeypatch, ends_s=-0.5)
    assert (found.lost, found.tracked_s, found.position_error_m) == (True, 0.0, 0.1)
    assert (found.attitude_error_rad, found.position_beyond_anchor_m, found.attitude_beyond_anchor_rad) == (
        1.0,
        0.1,
        1.0,
    )
    assert (found.internal_force_max_N, found.internal_force_mean_N) == (0.0, 0.0)


def test_what_the_load_shares_mean_is_no_internal_force_and_what_is_beside_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wrench = np.zeros((2, 6))
    wrench[0, :2], wrench[1, :2] = (0.5, -0.3), (4.5, -2.7)  # 5.8 N of load, a tenth and the rest
    assert force_N(monkeypatch, wrench, *UNLIKE) == pytest.approx(0.0, abs=1e-12)
    wrench[0, 0], wrench[1, 0] = 0.5 + 0.7, 4.5 - 0.7
    assert force_N(monkeypatch, wrench, *UNLIKE) == pytest.approx(0.7)
    x, y, _ = load_cell(Path("paper"), CHANGES).T_world_object_start.rotation.T @ [0.7, 0.0, 0.0]
    squeezed = (
        f"arms.left.internal_wrench_N_Nm=[{x}, {y}, 0.0, 0.0, 0.0, 0.0]",
        f"arms.right.internal_wrench_N_Nm=[{-x}, {-y}, 0.0, 0.0, 0.0, 0.0]",
    )
    assert force_N(monkeypatch, wrench, *UNLIKE, *squeezed) == pytest.approx(0.0, abs=1e-9), "asked for, too"


def test_out_of_their_plane_arms_share_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    wrench = np.zeros((2, 6))
    wrench[:, 2] = 2.0
    assert force_N(monkeypatch, wrench, *UNLIKE) == pytest.approx(0.0, abs=1e-12)
    wrench[:, 2] = 0.4, 3.6
    assert force_N(monkeypatch, wrench, *UNLIKE) == pytest.approx(1.6)


def test_with_equal_shares_the_internal_force_is_the_paper_s_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    wrench = np.random.default_rng(5).normal(size=(2, 6))
    own = wrench[:, :3] - wrench[:, :3].mean(axis=0, keepdims=True)
    assert force_N(monkeypatch, wrench) == float(np.linalg.norm(own, axis=1).max())


def test_the_instants_at_which_the_transient_ends_and_an_arm_trips_count(monkeypatch: pytest.MonkeyPatch) -> None:
    for at, size in ((1.0, 0.7e-3), (3.0, 0.8e-3)):
        found, _ = result(monkeypatch, off_at({at: size}, 1e-4), trips=[TRIP])
        assert found.position_error_m == pytest.approx(size)


def test_what_comes_before_the_transient_ends_or_behind_a_trip_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(t: float) -> Seen:
        return (0.05 if t < 0.95 or t > 3.05 else 0.2e-3, 0.0, 0.0, 0.0)

    found, run = result(monkeypatch, off, trips=[TRIP])
    assert found.position_error_m == pytest.approx(0.2e-3)
    assert (found.tripped, found.within_bounds, found.tripped_by) == (True, False, "UNEXPECTED")
    assert found.why == "t = 3.000 s: arm left UNEXPECTED a blow"
    assert (found.tracked_s, found.tripped_s, found.lost_s, found.settled) == (3.0, 3.0, None, True)
    assert run.t == pytest.approx(6.01), "it goes on for three seconds"


def test_a_run_that_trips_within_the_transient_counts_from_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    early = Trip(0.55, "left", Flag.UNEXPECTED)
    for at in (0.0, 0.9):
        found, _ = result(monkeypatch, off_at({-0.1: 0.02, at: 5e-3}, 1e-3), trips=[early])
        assert found.position_error_m == pytest.approx(5e-3)
        assert (found.settled, found.within_bounds) == (False, False)
    before = Trip(-0.2, "left", Flag.UNEXPECTED)
    found, _ = result(monkeypatch, trips=[before])
    assert (found.tracked_s, found.tripped_s) == (0.0, -0.2)


@pytest.mark.parametrize(
    ("off", "lost"),
    [((0.0999, 0.0), False), ((0.1001, 0.0), True), ((0.0, 0.999), False), ((0.0, 1.001), True)],
)
def test_an_object_a_tenth_of_a_metre_or_a_radian_off_is_lost(
    monkeypatch: pytest.MonkeyPatch, off: tuple[float, float], lost: bool
) -> None:
    found, run = result(monkeypatch, lambda t: (*(off if t > 2.0 else (0.0, 0.0)), 0.0, 0.0))
    assert found.lost is lost
    assert found.within_bounds is False
    assert ("the object is off by" in found.why) is lost
    assert run.t == pytest.approx(2.11 if lost else 8.0)
    assert found.lost_s == (pytest.approx(2.1) if lost else None)


def test_figures_count_on_after_a_fault_and_all_arms_follow_until_then(monkeypatch: pytest.MonkeyPatch) -> None:
    limp = [Fault(kind=FaultKind.LIMP, arm="left", at_s=at) for at in (4.0, 2.5)]
    found, _ = result(monkeypatch, off_at({5.0: 0.05}, 1e-4), faults=limp)
    assert (found.position_error_m, found.tracked_s, found.first_fault_s) == (pytest.approx(0.05), 2.5, 2.5)
    found, _ = result(monkeypatch, faults=limp, trips=[Trip(2.0, "right", Flag.UNEXPECTED)])
    assert (found.tracked_s, found.first_fault_s) == (2.0, 2.5)


def test_a_fault_with_the_first_cycle_of_the_motion_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    limp, trips = [Fault(kind=FaultKind.LIMP, arm="left", at_s=0.0)], [Trip(1.2, "right", Flag.UNEXPECTED)]
    found, _ = result(monkeypatch, off_at({}, 1e-4), faults=limp, trips=trips)
    assert (found.first_fault_s, found.tracked_s, found.reaction_s, found.within_bounds) == (0.0, 0.0, 1.2, True)


def test_a_run_whose_arms_trip_for_a_fault_is_within_bounds_and_one_that_trips_before_it_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for at_s, within in ((2.9, True), (3.0, True), (3.1, False)):
        faults = [Fault(kind=FaultKind.LIMP, arm="left", at_s=at) for at in (4.0, at_s)]
        found, _ = result(monkeypatch, off_at({}, 1e-4), faults=faults, trips=[TRIP])
        assert (found.tripped, found.within_bounds) == (True, within)


def test_a_run_that_trips_and_is_lost_later_says_when_for_both(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = result(monkeypatch, lambda t: (0.2 if t > 4.0 else 0.0, 0.0, 0.0, 0.0), trips=[TRIP])
    assert (found.tracked_s, found.tripped_s, found.lost_s) == (3.0, 3.0, pytest.approx(4.1))


def test_a_plant_that_fails_is_a_lost_run_however_near_its_object_was(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = result(monkeypatch, ends_s=4.0)
    assert (found.lost, found.within_bounds, found.why) == (True, False, "t = 4.000 s: the plant")
    assert (found.position_error_m, found.lost_s) == (0.1, pytest.approx(4.0))
    assert found.attitude_error_rad == 1.0
    assert (found.position_beyond_anchor_m, found.attitude_beyond_anchor_rad) == (0.1, 1.0)
    assert found.internal_force_mean_N == pytest.approx(0.4)


def test_the_motion_is_timed_by_the_anchors_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    assert result(monkeypatch, skew_s=0.3)[0].position_error_m == pytest.approx(1e-3)


def test_the_anchors_clock_counts_whole_nanoseconds_as_the_arm_does(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    moving = motion()
    watched = SimpleNamespace(at=lambda t: (asked.append(t), moving.at(t))[1])
    monkeypatch.setattr(type(cell()), "trajectory", lambda _: watched)
    result(monkeypatch, skew_s=0.002047282543643362)
    asked = [t for t in asked if t]
    stamps_ns = [round(t * 1e9) for t in asked]
    assert asked == [stamp * 1e-9 for stamp in stamps_ns], "the product that is an arm's time `t`"
    assert {stamp % 1_000_000 for stamp in stamps_ns} == {47_283}


def test_a_reaction_is_that_of_an_arm_that_nothing_befell_and_not_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    trips = [Trip(1.0, "right", Flag.UNEXPECTED), Trip(2.1, "left", Flag.UNEXPECTED), Trip(2.3, "right", Flag.NONE)]
    late, first = (Fault(kind=FaultKind.LIMP, arm="left", at_s=at) for at in (2.5, 2.0))
    found, _ = result(monkeypatch, trips=trips, faults=[late, first])
    assert found.reaction_s == pytest.approx(0.3)
    assert result(monkeypatch, trips=trips[:2], faults=[first])[0].reaction_s is None
    assert result(monkeypatch, trips=trips)[0].reaction_s is None
    at_once = Fault(kind=FaultKind.LIMP, arm="left", at_s=2.3)
    assert result(monkeypatch, trips=trips, faults=[at_once])[0].reaction_s == 0.0
