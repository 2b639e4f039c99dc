"""The coupling of a real arm and its twin against its formulae."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.interface import Vector
from drivers.rehearsal import STIFFEST, frequency, loop_delay_s
from sim_backend.hil.coupling import (
    LASTING_S,
    OBSERVER_PER_S,
    SUDDEN_PER_S,
    Coupling,
    Here,
    Settings,
    TwinState,
)
from sim_backend.hil.touch import Borne

T_NS, T = 5_000_000, 0.005
TENTH = 20  # cycles of a tenth of a second
W, Z = 20.0, 0.7
CLAMP = np.array([1.0, 0.5])
B = np.array([[0.04, 0.01], [0.01, 0.02]])
NONE, SOME = Borne(0.0, 0.6), Borne(9.0, 0.6)
SETTINGS = Settings(T, W, Z, CLAMP, ramp_s=0.2, apart_max_rad=0.3, touch=NONE)
TO_FORCE = np.array([[10.0, 0.0], [0.0, 10.0], [0.0, 0.0]])
HERE = Here(B, TO_FORCE)
ZERO = np.zeros(2)
vectors = arrays(np.float64, 2, elements=st.floats(-5.0, 5.0))


def twin(stamp_ns: int, q: Vector = ZERO, dq: Vector = ZERO, grasp: Vector = ZERO) -> TwinState:
    return TwinState(stamp_ns, q, dq, grasp, grasp)


def coupled(cycles: int = 60, touch: Borne = NONE) -> tuple[Coupling, int]:
    """Wholly ramped in with everything at zero; and the next stamp."""
    coupling = Coupling(replace(SETTINGS, touch=touch))
    for k in range(cycles):
        coupling.step(k * T_NS, ZERO, ZERO, twin(k * T_NS), HERE)
    return coupling, cycles * T_NS


def test_the_rule_keeps_to_two_thirds_of_what_is_stable_at_every_delay() -> None:
    for extra in (0.0, 1.0, 4.0):
        for period_s in (0.002, 0.005, 0.02):
            delay_s = loop_delay_s(period_s, extra)
            assert frequency(delay_s) * delay_s <= 2.0 / 3.0 * STIFFEST + 1e-12
    assert loop_delay_s(0.005, 0.0) == pytest.approx(0.0075)
    assert frequency(0.0075) == 25.0
    assert frequency(0.0175) == pytest.approx(0.2 / 0.0175)


def test_both_sides_get_the_coupling_and_the_twin_alone_what_the_arm_does_otherwise() -> None:
    coupling, now = coupled()
    q, dq, q_t, grasp = np.array([0.01, -0.02]), np.array([0.3, 0.1]), np.array([0.0, 0.01]), np.array([0.2, -0.1])
    coupling.step(now, q, dq, twin(now, q_t, ZERO, grasp), HERE)
    c = np.diag(B) * (W**2 * (q_t - q) + 2.0 * Z * W * (ZERO - dq))
    r = OBSERVER_PER_S * (B @ dq - T * (ZERO - grasp))
    np.testing.assert_allclose(coupling.addition, np.clip(grasp + c, -CLAMP, CLAMP))
    np.testing.assert_allclose(coupling.on_twin, np.clip(r, -CLAMP, CLAMP) - c)


def test_the_twin_is_looked_at_where_it_will_be_at_the_arms_instant() -> None:
    coupling, now = coupled()
    dq = np.array([0.5, -0.5])
    coupling.step(now, ZERO, dq, twin(now - 4_000_000, ZERO, dq), HERE)
    np.testing.assert_allclose(coupling.q_twin, 0.004 * dq)
    assert coupling.age_s == pytest.approx(0.004)
    coupling.step(now + T_NS, ZERO, dq, twin(now + T_NS - 900_000_000, ZERO, dq), HERE)
    np.testing.assert_allclose(coupling.q_twin, 3 * T * dq, err_msg="not further than a state is fresh")
    coupling.step(now + 2 * T_NS, ZERO, dq, twin(now + 2 * T_NS + 900_000_000, ZERO, dq), HERE)
    np.testing.assert_allclose(coupling.q_twin, -3 * T * dq, err_msg="nor further back")


@pytest.mark.parametrize("otherwise", [(0.0, 0.0), (0.1, -0.05)], ids=["as the twin", "another torque"])
def test_what_the_arm_does_otherwise_is_found(otherwise: tuple[float, float]) -> None:
    """Arm and twin as two bodies; a torque on the arm alone: r tends to it, and the two stay together."""
    d, grasp = np.array(otherwise), np.array([0.03, 0.02])
    coupling, now = coupled()
    q, dq, q_t, dq_t = ZERO, ZERO, ZERO, ZERO
    for k in range(400):
        added, on_twin = coupling.addition, coupling.on_twin
        coupling.step(now + k * T_NS, q, dq, twin(now + k * T_NS, q_t, dq_t, grasp), HERE)
        damping = 2.0 * np.diag(B)
        dq = dq + T * np.linalg.solve(B, added + d - damping * dq)  # of the command of the cycle before
        dq_t = dq_t + T * np.linalg.solve(B, on_twin + grasp - damping * dq_t)
        q, q_t = q + T * dq, q_t + T * dq_t
    np.testing.assert_allclose(coupling._otherwise.r, d, atol=4e-3)
    assert coupling.apart_rad(q) < 0.02


def test_the_addition_ramps_in_and_fades_within_a_tenth_of_a_second_when_the_twin_is_stale() -> None:
    coupling, grasp, sizes = Coupling(SETTINGS), np.array([0.4, 0.2]), []
    for k in range(60):
        coupling.step(k * T_NS, ZERO, ZERO, twin(k * T_NS, grasp=grasp), HERE)
        sizes.append(coupling.addition[0])
    assert sizes[0] == pytest.approx(0.4 * T / 0.2)
    assert np.diff(sizes).max() <= 0.4 * T / 0.2 + 1e-12
    assert sizes[40] == pytest.approx(0.4)
    last = twin(59 * T_NS + 1_000_000, grasp=grasp)
    for k in range(60, 63):
        coupling.step(k * T_NS, ZERO, ZERO, last, HERE)
        assert coupling.alive == 1.0
    for k in range(63, 63 + TENTH):
        assert coupling.alive > 0.5 / TENTH
        coupling.step(k * T_NS, ZERO, ZERO, last, HERE)
    np.testing.assert_allclose(coupling.addition, 0.0, atol=1e-12)


def test_an_arm_whose_twin_is_given_up_loses_the_addition_in_a_tenth_of_a_second_and_the_twin_at_once() -> None:
    coupling, now = coupled()
    coupling.step(now, ZERO, np.array([0.2, 0.0]), twin(now, grasp=np.array([0.4, 0.2])), HERE)
    sizes = [float(np.abs(coupling.addition).max())]
    for k in range(TENTH):
        coupling.alone(now + (k + 1) * T_NS)
        sizes.append(float(np.abs(coupling.addition).max()))
        assert not coupling.on_twin.any()
    np.testing.assert_allclose(sizes, sizes[0] * np.linspace(1.0, 0.0, len(sizes)), atol=1e-12)


def test_a_cycle_without_a_state_keeps_the_objects_part_and_drops_what_answered_the_motion() -> None:
    coupling, now = coupled()
    grasp = np.array([0.4, 0.2])
    coupling.step(now, np.array([0.02, 0.0]), ZERO, twin(now, grasp=grasp), HERE)
    assert coupling.addition[0] != pytest.approx(0.4)
    coupling.unheard()
    np.testing.assert_allclose(coupling.addition, grasp)


@pytest.mark.parametrize(
    ("cycles", "counted", "share"),
    [(1, 1, (1.0, 0.0)), (2, 2, (0.5, 0.5)), (3, 3, (1.0 / 3.0, 2.0 / 3.0)), (9, 3, (1.0 / 3.0, 2.0 / 3.0))],
)
def test_what_the_arm_does_otherwise_is_beside_the_torques_that_have_made_its_motion(
    cycles: int, counted: int, share: tuple[float, float]
) -> None:
    """Those of two cycles before and, for the younger part of the motion, of the cycle before; three cycles at most."""
    coupling, now = coupled()
    older, newer = np.array([0.3, 0.0]), np.array([0.1, 0.2])
    coupling._before.extend([older, newer])
    at = now + (cycles - 1) * T_NS
    coupling.step(at, ZERO, ZERO, twin(at), HERE)
    acted = share[0] * older + share[1] * newer
    np.testing.assert_allclose(coupling._otherwise.r, -OBSERVER_PER_S * counted * T * acted)


def test_what_acts_in_cycles_without_a_state_is_no_torque_that_the_arm_does_otherwise() -> None:
    """On the arm the object's part, on the twin what lasts: the difference is what the two then move by."""
    coupling, now = coupled()
    grasp = np.array([0.4, 0.2])
    coupling.step(now, ZERO, ZERO, twin(now, grasp=grasp), HERE)
    coupling.lasting, begin = np.array([0.05, 0.0]), coupling._otherwise._estimate
    before = coupling._otherwise.r
    coupling.unheard()
    coupling.unheard()
    at = now + 3 * T_NS
    coupling.step(at, ZERO, ZERO, twin(at, grasp=grasp), HERE)
    np.testing.assert_allclose(coupling._otherwise.r, -OBSERVER_PER_S * (begin + 3 * T * (before - [0.05, 0.0])))


