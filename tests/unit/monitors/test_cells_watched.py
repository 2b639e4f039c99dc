"""Monitors in a closed loop with the plant: what is wrong holds the arms, what the cell tolerates does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.monitors import bounds
from agent.config.reality import draw
from agent.config.schema.reality import ArmReality, Reality
from agent.modes import Mode
from agent.monitors.bounds import Name
from drivers.interface import Vector
from tests.support.arm_files import pressed_on, with_figures
from tests.support.control.level_wx200 import LEVEL, STIFF
from tests.support.watched import only, watched, without

UNNOTICED = ("safety.noticing.enabled=false", "safety.tracking_error_max_m=1.0", "safety.tracking_error_max_rad=1.5")
LONG = pytest.mark.long
AT_ONCE = "simulation.ready_s=0.0"


def load(name: str, *overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", overrides)


@pytest.mark.parametrize(("name", "seed"), [("two_wx200", 7), pytest.param("three_wx250s", 8, marks=LONG)])
def test_a_cell_within_its_tolerance_trips_no_monitor(name: str, seed: int) -> None:
    cell = load(name, "simulation.ready_s=2.0")
    seen = watched(cell, 1.5, reality=draw(cell.tolerance, seed, cell))
    assert seen.first == {}
    assert all(place.mode is Mode.TRACK for place in seen.places)


def test_arms_that_learn_at_rest_and_share_the_weight_as_it_happens_trip_nothing() -> None:
    cell = load("paper_adaptive", "simulation.ready_s=1.6")
    assert watched(cell, 0.0, reality=draw(cell.tolerance, 1617223562, cell)).first == {}


def test_arms_whose_friction_grows_with_the_load_trip_nothing_at_rest(tmp_path: Path) -> None:
    cell = with_figures(load("paper_real", "simulation.ready_s=1.2"), tmp_path, pressed_on)
    assert watched(cell, 0.0, reality=draw(cell.tolerance, 2083679832, cell)).first == {}
    stuck = bounds(cell, cell.arms[0]).frozen_Nm  # such a joint moves at no less than three times what may hold it
    assert all(most > 3.0 * 1.39 * s.coulomb_Nm.value for most, s in zip(stuck, cell.arms[0].servos, strict=True))


@pytest.mark.parametrize("factor", [1.3, pytest.param(0.7, marks=LONG)])
@pytest.mark.fault("S8")
def test_s8_torque_constants_and_friction_off_by_a_third_are_no_trip(factor: float) -> None:
    cell = load("two_wx200", "simulation.ready_s=2.0")
    wrong = ArmReality(friction=factor, torque_constant=(factor,) * 3)
    seen = watched(cell, 2.0, reality=Reality(arms={"left": wrong}))
    assert seen.first == {}
    assert all(place.mode is Mode.TRACK for place in seen.places)


@pytest.mark.parametrize(
    ("name", "pose", "gravity", "all_by_s"),
    [
        # the right arm moves 3 mrad too far for one window to count, and then the left one holds and moves it
        ("two_wx200", (), "[0.0, 0.0, 9.81]", -1.0),
        pytest.param("two_wx200", LEVEL, "[0.0, 0.0, 9.81]", -2.0, marks=LONG),
        pytest.param("two_wx200", (), "[9.81, 0.0, 0.0]", -2.0, marks=LONG),
        pytest.param("paper_adaptive", (), "[0.0, 9.81, 0.0]", -2.0, marks=LONG),
    ],
    ids=["up", "up, level", "sideways", "up, learning"],
)
@pytest.mark.fault("G6")
def test_g6_a_wrong_gravity_is_refused_before_the_start(
    name: str, pose: tuple[str, ...], gravity: str, all_by_s: float
) -> None:
    wrong = load(name, *pose, f"world.gravity_m_per_s2={gravity}")
    seen = watched(load(name, *pose), 0.1, believed=wrong)
    assert seen.names == {Name.GRAVITY}
    assert min(t for t, _ in seen.first.values()) < -2.0, "the first that finds it"
    assert max(t for t, _ in seen.first.values()) < all_by_s
    assert seen.places[0].mode is Mode.HOLD, "no start out of a hold"


@pytest.mark.fault("G6")
def test_g6_another_arm_than_the_files_is_refused_before_the_start() -> None:
    heavy = Reality(arms={name: ArmReality(masses=2.0) for name in ("left", "right")})
    seen = watched(load("two_wx200", "simulation.ready_s=2.0"), 0.1, reality=heavy)
    assert seen.names == {Name.GRAVITY}


@pytest.mark.fault("G6")
def test_g6_a_missing_object_is_refused_where_the_arms_are_known_well_enough() -> None:
    known = ("tolerance.masses=0.02", "tolerance.torque_constant=0.02", "tolerance.friction=[0.9, 1.1]")
    light = load("three_wx250s", "object.mass_kg=1.2", "simulation.ready_s=1.6", *known)
    gone = Reality(object=0.05)
    assert watched(light, 0.0, reality=gone).names == {Name.GRAVITY}
    assert watched(light, 0.0).first == {}
    assert watched(light, 0.0, reality=gone, changed=without(Name.GRAVITY)).first == {}


def test_an_arm_that_sees_the_object_far_from_its_start_holds_before_it_and_one_that_is_near_does_not() -> None:
    cell = load("two_wx200", "simulation.ready_s=0.5")
    off = {beside_m: Reality(arms={"right": ArmReality(base_m=(beside_m, 0.0, 0.0))}) for beside_m in (0.018, 0.03)}
    assert watched(cell, 0.2, reality=off[0.018]).first == {}
    seen = watched(cell, 0.2, reality=off[0.03])
    t, said = seen.first["right"]
    assert t < -0.45
    assert said.startswith("monitor start: start of the object: found 30.1 mm and 1 mrad from where the cell states it")
    assert (seen.places[1].mode, set(seen.first)) == (Mode.HOLD, {"right"}), "no start out of a hold"


def test_a_start_from_beside_its_place_that_is_let_through_moves_without_a_jolt() -> None:
    """Errors that grow along the way reach beyond the dead zone: the shift was cut by a third in one tick then."""
    cell = load("two_models", "simulation.ready_s=0.5", "controller.alignment.dead_zone_m=0.0002")
    beside = Reality(arms={"right": ArmReality(base_m=(-0.03, 0.0, 0.0), base_rad=(0.0, 0.02, 0.0))})
    steps: list[float] = []
    seen = watched(cell, 2.0, reality=beside, changed=without(Name.START), see=lambda _, dq: steps.append(max(abs(dq))))
    assert (seen.first, [place.mode for place in seen.places]) == ({}, [Mode.TRACK, Mode.TRACK])
    assert max(steps) < 0.5


@pytest.mark.parametrize(
    ("name", "pose", "wild_rad_per_s"),
    [("two_wx200", (*LEVEL, *STIFF), 0.15), pytest.param("three_wx250s", (), 0.156, marks=LONG)],
    ids=["two_wx200, level", "three_wx250s"],
)
@pytest.mark.fault("M5")
def test_m5_gains_ten_times_too_high_are_noticed_within_20_ms(
    name: str, pose: tuple[str, ...], wild_rad_per_s: float
) -> None:
    """From the tick on which a joint is clearly faster than the motion asks of any."""
    gains = load(name, *pose).file
    c = gains.controller
    keys = {
        "controller.k_p_per_s": c.k_p_per_s, "controller.k_eps_rad_per_s": c.k_eps_rad_per_s,
        "controller.k_p_rate_per_s": c.k_p_rate_per_s, "controller.k_eps_rate_rad_per_s": c.k_eps_rate_rad_per_s,
    }  # fmt: skip
    for arm in gains.arms:
        keys[f"arms.{arm.name}.k_v_N_s_per_m"] = arm.k_v_N_s_per_m
        keys[f"arms.{arm.name}.k_v_Nm_s_per_rad"] = arm.k_v_Nm_s_per_rad
    tenfold = [f"{key}={10.0 * value[0]}" for key, value in keys.items() if value is not None]
    wild, cell = load(name, *pose, AT_ONCE, *UNNOTICED, *tenfold), load(name, *pose, AT_ONCE)
    began: list[float] = []

    def fast(t: float, dq: Vector) -> None:
        if not began and np.abs(dq).max() > wild_rad_per_s:
            began.append(t)

    seen = watched(cell, 1.0, believed=wild, until_trip=True, see=fast)
    t, said = min(seen.first.values())
    assert round(t - began[0], 6) <= 0.02
    assert said.startswith(("monitor speed", "monitor power"))
    blind = watched(cell, t + 0.1, believed=wild, changed=without(Name.SPEED, Name.POWER, Name.RATE_LIMITED))
    assert min((t for t, _ in blind.first.values()), default=1.0) > t


@pytest.mark.fault("S5")
def test_s5_a_dead_encoder_is_found_and_a_living_one_is_not_suspected() -> None:
    quick = load("two_wx200", AT_ONCE, "trajectory.period_s=3.0", "trajectory.ramp_s=0.2", *UNNOTICED)
    kept: list[float] = []

    def dead(t: float, q: Vector) -> Vector:
        if t < 0.5:
            return q
        kept.extend(q[:1].tolist() if not kept else [])
        return np.array([kept[0], *q[1:]])

    seen = watched(quick, 1.0, lies={"left": dead}, changed=only(Name.FROZEN))
    # later the right one, which nothing told to hold, is held fast by the left
    t, said = seen.first["left"]
    assert said.startswith("monitor frozen: reading of shoulder")
    assert 0.5 + 0.05 <= t <= 0.5 + 0.15
    assert set(seen.first) == {"left"}
