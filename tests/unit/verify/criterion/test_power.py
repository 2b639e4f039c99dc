"""Radii that are proved to be below a bound, against eigenvalues; and worst cases found with and without the proof."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.control.models import Matrix
from agent.verify.criterion.cases import Aligning, Case, Demand, alone, rigid, soft
from agent.verify.criterion.examine import rank
from agent.verify.criterion.judge import Judge, blocks
from agent.verify.criterion.power import APART, SQUARINGS, below
from tests.support.control.criterion_cells import gentle, loop_of, ranges_of, start_pose

SIZE = 12


def stack(radius: float, random: np.random.Generator, units: float = 1.0) -> Matrix:
    """Twenty matrices of one spectral radius, whose states are in units apart by up to a factor of units squared."""
    A = random.normal(size=(20, SIZE, SIZE))
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=-1)[:, None, None]
    scale = units ** random.uniform(-1.0, 1.0, SIZE)
    return A * (scale / scale[:, None])


@pytest.mark.parametrize("units", [1.0, 1e4])
@pytest.mark.parametrize("bound", [1e-3, 0.9, 1.0, 1.4, 1e3])
def test_what_is_below_is_proved_and_what_is_above_is_not(bound: float, units: float) -> None:
    random = np.random.default_rng(0)
    assert below(stack(0.98 * bound, random, units), bound).all()
    assert not below(stack(1.0001 * bound, random, units), bound).any()
    assert not below(stack(3.0 * bound, random, units), bound).any()


def test_every_one_of_a_stack_is_told_by_itself() -> None:
    random = np.random.default_rng(1)
    factors = np.array([0.3, 1.2, 0.97, 1.001, 0.5, 1e9])
    mixed = stack(1.0, random)[: len(factors)] * factors[:, None, None]
    assert below(mixed, 1.0).tolist() == (factors < 1.0).tolist()


@pytest.mark.parametrize(("radius", "proved"), [(0.7, True), (1.0, False), (1.001, False)])
def test_powers_that_grow_before_they_die_are_followed(radius: float, proved: bool) -> None:
    """Those of a Jordan block of n rows grow like kⁿ⁻¹ at first."""
    jordan = radius * np.eye(5) + np.diag(np.ones(4), 1)
    assert np.linalg.norm(np.linalg.matrix_power(jordan, 4)) > 5.0
    assert below(jordan[None], 1.0).tolist() == [proved]


def test_rounding_is_counted() -> None:
    """A map of radius one within rounding: its powers are as small as rounding has them, which proves nothing."""
    random = np.random.default_rng(2)
    turned, _ = np.linalg.qr(random.normal(size=(SIZE, SIZE)))
    for scale in (1.0 - APART, 1.0 - 1e-9, 1.0):
        assert not below(scale * turned[None], 1.0).any()
    assert not below(stack(1.0 - 0.5**SQUARINGS * 1e-3, random), 1.0).any()
    assert below(np.array([[[1.0 - 2.0 * APART]], [[1.0 - 0.5 * APART]]]), 1.0).tolist() == [True, False]
    lost = np.array([[0.0, 6.5e3], [0.0, 0.0]])  # its square is zero, beside which what rounding adds is large
    assert below(np.array([0.1 * lost, lost]), 1.0).tolist() == [True, False]


def test_what_rounding_adds_is_counted_to_its_last_unit() -> None:
    """Of a number near one it is one unit of rounding; behind one squaring two, times the norm's fourth power."""
    unit, bound = float(np.finfo(np.float64).eps), 1.0 / (1.0 - APART)
    assert bound * (1.0 - APART) == 1.0
    for units, proved in ((0.5, False), (1.0, False), (3.0, True)):
        assert below(np.array([[[1.0 - units * unit]]]), bound).tolist() == [proved], units
    for part, proved in ((0.8, True), (1.1, False)):
        norm = (part / (2.0 * 2.0 * unit)) ** 0.25
        assert below(np.array([[[0.0, norm], [0.0, 0.0]]]), bound).tolist() == [proved], part


@pytest.mark.parametrize(("radius", "proved"), [(0.995, True), (0.997, False)])
def test_ten_squarings_tell_radii_apart_by_half_a_per_cent(radius: float, proved: bool) -> None:
    assert below(np.array([[[radius, 0.1], [0.0, radius]]]), 1.0).tolist() == [proved]