def test_nothing_is_a_touch_while_the_coupling_ramps_in() -> None:
    coupling, now = coupled(cycles=20, touch=SOME)
    assert 0.0 < coupling.alive < 1.0
    coupling.step(now, ZERO, np.linalg.solve(B, np.array([0.3, 0.0])) / SUDDEN_PER_S, twin(now), HERE)
    assert (coupling.touch.share, coupling.touch.count) == (0.0, 0)


def test_a_cycle_without_a_state_leaves_the_twin_what_the_arm_does_otherwise_than_its_model_for_long() -> None:
    """The arm is pushed at by 0.1 N·m that its model does not know; then it is silent."""
    coupling, now = coupled()
    extra, dq, dq_t = np.array([0.1, 0.0]), np.zeros(2), np.zeros(2)
    shares = []
    for _ in range(200):
        now += T_NS
        shares.append(coupling.lasting[0] / extra[0])
        coupling.step(now, ZERO, dq, replace(twin(now), dq=dq_t), HERE)
        dq = dq + T * np.linalg.solve(B, extra + coupling.addition)
        dq_t = dq_t + T * np.linalg.solve(B, coupling.on_twin)
    assert shares[round(LASTING_S / T)] == pytest.approx(1.0 - np.exp(-1.0), abs=0.15), "a mean of this length"
    coupling.unheard()
    np.testing.assert_allclose(coupling.on_twin, extra, atol=0.02)
    coupling.alone(now)
    coupling.unheard()
    assert not coupling.on_twin.any(), "nothing is left of it after they have parted"


