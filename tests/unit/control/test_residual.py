"""The unexpected wrench: found with its sign and size, whatever the law does meanwhile; channels, limits, the log."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import load_cell
from agent.control import known
from agent.control.against import NO_PULL, Against
from agent.control.borne import Bearing, Borne
from agent.control.friction import Friction, JointFriction
from agent.control.knock import Knock, Struck
from agent.control.residual import Channels, Residual, Sense, nothing_sensed
from agent.control.terms import Terms
from agent.control.touch import Touch
from agent.control.trajectory import Desired
from tests.support.starts import start_joints

PERIOD = 1e-3
LIMITS = Channels(2.0, 0.35, 1.2, 0.15)
STILL = (0.0,) * 6
WRENCH = np.array([1.5, -2.0, 0.0, 0.0, 0.0, 0.08])  # in the plane of the cell


def alone(
    wrench: np.ndarray, seconds: float, *, delay: float = 0.0, ready_s: float = 0.0, touch: Touch | None = None,
    dq: np.ndarray | None = None, gap: range = range(0),
) -> list[tuple[Sense, Terms]]:  # fmt: skip
    """One arm of the paper's cell under the law, alone, with a wrench at the object from ready_s on; exact model.

    dq: (3,) with which it begins, none: at rest; gap: ticks that are missed.
    """
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    arm = cell.arms[0]
    model, offline = cell.model(arm), replace(cell.offline(arm), load_share=0.0, friction=None)
    q, dq = np.array(start_joints(cell)[0]), np.zeros(3) if dq is None else dq
    data = model.model.createData()
    pose = model.evaluate(q, dq)
    desired = Desired((pose.p_object[0] + 0.002, *pose.p_object[1:]), pose.quat_object, STILL, STILL)
    residual, sense = Residual(PERIOD, delay, LIMITS, touch=touch), nothing_sensed(3)
    sent = [model.evaluate(q, dq).g] * 2
    history = []
    for k in range(round(seconds / PERIOD)):
        ready = k * PERIOD < ready_s
        terms = known.torque(model, offline, q, dq, desired)
        assert terms.J_inv_P is not None
        missed = len(gap) if k == gap.stop else 0
        if missed > 2:
            sense = residual.over_a_gap(sense, terms, dq)
        elif k not in gap:
            before = sent[0], sent[0] if missed else sent[1]
            sense = residual.advance(sense, terms, terms.J_inv_P, dq, before, ready=ready, periods=1 + missed)
        history.append((sense, terms))
        sent = [sent[0] if k in gap else terms.tau_cmd, sent[0]]
        acting = delay * sent[1] + (1.0 - delay) * sent[0]
        outside = 0.0 if ready else terms.kinematics.Jt.dot(wrench)
        dq = dq + PERIOD * pin.aba(model.model, data, q, dq, acting + outside)
        q = q + PERIOD * dq
    return history


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0])
def test_the_unexpected_wrench_is_found_with_sign_and_size(delay: float) -> None:
    sense, terms = alone(WRENCH, 0.4, delay=delay)[-1]
    assert terms.J_inv_P is not None
    assert terms.J_inv_P.T.dot(sense.residual) == pytest.approx(WRENCH, abs=0.05)


def test_nothing_is_sensed_while_the_arm_only_follows_its_law() -> None:
    sizes = [np.abs(sense.residual).max() for sense, _ in alone(np.zeros(6), 0.4)]
    assert max(sizes) < 5e-3, "2 mm of error give 0.3 N of feedback, which is no outside force"


def test_it_follows_within_its_rate() -> None:
    found = [terms.J_inv_P.T.dot(sense.residual)[1] for sense, terms in alone(WRENCH, 0.2)]  # type: ignore[union-attr]
    reached = next(k for k, f in enumerate(found) if f < 0.632 * WRENCH[1])
    assert 0.8 / 30.0 < reached * PERIOD < 1.3 / 30.0


@pytest.mark.parametrize("touch", [None, Touch(PERIOD, 30.0, 2.6, 1.95, 1.0)])
def test_over_a_gap_nothing_is_found_and_afterwards_what_is_there(touch: Touch | None) -> None:
    gap = range(20, 60)
    history = alone(WRENCH, 0.4, gap=gap, touch=touch)
    before, after, then = (history[k][0] for k in (gap.start - 1, gap.stop, gap.stop + 1))
    assert then.residual == pytest.approx(before.residual, abs=0.025), "a tick makes 3 % of what acts"
    assert after.residual.tolist() == before.residual.tolist()
    assert after.slow.tolist() == before.slow.tolist()
    assert after.plain.force_N == 0.0
    sense, terms = history[-1]
    assert terms.J_inv_P is not None
    assert terms.J_inv_P.T.dot(sense.residual) == pytest.approx(WRENCH, abs=0.05)
    residual, dq, nothing = Residual(PERIOD, 0.0, LIMITS), np.array([0.1, -0.2, 0.3]), np.zeros(3)
    usual = residual.advance(sense, terms, terms.J_inv_P, dq, (nothing, nothing), ready=False, periods=1)
    assert residual.over_a_gap(sense, terms, dq).expected.tolist() == usual.expected.tolist() != sense.expected.tolist()
    if touch is not None:
        assert sense.plain.force_N == pytest.approx(np.hypot(*(WRENCH - sense.base)[:2]), rel=0.1)


@pytest.mark.parametrize("missed", [1, 2])
def test_ticks_that_were_missed_are_counted(missed: int) -> None:
    def found(gap: range) -> np.ndarray:
        return np.array(alone(WRENCH, 0.1, gap=gap)[60 + missed][0].residual)

    all_seen, nothing = found(range(0)), np.array(alone(WRENCH, 0.1)[59][0].residual)
    grown = all_seen - nothing
    assert np.linalg.norm(found(range(60, 60 + missed)) - all_seen) < 0.2 * np.linalg.norm(grown)


def test_a_load_that_stays_leaves_the_fast_channel_and_fills_the_slow_one() -> None:
    history = alone(WRENCH, 3.0)
    residual = Residual(PERIOD, 0.0, LIMITS)

    def sizes(k: int) -> Channels:
        sense, terms = history[k]
        assert terms.J_inv_P is not None
        return residual.channels(sense, terms.J_inv_P.T.dot(sense.residual))

    early, late = sizes(150), sizes(-1)
    assert early.fast_N > 2.0 > late.fast_N
    assert early.slow_N < 0.8 < 1.2 < late.slow_N
    for k, found in ((150, early), (-1, late)):
        assert residual.tripped(found, history[k][0], WRENCH)


def test_nothing_is_usual_of_an_arm_that_only_follows_its_law() -> None:
    waited, _ = alone(WRENCH, 0.5, ready_s=0.5)[-1]
    assert waited.ticks == 500.0
    assert np.abs(waited.rest).max() < 0.05


@pytest.mark.parametrize(("periods", "ready"), [(1, False), (3, False), (1, True)])
def test_a_tick_does_what_the_equations_say(periods: int, ready: bool) -> None:
    sense, terms = alone(WRENCH, 0.05, delay=0.4)[-1]
    assert terms.J_inv_P is not None
    moving = terms._replace(desired=terms.desired._replace(v=(0.02, -0.01, 0.0, 0.0, 0.0, 0.1)))
    against = Against(PERIOD, 0.7, 0.14, (0.0, 0.0, -1.0))
    knock = Knock(PERIOD, 0.8)
    bearing = Bearing(PERIOD, 1.5, 2.0, Friction((JointFriction(0.2, 0.1),) * 3, 0.05), (0.48, 0.6, -0.64))
    residual = Residual(PERIOD, 0.4, LIMITS, against=against, knock=knock, bearing=bearing)
    dq, last, before = np.array([[0.1, -0.2, 0.3], [0.5, 0.3, -0.1], [-0.2, 0.4, 0.6]])
    found = residual.advance(sense, moving, terms.J_inv_P, dq, (last, before), ready=ready, periods=periods)
    acting = (0.6 * last + 0.4 * before) + (periods - 1) * last
    estimate = sense.momentum + PERIOD * (acting + periods * (sense.expected + sense.residual))
    k, s = terms.kinematics, dq - terms.dq_ref
    assert found.momentum == pytest.approx(estimate)
    assert found.residual == pytest.approx(30.0 * (k.B @ s - estimate))
    assert found.expected == pytest.approx(k.C.T @ s - (terms.tau_cmd - terms.tau_feedback))
    W = terms.J_inv_P.T @ found.residual
    assert found.base == pytest.approx(sense.base + PERIOD * 0.5 * (W - sense.base))
    assert found.slow == pytest.approx(sense.slow + PERIOD * 2.0 * (W - sense.slow))
    assert found.ticks == sense.ticks + ready
    speeds = (terms.J_inv_P @ np.array(moving.desired.v)).tolist()
    assert found.struck == pytest.approx(knock.advance(sense.struck, (W - found.base)[:3].tolist(), speeds))
    assert found.struck.knock_N
    fed = terms.tau_friction
    borne = bearing.advance(sense.borne, found.pull.weight_N, terms.J_inv_P, fed, dq, ready=ready)
    assert found.borne == pytest.approx(borne)
    assert found.borne.usual_N
    if ready:
        assert found.pull is sense.pull
        return
    assert found.rest is sense.rest
    expected = against.advance(sense.pull, W.tolist(), found.base.tolist(), moving.desired.v)
    assert found.pull.flat == pytest.approx(expected.flat)
    assert found.pull.sum_N


def test_what_is_usual_is_the_mean_of_the_slow_channel_and_later_of_two_seconds() -> None:
    _, terms = alone(WRENCH, 0.02)[-1]
    assert terms.J_inv_P is not None
    residual, sense = Residual(0.1, 0.0, LIMITS, rate_per_s=3.0), nothing_sensed(3)
    dq, tau = np.array([0.1, -0.2, 0.3]), np.array([0.3, -0.2, 0.1])
    seen, usual = [], np.zeros(6)
    for _ in range(30):
        sense = residual.advance(sense, terms, terms.J_inv_P, dq, (tau, tau), ready=True, periods=1)
        seen.append(sense.slow)
        usual = np.mean(seen, axis=0) if len(seen) <= 20 else usual + (sense.slow - usual) / 20.0
        assert sense.rest == pytest.approx(usual, rel=1e-9)
    assert np.abs(usual).max() > 0.1


def test_sizes_are_of_force_and_moment_without_what_is_slow_and_what_is_usual() -> None:
    wrench, base, slow, rest = np.random.default_rng(1).normal(size=(4, 6))
    found = Residual(PERIOD, 0.0, LIMITS).channels(nothing_sensed(3)._replace(base=base, slow=slow, rest=rest), wrench)
    sizes = [np.linalg.norm(part) for w in (wrench - base, slow - rest) for part in (w[:3], w[3:])]
    assert found == pytest.approx(sizes)


@pytest.mark.parametrize(
    ("level_N", "weight_N", "knock_N", "load_N", "stuck_N", "told"),
    [
        (0.69, 0.73, 0.79, 1.49, 1.99, (False, False, False)),
        (0.71, 0.0, 0.0, 0.0, 0.0, (True, True, False)),
        (0.0, 0.74, 0.0, 0.0, 0.0, (True, False, True)),
        (0.0, -0.88, 0.0, 0.0, 0.0, (True, False, False)),
        (0.0, 0.0, 0.81, 0.0, 0.0, (True, False, False)),
        (0.0, 0.0, 0.0, 1.51, 0.0, (True, False, True)),
        (0.0, 0.0, 0.0, 0.0, 2.01, (True, False, True)),
    ],
)
def test_who_asks_for_it_is_told_of_a_pull_back_a_weight_a_lift_and_a_blow(
    level_N: float, weight_N: float, knock_N: float, load_N: float, stuck_N: float, told: tuple[bool, ...]
) -> None:
    bearing = Bearing(PERIOD, 1.5, 2.0, Friction((), 0.05), (0.0, 0.0, -1.0))
    along = {"against": Against(PERIOD, 0.7, 0.14), "knock": Knock(PERIOD, 0.8)}
    asked = Residual(PERIOD, 0.0, LIMITS, **along, bearing=bearing)  # type: ignore[arg-type]
    nobody = Residual(PERIOD, 0.0, LIMITS)
    for slip in (1.0, 3.0):
        pull = NO_PULL._replace(level_N=slip * level_N, weight_N=slip * weight_N)
        struck = Struck(knock_N=slip * knock_N, slip=slip)
        borne = Borne(load_N=load_N, stuck_N=stuck_N)
        sense = nothing_sensed(3)._replace(pull=pull, struck=struck, borne=borne)
        assert (asked.pulled(sense), asked.dragged(sense), asked.weighed(sense)) == told
        assert (nobody.pulled(sense), nobody.dragged(sense), nobody.weighed(sense)) == (False, False, False)


@pytest.mark.parametrize("half", [{"against": Against(PERIOD, 0.7, 0.14)}, {"knock": Knock(PERIOD, 0.8)}])
def test_nobody_has_a_pull_without_the_slip_that_its_limits_grow_with(half: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="go together"):
        Residual(PERIOD, 0.0, LIMITS, **half)


@pytest.mark.parametrize("channel", range(4))
def test_each_channel_has_its_limit(channel: int) -> None:
    residual, nothing = Residual(PERIOD, 0.0, LIMITS), (nothing_sensed(3), np.zeros(6))
    at = list(LIMITS)
    assert not residual.tripped(Channels(*at), *nothing)
    at[channel] *= 1.001
    assert residual.tripped(Channels(*at), *nothing)
    at[channel] = np.nan
    assert residual.tripped(Channels(*at), *nothing)