@pytest.mark.parametrize("count", [2, 8])
def test_a_stack_is_balanced_by_more_than_its_first_matrix(count: int) -> None:
    mixed = stack(0.9, np.random.default_rng(4), 1e4)[:count]
    mixed[0] = 0.0
    assert below(mixed, 1.0).all()


@pytest.mark.parametrize(("count", "proved"), [(3, True), (4, False)])
def test_every_second_of_four_matrices_is_enough_to_balance_all(count: int, proved: bool) -> None:
    mixed = stack(0.9, np.random.default_rng(4), 1e4)[:count]
    mixed[::2] = 0.0
    assert below(mixed, 1.0)[1] == proved


def test_a_radius_is_below_by_a_millionth_of_the_bound_at_least() -> None:
    assert below(np.array([[[1.0 - 1.5e-6]], [[1.0 - 0.9e-6]]]), 1.0).tolist() == [True, False]


@pytest.mark.parametrize(("states", "units", "proved"), [(4, 1e5, True), (6, 1e2, False)])
def test_a_chain_of_states_is_balanced_in_four_rounds(states: int, units: float, proved: bool) -> None:
    """Of a radius below 0.8; three rounds are too few for the first chain, five would do for the second."""
    up, down = (np.diag(np.full(states - 1, 0.2 * u), k) for u, k in ((units, 1), (1.0 / units, -1)))
    assert below((0.4 * np.eye(states) + up + down)[None], 1.0).tolist() == [proved]


def test_states_that_are_coupled_one_way_alone_are_proved_too() -> None:
    one_way = np.array([[0.5, 100.0], [0.0, 0.5]])
    for A in (one_way, one_way.T):
        assert below(A[None], 1.0).all()


def test_no_bound_and_no_matrices_prove_nothing() -> None:
    A = stack(0.1, np.random.default_rng(3))
    assert not below(A, 0.0).any()
    assert not below(A, float("nan")).any()
    assert below(A[:0], 1.0).shape == (0,)


@pytest.mark.parametrize("name", ["paper", pytest.param("three_wx250s", marks=pytest.mark.long)])
def test_the_worst_cases_are_the_same_with_and_without_proof(name: str) -> None:
    cell = gentle(name)
    judge, ranges = Judge([start_pose(cell)], loop_of(cell, Aligning(0, 2.0))), ranges_of(cell)
    softly = soft(ranges, 0, ranges.delays[0], 1)[:: len(cell.arms) - 1]
    aligning = [replace(c, demand=Demand.ALIGNING) for c in softly[:20]]
    count = len(cell.arms)
    left_out = 0
    for cases in (alone(count, ranges, [0], ranges.delays), rigid(ranges, [0], ranges.delays), softly, aligning):
        all_of_them = rank(judge, ranges, cases)
        assert len(all_of_them) == len(cases)
        for count in (2, 5):
            kept = rank(judge, ranges, cases, kept=count)
            for demand in {c.demand for c in cases}:
                worst = [[f for f in found if f.case.demand is demand][:count] for found in (kept, all_of_them)]
                assert worst[0] == worst[1]
        least = all_of_them[len(cases) // 2].radius
        left_out += len(cases) - len(kept)
        above = rank(judge, ranges, cases, least=least)
        assert [f for f in above if f.radius >= least] == [f for f in all_of_them if f.radius >= least]
    assert left_out > 50


def test_a_case_has_the_same_radius_in_whatever_stack_it_is() -> None:
    cell = gentle("two_models")
    loop, ranges = loop_of(cell), ranges_of(cell)
    at = start_pose(cell)
    lighter = tuple(replace(g, inertia=0.8 * g.inertia, viscous=0.5 * g.viscous) for g in at.grips)
    poses = [at, replace(at, object_inertia=2.0 * at.object_inertia, grips=lighter)]
    judge = Judge(poses, loop)
    cases = [*alone(2, ranges, [0, 1], [1.25]), *rigid(ranges, [0, 1], [1.25])]
    cases += [Case(Demand.SOFT, place, 1.25, 0.7, 1.2, None, 1e4, 10.0) for place in (0, 1)]
    together = {f.case: f.radius for f in rank(judge, ranges, cases)}
    assert len({round(r, 9) for r in together.values()}) > len(cases) // 2
    for block in blocks(poses, loop, ranges, cases):
        for case, radius in zip(block.cases, judge.radii(block).tolist(), strict=True):
            assert together[case] == pytest.approx(radius, rel=1e-11)