def touched() -> tuple[Coupling, int, Vector]:
    """Coupled, at rest; then the arm has the momentum that 0.3 N·m beside its model would make; and its velocities."""
    coupling, now = coupled(touch=SOME)
    dq = np.linalg.solve(B, np.array([0.3, 0.0])) / SUDDEN_PER_S
    coupling.step(now, ZERO, dq, twin(now), HERE)
    return coupling, now, dq


def test_what_touches_the_arm_is_stood_against_and_its_twin_feels_none_of_it() -> None:
    coupling, _, dq = touched()
    assert (coupling.touch.share, coupling.touch.count) == (1.0, 1)
    c = np.diag(B) * (2.0 * Z * W * -dq)
    np.testing.assert_allclose(coupling.addition, c - np.array([0.3, 0.0]))
    np.testing.assert_allclose(coupling.on_twin, 0.0)
    np.testing.assert_allclose(coupling.lasting, 0.0, err_msg="nothing of it is learnt")


def test_while_it_is_touched_the_agent_goes_by_the_twin_and_the_row_has_the_arm() -> None:
    coupling, now, dq = touched()
    state = TwinState(now + T_NS, np.array([0.01, 0.02]), np.array([0.1, 0.0]), ZERO, ZERO)
    coupling.step(now + T_NS, ZERO, dq, state, HERE)
    seen, speeds, other = coupling.seen(ZERO, dq)
    np.testing.assert_array_equal(seen, state.q)
    np.testing.assert_array_equal(speeds, state.dq)
    np.testing.assert_array_equal(other, ZERO)
    coupling.touch.share = 0.25
    seen, speeds, other = coupling.seen(ZERO, dq)
    np.testing.assert_allclose(seen, 0.25 * state.q)
    np.testing.assert_allclose(speeds, 0.75 * dq + 0.25 * state.dq)
    np.testing.assert_allclose(other, 0.75 * state.q)


