"""What may be a touch: the plain force, each of its limits, the cells that ask for it, and a push that holds no arm."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from agent.config import noticing
from agent.config.cell import Cell, load_cell
from agent.config.schema.driver import DriverKind
from agent.config.schema.fault import Fault, FaultKind
from agent.control import known
from agent.control.memory import restore
from agent.control.residual import Channels, Residual, nothing_sensed
from agent.control.touch import Plain, Touch, plain_of
from agent.control.trajectory import Desired
from agent.loop import step
from agent.modes import Mode
from agent.process.describe import run_info
from agent.safety import Flag
from agent.study.lab import Laboratory, Run
from agent.verify.noticing import noticed
from drivers.interface import JointState
from tests.support.branched import branched, ways
from tests.support.few import long
from tests.unit.control import test_residual as bench

LIMITS = Channels(1.75, 0.35, 1.2, 0.2)
DOWN = (0.0, 0.0, -1.0)
TOUCH = Touch(bench.PERIOD, 30.0, most_N=2.6, down_N=1.95, plain_N=1.0, down=DOWN)
WITHIN = Plain(np.zeros(3), 1.0)
FROM_REST, TURNING = np.zeros(3), np.array([3.0, -4.0, 5.0])


TOLD = {"two_wx200": {"most_N": 2.6, "down_N": 1.95, "plain_N": 1.0}, "paper_real": None, "paper": None}


# --- the plain force -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dq", [FROM_REST, TURNING])
@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_the_plain_force_is_the_one_that_is_there_within_its_rate(dq: np.ndarray, delay: float) -> None:
    for k, (sense, _) in enumerate(bench.alone(bench.WRENCH, 0.2, delay=delay, touch=TOUCH, dq=dq)):
        found = bench.WRENCH * (1.0 - (1.0 - 30.0 * bench.PERIOD) ** k) - sense.base
        assert sense.plain.force_N == pytest.approx(float(np.linalg.norm(found[:3])), abs=0.03)


def test_what_is_expected_of_the_momentum_is_what_the_joints_do_at_speed() -> None:
    """Beside another torque than the law's, an exact arm does what its dynamics say; nothing else acts on it."""
    c, (q, dq, tau) = load_cell(Path("paper")), np.array([[0.4, -0.9, 0.7], [3.0, -4.0, 5.0], [0.3, -0.2, 0.1]])
    model, offline = c.model(c.arms[0]), replace(c.offline(c.arms[0]), load_share=0.0, friction=None)
    pose = model.evaluate(q, dq)
    quickly = Desired(pose.p_object, pose.quat_object, (0.9, -0.6, 0.0, 0.0, 0.0, -3.0), (0.0,) * 6)
    terms = known.torque(model, offline, q, dq, quickly)
    begin, h = TOUCH.begin(terms, dq).momentum, 1e-7
    after = dq + h * pin.aba(model.model, model.model.createData(), q, dq, tau)
    changed = (model.evaluate(q + h * dq, after).B.dot(after) - pose.B.dot(dq)) / h
    assert (begin - pose.B.dot(dq)) / TOUCH.period_s + tau == pytest.approx(changed, abs=1e-4)


def test_a_tick_does_what_the_equations_say_in_six_dimensions() -> None:
    _, terms = bench.alone(bench.WRENCH, 0.02, dq=TURNING)[-1]
    rng, dq = np.random.default_rng(2), np.array([0.1, -0.2, 0.3])
    J_inv_P, acting, base, before = rng.normal(size=(3, 6)), *rng.normal(size=(3, 6))
    found = TOUCH.advance(Plain(before[:3]), terms, J_inv_P, dq, acting[:3], base)
    k = terms.kinematics
    estimate = before[:3] + bench.PERIOD * acting[:3]
    r = 30.0 * (k.B @ dq - estimate)
    assert found.force_N == pytest.approx(float(np.linalg.norm((J_inv_P.T @ r - base)[:3])))
    expected = k.C.T @ dq - (terms.tau_cmd - terms.tau_feedback) + k.B @ terms.ddq_ref + k.C @ terms.dq_ref
    assert found.momentum == pytest.approx(estimate + bench.PERIOD * (expected + r))


