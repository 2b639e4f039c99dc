"""One step of the estimates at its bounds: how long an interval counts, what is held, what a cell may not ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.adaptation import Adaptation, Estimate, Gradient
from agent.control.friction import JointFriction

JOINTS = 3
STICKS = tuple(JointFriction(0.1, 0.05, 0.04, 0.3, 1.0, 0.0, 0.0) for _ in range(JOINTS))


def data(*overrides: str) -> Adaptation:
    cell = load_cell(configs.CELLS_DIR / "paper_adaptive.toml", overrides)
    found = cell.offline(cell.arms[0]).adaptation
    assert found is not None
    return found


def slope(data: Adaptation, size: float = 1e-4) -> Gradient:
    return Gradient(np.full(len(data.nominal.arm), size), np.full(10, size))


def joined(estimate: Estimate) -> np.ndarray:
    return np.concatenate([estimate.object, estimate.arm])


@pytest.mark.parametrize("leak", [0.0, 4.0])
def test_an_interval_of_more_than_four_periods_counts_as_four(leak: float) -> None:
    one = data(f"controller.adaptive.leak_per_s={leak}", "controller.adaptive.physical=false")
    began = Estimate(*(part + 1e-7 * (gain > 0.0) for part, gain in zip(one.nominal, one.gain, strict=True)))
    four, longer, shorter = (joined(one.advance(began, slope(one), k * one.period_s)[0]) for k in (4.0, 30.0, 3.9))
    np.testing.assert_array_equal(four, longer)
    assert (four != shorter).any()
    back = joined(one.advance(began, slope(one), -one.period_s)[0])
    np.testing.assert_array_equal(back, joined(began))


def test_nothing_of_it_is_written_to_again() -> None:
    one = data()
    arrays = [*one.start, *one.nominal, *one.lower, *one.upper, *one.gain, one._gain, one._alarm, one._leaks]
    assert not any(array.flags.writeable for array in arrays)


def test_weights_are_the_inverse_of_the_gains_and_zero_of_what_is_known() -> None:
    one = data("controller.adaptive.coulomb=true")
    for weight, gain in zip(one.weight, one.gain, strict=True):
        assert (gain == 0.0).any() or (gain > 0.0).all()
        np.testing.assert_allclose(weight, [1.0 / g if g > 0.0 else 0.0 for g in gain])
    off = Estimate(one.nominal.arm + 0.01, one.nominal.object - 0.02)
    wanted = 0.5 * (1e-4 * one.weight.arm.sum() + 4e-4 * one.weight.object.sum())
    assert one.parameter_error(off) == pytest.approx(wanted)


@pytest.mark.parametrize(("sum_of_loads", "allowed"), [(0.95, True), (0.96, False)])
def test_load_friction_that_no_torque_overcomes_is_refused_where_joints_stick(
    sum_of_loads: float, allowed: bool
) -> None:
    one = data()
    for place in (-1, -1 - JOINTS):  # of breakaway load, of load; the last joint's, other joints have none
        arm = one.upper.arm.copy()
        arm[-2 * JOINTS :] = 0.0
        arm[place] = sum_of_loads
        upper = Estimate(arm, one.upper.object)
        assert replace(one, upper=upper).sticking == (), "which says nothing of joints that do not"
        if allowed:
            assert replace(one, upper=upper, sticking=STICKS).sticking == STICKS
            continue
        with pytest.raises(ValueError, match=r"at most 0\.95 in sum"):
            replace(one, upper=upper, sticking=STICKS)
    both = one.upper.arm.copy()
    both[-2 * JOINTS :] = 0.5 * sum_of_loads
    if allowed:
        replace(one, upper=Estimate(both, one.upper.object), sticking=STICKS)
        return
    with pytest.raises(ValueError, match=r"at most 0\.95 in sum"):
        replace(one, upper=Estimate(both, one.upper.object), sticking=STICKS)


def test_the_load_of_another_joint_and_breakaway_do_not_count() -> None:
    one = data()
    arm = one.upper.arm.copy()
    arm[-3 * JOINTS :] = [5.0] * JOINTS + [0.9] * JOINTS + [0.0] * JOINTS
    assert replace(one, upper=Estimate(arm, one.upper.object), sticking=STICKS).sticking == STICKS


def test_a_bound_that_holds_an_estimate_is_told_and_a_mass_that_stays_above_zero_is_not() -> None:
    """Nor one that is known, and at both of its bounds."""
    one = data("controller.adaptive.physical=false", "controller.adaptive.leak_per_s=0.0")
    assert (joined(one.lower) == joined(one.upper)).any()
    assert one.advance(one.upper, slope(one, -1.0), one.period_s)[1]
    of_masses = slope(one, 0.0)
    of_masses.arm[: 10 * JOINTS : 10] = of_masses.object[0] = 1.0
    found, told = one.advance(one.start, of_masses, one.period_s)
    assert not told
    np.testing.assert_array_equal(joined(found), np.maximum(joined(one.lower), joined(found)))
    assert (found.arm[: 10 * JOINTS : 10] == 0.0).all()
    assert (found.object[0]) == 0.0


def test_what_need_not_be_physical_is_left_as_it_is() -> None:
    """The object's first principal moment becomes twice the sum of the others."""
    for physical in (True, False):
        usual = data("controller.adaptive.leak_per_s=0.0")
        one = replace(usual, physical=physical, upper=Estimate(usual.upper.arm, np.full(10, 9.0)))
        gradient = Gradient(np.zeros(len(one.nominal.arm)), np.zeros(10))
        moments = one.nominal.object.copy()
        moments[4] = 4.0 * (moments[7] + moments[9])
        found, _ = one.advance(Estimate(one.nominal.arm, moments), gradient, one.period_s)
        assert np.array_equal(found.object, moments) is not physical