def test_a_touched_arm_that_its_twin_draws_more_strongly_than_a_touch_is_felt_by_all() -> None:
    coupling, now, dq = touched()
    apart = SOME.most_N / (TO_FORCE[0, 0] * B[0, 0] * W**2)
    for share, of_that in ((1.0, 0.5), (0.0, 1.5)):
        now += T_NS
        coupling.step(now, ZERO, dq, twin(now, np.array([of_that * apart, 0.0])), HERE)
        assert coupling.touch.share == share


def test_a_touch_leaves_the_twin_what_the_arm_does_otherwise_for_long() -> None:
    coupling, now, _ = touched()
    coupling.lasting = np.array([0.05, 0.02])
    coupling.touch.share = 1.0
    coupling.step(now + T_NS, ZERO, np.linalg.solve(B, np.array([0.3, 0.0])) / SUDDEN_PER_S, twin(now + T_NS), HERE)
    np.testing.assert_allclose(coupling.on_twin, [0.05, 0.02])
    np.testing.assert_allclose(coupling.lasting, [0.05, 0.02])


def test_with_a_stale_or_lost_twin_the_agent_goes_by_the_arm_at_once() -> None:
    coupling, now, dq = touched()
    coupling.step(now + T_NS, ZERO, dq, twin(now + T_NS - 16_000_000), HERE)
    assert coupling.touch.share == 0.0
    np.testing.assert_array_equal(coupling.seen(ZERO, dq)[1], dq)
    coupling, now, dq = touched()
    coupling.alone(now + T_NS)
    assert coupling.touch.share == 0.0


@settings(max_examples=40)
@given(st.lists(st.tuples(vectors, vectors, vectors, vectors, st.integers(-2, 9)), min_size=1, max_size=30))
def test_no_state_whatever_makes_an_addition_above_its_clamp(
    motions: list[tuple[Vector, Vector, Vector, Vector, int]],
) -> None:
    coupling, now = coupled(touch=SOME)
    for k, (q, dq, q_t, grasp, age) in enumerate(motions):
        state = replace(twin(now + (k - age) * T_NS, q_t, -dq, 9.0 * grasp), pulled=-grasp)
        coupling.step(now + k * T_NS, q, dq, state, HERE)
        assert np.all(np.abs(coupling.addition) <= CLAMP)
        if age == 0:
            coupling.unheard()
            assert np.all(np.abs(coupling.addition) <= CLAMP)
        assert np.isfinite(coupling.on_twin).all()
        assert 0.0 <= coupling.alive <= 1.0