def test_nobody_looks_for_it_where_no_touch_is_above_the_limit() -> None:
    sense, _ = bench.alone(bench.WRENCH, 0.05)[-1]
    assert sense.plain.flat == (0.0,) * 8


def test_its_state_goes_through_a_row() -> None:
    plain = Plain(np.array([1.0, -2.0, 3.0]), 0.7)
    found = plain_of(plain.flat, 3)
    assert found.momentum.tolist() == [1.0, -2.0, 3.0]
    assert found.force_N == 0.7
    assert plain_of([], 3).flat == (0.0,) * 8


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "plain_N", "may_be"),
    [
        ((2.59, 0.0, 0.0), 1.0, True), ((2.61, 0.0, 0.0), 0.0, False), ((-1.5, 1.5, 1.6), 1.0, False),
        ((0.0, 0.0, -1.94), 1.0, True), ((0.0, 0.0, -1.96), 0.0, False), ((0.0, 0.0, 2.5), 1.0, True),
        ((1.5, 0.0, -1.96), 0.0, False), ((2.0, 0.0, 0.0), 1.01, False),
        ((math.nan, 0.0, 0.0), 0.0, False), ((2.0, 0.0, 0.0), math.nan, False),
    ],
)  # fmt: skip
def test_a_touch_is_within_each_of_three_limits(force: tuple[float, ...], plain_N: float, may_be: bool) -> None:
    assert TOUCH.may_be(force, Plain(np.zeros(3), plain_N)) is may_be
    residual = Residual(0.005, 0.0, LIMITS, touch=TOUCH)
    sense = nothing_sensed(3)._replace(base=np.array([0.5, 0.0, 0.1, 0.0, 0.0, 0.0]), plain=Plain(np.zeros(3), plain_N))
    wrench = sense.base + np.array([*force, 0.0, 0.0, 0.0])
    found = residual.channels(sense, wrench)
    assert residual.tripped(found, sense, wrench) is not may_be


@pytest.mark.parametrize("force", [(2.6, 0.0, 0.0), (0.0, 0.0, -1.95)])
def test_at_its_limits_it_may_be_one(force: tuple[float, ...]) -> None:
    assert TOUCH.may_be(force, WITHIN)
    assert not TOUCH.may_be(np.nextafter(force, 9.0 * np.array(force)).tolist(), WITHIN)


def test_down_is_where_gravity_points() -> None:
    tilted = Touch(0.005, 30.0, 2.6, 1.95, 1.0, (0.6, -0.48, -0.64))
    assert not tilted.may_be((1.2, -0.96, -1.28), WITHIN)
    assert tilted.may_be((1.2, 0.96, -1.28), WITHIN)
    nowhere = Touch(0.005, 30.0, 2.6, 1.95, 1.0)
    for to_a_side in 2.5 * np.vstack([np.eye(3), -np.eye(3)]):
        assert nowhere.may_be(to_a_side.tolist(), WITHIN)


@pytest.mark.parametrize("channel", [1, 2, 3])
def test_a_touch_excuses_the_sudden_force_and_nothing_else(channel: int) -> None:
    sense, wrench = nothing_sensed(3), np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = [2.0, *LIMITS[1:]]
    with_touch, without = (Residual(0.005, 0.0, LIMITS, touch=t) for t in (TOUCH, None))
    assert not with_touch.tripped(Channels(*found), sense, wrench)
    assert without.tripped(Channels(*found), sense, wrench)
    for beyond in (1.001 * found[channel], math.nan):
        found[channel] = beyond
        assert with_touch.tripped(Channels(*found), sense, wrench)


# --- cells -----------------------------------------------------------------------------------------------------------


def cell(name: str = "two_wx200", *overrides: str) -> Cell:
    return load_cell(Path(name), overrides)


def touch_of(c: Cell) -> Touch | None:
    return noticing.touch(c, noticing.thresholds(c))


