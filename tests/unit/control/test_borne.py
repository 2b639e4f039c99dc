"""What hangs on an arm with what its friction feed-forward bears: its sign and size, who has it, what it is for."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.noticing import bearing, loads_N
from agent.config.schema.driver import DriverKind
from agent.config.schema.fault import Fault, FaultKind
from agent.control.borne import BORNE, LOAD_AT, NOT_BORNE, STUCK_AT, Bearing, Borne, borne_of
from agent.control.brace import Braced
from agent.control.cause import Cause
from agent.control.friction import Friction, JointFriction
from agent.control.memory import initial, restore
from agent.faults.plan import Injection
from agent.faults.rehearse import rehearse
from agent.modes import Mode
from agent.process.describe import run_info
from agent.safety import Flag
from agent.study.lab import Laboratory, Run
from agent.telemetry.row.fill import SETTLED
from agent.verify.noticing import noticed
from tests.support.arm_files import pressed_on, with_figures

PERIOD = 5e-3
FRICTION = Friction((JointFriction(0.2, 0.1), JointFriction(0.4, 0.0)), 0.05)
LAW = Bearing(PERIOD, limit_N=1.5, stuck_limit_N=2.5, friction=FRICTION, down=(0.0, 0.0, -1.0))
J_INV_P = np.array([[0.0, 0.0, 2.0, 0.0, 0.0, 0.0], [1.0, 0.5, 3.0, 0.0, 0.0, 0.0]])
STILL = np.zeros(2)


def of(speeds: tuple[float, float]) -> np.ndarray:
    return np.array(FRICTION.gliding(speeds))


def test_a_load_that_turns_the_feed_forward_round_is_twice_the_friction_of_joints_that_go_down() -> None:
    """Joints that sink at 1 rad/s are pushed up as if they rose: 2 J⁻ᵀ of friction beside the force that is felt."""
    up, sinks = of((1.0, 1.0)), np.array([-1.0, -1.0])
    hidden = 2.0 * (2.0 * (0.2 + 0.1) + 3.0 * 0.4)
    found = LAW.advance(NOT_BORNE, 0.25, J_INV_P, up, sinks, ready=False)
    assert found.load_N == pytest.approx(15.0 * PERIOD * (hidden + 0.25), rel=1e-6)
    assert found.usual_N == pytest.approx(0.5 * PERIOD * hidden, rel=1e-6)
    assert (found.usual_stuck_N, found.stuck_N) == pytest.approx((found.usual_N, found.load_N))
    assert LAW.advance(NOT_BORNE, 0.0, J_INV_P, -up, -sinks, ready=False).load_N == pytest.approx(
        -found.load_N, rel=0.1
    )


def test_a_feed_forward_that_is_spent_on_the_friction_that_there_is_bears_nothing() -> None:
    speeds = np.array([0.03, -0.7])
    found = LAW.advance(NOT_BORNE, 0.0, J_INV_P, of((0.03, -0.7)), speeds, ready=False)
    assert found == pytest.approx((0.0,) * 4, abs=1e-15)


def test_so_does_one_of_an_arm_that_has_learned_how_much_there_is() -> None:
    speeds = np.array([0.03, -0.7])
    fed = np.array(LAW.friction.gliding(speeds.tolist(), 1.4))
    assert LAW.advance(NOT_BORNE, 0.0, J_INV_P, fed, speeds, 1.4, ready=False) == pytest.approx((0.0,) * 4, abs=1e-15)


def test_only_what_is_beside_the_usual_counts_and_before_the_start_nothing_but_the_usual() -> None:
    bears, sinks = of((1.0, 0.0)), np.array([-1.0, 0.0])  # 0.3 N·m of the first joint twice: 1.2 N
    usual = LAW.advance(Borne(1.2, 0.0, 1.2), 0.0, J_INV_P, bears, sinks, ready=False)
    assert usual == pytest.approx((1.2, 0.0, 1.2, 0.0))
    waiting = LAW.advance(Borne(0.8, 0.9, 0.7, 0.6), 5.0, J_INV_P, bears, sinks, ready=True)
    assert waiting == pytest.approx((0.8 + 0.5 * PERIOD * 0.4, 0.0, 0.7 + 0.5 * PERIOD * 0.5, 0.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_a_joint_that_sticks_bears_counts_apart_and_of_a_slow_one_no_more_than_it_rubs(sign: float) -> None:
    fed = sign * of((1.0, 1.0))
    still = LAW.advance(NOT_BORNE, 0.0, J_INV_P, fed, STILL, ready=False)
    fed_N = sign * (2.0 * 0.3 + 3.0 * 0.4)
    assert still == pytest.approx((0.0, 0.0, 0.5 * PERIOD * fed_N, 15.0 * PERIOD * fed_N), abs=1e-15)
    slowly, rubs = sign * np.array([0.01, 0.02]), of((0.01, 0.02))
    rubbed_N = sign * (2.0 * rubs[0] + 3.0 * rubs[1])
    on = LAW.advance(NOT_BORNE, 0.0, J_INV_P, fed, slowly, ready=False)
    assert (on.load_N, on.stuck_N) == pytest.approx((0.0, 15.0 * PERIOD * (fed_N - rubbed_N)), abs=1e-15)
    back = LAW.advance(NOT_BORNE, 0.0, J_INV_P, fed, -slowly, ready=False)
    assert back.load_N == pytest.approx(15.0 * PERIOD * 2.0 * rubbed_N)
    assert back.stuck_N == pytest.approx(15.0 * PERIOD * (fed_N + rubbed_N))


def test_a_load_is_low_passed() -> None:
    borne = Borne(load_N=1.0, stuck_N=0.5)
    for weight_N in (1.0, 2.0):
        found = LAW.advance(borne, weight_N, J_INV_P, STILL, STILL, ready=False)
        assert found.load_N == pytest.approx(1.0 + 15.0 * PERIOD * (weight_N - 1.0))
        assert found.stuck_N == pytest.approx(0.5 + 15.0 * PERIOD * (weight_N - 0.5))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_down_is_where_gravity_points(axis: int, sign: float) -> None:
    down = np.zeros(3)
    down[axis] = sign
    J_inv_P = np.array([[0.3, 0.5, 0.7, 9.0, 9.0, 9.0], [0.0] * 6])
    law = replace(LAW, down=tuple(down.tolist()))
    found = law.advance(NOT_BORNE, 0.0, J_inv_P, of((1.0, 0.0)), np.array([-1.0, 0.0]), ready=False)
    assert found.load_N == pytest.approx(-15.0 * PERIOD * sign * 0.6 * (0.3, 0.5, 0.7)[axis])


def test_at_its_limit_nothing_trips_and_what_is_no_number_does() -> None:
    assert not LAW.tripped(Borne(load_N=1.5))
    assert LAW.tripped(Borne(load_N=np.nextafter(1.5, 9.0)))
    assert LAW.tripped(Borne(load_N=math.nan))
    assert not LAW.tripped(Borne(stuck_N=2.5))
    assert LAW.tripped(Borne(stuck_N=np.nextafter(2.5, 9.0)))
    assert LAW.tripped(Borne(stuck_N=math.nan))
    assert not LAW.tripped(Borne(load_N=-9.0)), "a lift has a limit of its own"


def test_its_state_goes_through_a_row() -> None:
    memory = initial(3)
    braced = Braced(*np.arange(1.0, 6.0).tolist())
    memory = memory._replace(sense=memory.sense._replace(borne=Borne(0.3, 0.7, 0.2, 0.9)), braced=braced)
    flat = np.array(memory.flatten())
    assert (flat[LOAD_AT - 1], flat[LOAD_AT], flat[STUCK_AT - 1], flat[STUCK_AT]) == (0.3, 0.7, 0.2, 0.9)
    assert (restore(flat, 3).sense.borne, restore(flat, 3).braced) == ((0.3, 0.7, 0.2, 0.9), braced)
    before = restore(np.delete(flat[:-SETTLED], [STUCK_AT - 1, STUCK_AT]), 3)
    assert (before.sense.borne, before.braced) == ((0.3, 0.7, 0.0, 0.0), braced), "a row from before the second count"
    older = restore(flat[: LOAD_AT - 1], 3)
    assert (older.sense.borne, len(NOT_BORNE)) == (NOT_BORNE, BORNE), "a row of a log that is older than this sense"
    assert borne_of([]) == NOT_BORNE


@pytest.mark.parametrize(
    ("name", "changes", "limits_N"),
    [
        ("two_wx200", [], None),
        ("three_wx250s", [], (1.1, 2.07)),
        ("four_wx250s", [], (1.1, 1.89)),
        ("four_wx250s", ["tolerance.friction=[0.9, 1.1]"], (0.7, 1.89)),
        ("four_wx250s", ["tolerance.friction=[1.0, 1.0]"], (0.7, 1.89)),
        ("four_wx250s", ["tolerance.friction=[0.25, 1.1]"], (1.57, 2.04)),
        ("four_wx250s", ["controller.friction_feedforward=false"], None),
        ("four_wx250s", ["world.gravity_m_per_s2=[0.0, 0.0, 0.0]"], None),
    ],
)
def test_three_and_more_arms_that_feed_friction_forward_have_it(
    name: str, changes: list[str], limits_N: tuple[float, float] | None
) -> None:
    cell = load_cell(Path(name), changes)
    assert loads_N(cell) == limits_N
    for arm in cell.arms:
        found, friction = bearing(cell, arm), cell.offline(arm).friction
        if limits_N is None or friction is None:
            assert found is None
        else:
            assert found == Bearing(PERIOD, *limits_N, friction, (0.0, 0.0, -1.0))
    along = json.loads(run_info(cell, DriverKind.SIM, 0))["noticing_against"] or {}
    assert (along.get("load_N"), along.get("stuck_N")) == (limits_N or (None, None))
    told = [finding.found for finding in noticed(cell)]
    assert any("what friction bears" in words for words in told) is (limits_N is not None)
    words = "N down ({:g} N with what friction bears, {:g} N of joints that stick), "
    assert limits_N is None or any(words.format(*limits_N) in said for said in told)


def test_friction_that_sticks_is_not_taken_for_a_load(tmp_path: Path) -> None:
    assert loads_N(with_figures(load_cell(Path("three_wx250s")), tmp_path, pressed_on)) is None


def test_the_limit_is_above_what_realities_and_touches_showed() -> None:
    """Largest of 2 N for half a second, 28 times in 37 s, and of 20 s of three realities without any.

    In twelve realities touches made more than 1.1 N in 2 of 336 of four arms (1.26 N) and in none of three.
    """
    for name, touch_N, nobody_N in (("three_wx250s", 0.62, 0.26), ("four_wx250s", 0.42, 0.41)):
        found = loads_N(load_cell(Path(name)))
        assert found is not None
        assert found[0] >= 1.4 * touch_N
        assert found[0] >= 2.0 * nobody_N
        assert found[1] >= 1.3 * 1.43, "of a touch with joints that stick"
    exactly = loads_N(load_cell(Path("three_wx250s"), ["tolerance.friction=[1.0, 1.0]"]))
    assert exactly is not None
    assert exactly[0] >= 1.4 * 0.62


def until(lab: Laboratory, end_s: float, *faults: Fault) -> Run:
    run = Run(lab, None, faults)
    while run.t < end_s:
        run.advance()
    return run


def test_friction_that_is_known_exactly_is_no_load() -> None:
    """It turns round at the start of the motion all the same; joints that stick counted, it was 0.83 N."""
    exact = load_cell(Path("four_wx250s"), ["tolerance.friction=[1.0, 1.0]", "simulation.ready_s=1.0"])
    run, most_N = Run(Laboratory(exact), None), 0.0
    while run.t < 1.25:
        run.advance()
        most_N = max(most_N, *(place.memory.sense.borne.load_N for place in run.places))
    assert run.trips == []
    assert most_N == pytest.approx(0.12, abs=0.03)


@pytest.mark.long
def test_an_arm_that_goes_limp_while_the_box_goes_down_is_noticed_by_it_alone() -> None:
    """The others push up against their own friction; at 11 mm/s, without it nobody holds within 0.8 s."""
    lab = Laboratory(load_cell(Path("four_wx250s"), ["simulation.ready_s=1.0"]))
    fault = Fault(kind=FaultKind.LIMP, arm="right", at_s=32.0)
    run = until(lab, 32.5, fault)
    assert (len(run.trips), run.trips[0].t < 32.15) == (3, True)
    assert Flag.UNEXPECTED in run.trips[0].flags
    assert str(Cause.WEIGHT) in run.trips[0].why
    deaf = Laboratory(lab.cell)
    deaf.agents = tuple(replace(a, residual=replace(a.residual, bearing=None)) for a in lab.agents if a.residual)
    assert until(deaf, 32.8, fault).trips == []


@pytest.mark.long
def test_so_it_is_with_the_real_driver_and_loop_on_emulated_servos(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, lost = load_cell(Path("three_wx250s"), ["duration_s=17.6"]), Injection(fault="arm-off", arm="left", at_s=17.0)

    def held_s() -> list[float]:
        arms = rehearse(cell, [lost]).arms
        return [t for name in ("back", "front") for t, mode in arms[name].modes if mode is Mode.HOLD]

    first, last = sorted(held_s())
    assert 17.0 < first < 17.2
    assert last < 17.5
    monkeypatch.setattr("agent.config.noticing.bearing", lambda _cell, _arm: None)
    assert held_s() == []