def test_cells_in_which_only_a_touch_sets_the_limit_have_it() -> None:
    assert touch_of(cell()) == Touch(0.005, 30.0, 2.6, 1.95, 1.0, DOWN)
    assert touch_of(cell("two_wx200", "safety.noticing.rate_per_s=20.0", "rate_hz=100.0")) == Touch(
        0.01, 20.0, 2.6, 1.95, 1.0, DOWN
    )
    for name in ("paper_real", "paper_adaptive", "two_models", "three_wx250s", "four_wx250s"):
        assert touch_of(cell(name)) is None, "friction and encoders ask for more than a touch"
    assert touch_of(cell("two_wx200", "safety.noticing.fast_N=1.75")) is None, "what the file gives counts"
    smooth = cell("three_wx250s", "tolerance.friction=[1.0, 1.0]", "safety.noticing.rate_per_s=5.0")
    assert touch_of(smooth) == Touch(0.005, 5.0, 1.73, 1.3, 0.667, DOWN), "of three arms a third each"


def test_limits_are_above_what_618_pushes_showed() -> None:
    """2 N for half a second, in 16 realities and as the file says, to all sides, at 0 to 21 mm/s: size, down, plain."""
    found = touch_of(cell())
    assert found is not None
    assert found.most_N >= 1.07 * 2.42
    assert found.down_N >= 1.07 * 1.81
    assert found.plain_N >= 1.07 * 0.91


def test_the_check_says_it() -> None:
    assert noticed(cell())[0].found.startswith("1.75 N (2.6 N where it may be a touch), 0.35 N·m at once; ")
    assert "touch" not in noticed(cell("paper_real"))[0].found


def test_the_log_says_it() -> None:
    told = {name: json.loads(run_info(cell(name), DriverKind.SIM, 0))["noticing_touch"] for name in TOLD}
    assert told == TOLD


# --- a push and a neighbour that holds -------------------------------------------------------------------------------

BEGIN_S = 6.0  # at 35 mm/s against x
READY = "simulation.ready_s=0.4"


@cache
def lab(*overrides: str) -> Laboratory:
    return Laboratory(cell("two_wx200", READY, *overrides))


@cache
def begun() -> Run:
    return ways(lab())(BEGIN_S)


def run(*overrides: str, fault: FaultKind | None = None, push_N: float = 0.0, end_s: float = BEGIN_S + 0.8) -> Run:
    """Until end_s or the first arm that holds by itself; a fault of the arm left, or a push along x for 0.5 s."""
    faults = [] if fault is None else [Fault(kind=fault, arm="left", at_s=BEGIN_S)]
    found = branched(begun(), lab(*overrides), *faults)
    while found.t < end_s and not any(trip.arm == "right" for trip in found.trips):
        pushed = BEGIN_S <= found.t < BEGIN_S + 0.5
        found.plant.push(np.array([push_N if pushed else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        found.advance()
    return found


def test_two_newtons_against_the_motion_for_half_a_second_are_no_trip_any_more() -> None:
    assert run(push_N=2.0).trips == []
    assert Flag.UNEXPECTED in run("safety.noticing.fast_N=1.75", push_N=2.0).trips[0].flags


@pytest.mark.parametrize(
    ("fault", "within_s"),
    [
        (FaultKind.LIMP, 0.110),
        *map(long, ((FaultKind.HOLD, 0.100), (FaultKind.LOCKED, 0.090))),  # as long as in test_cause.py
    ],
)
def test_a_neighbour_that_fails_is_noticed_as_soon_as_it_must_be(fault: FaultKind, within_s: float) -> None:
    noticed_at = next(trip.t for trip in run(fault=fault).trips if trip.arm == "right")
    assert 0.0 < noticed_at - BEGIN_S <= within_s + 1e-9


def test_a_tick_goes_on_from_its_row_bit_for_bit() -> None:
    pushed = run(push_N=2.0, end_s=BEGIN_S + 0.08)
    place = pushed.places[1]
    memory, n = place.memory, place.agent.model.n
    assert memory.sense.plain.force_N > 0.5
    q, dq, tau = (values[place.joints] for values in pushed.plant.reported())
    state, restored = JointState(0, q, dq, tau), restore(np.array(memory.flatten()), n)
    one, two = (step(place.agent, state, pushed.t, Mode.TRACK, m) for m in (memory, restored))
    assert one.memory.flatten() == two.memory.flatten()
    assert one.memory.sense.plain.flat != memory.sense.plain.flat
