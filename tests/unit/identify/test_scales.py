"""Factors of the joints' torques: found from links and object, and put back into what is one joint's alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.identify.columns import base_of
from agent.identify.equations import Motion, Options, equations
from agent.identify.friction import BREAKAWAY, BREAKAWAY_LOAD, LOAD
from agent.identify.scales import in_own_units, of_own_units, scales_of
from agent.identify.solve import Part
from tests.support.identify_rig import exact

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml", ["object.mass_kg=0.4"])
BASE = base_of(CELL.model(CELL.arms[0]))


@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (1.1, 1.0, 0.9), (0.95, 1.0, 1.04)])
def test_factors_of_exact_torques_are_those_relative_to_the_joint_that_bears_most(factors: tuple[float, ...]) -> None:
    """What the object takes is known in N·m, and a part of what a joint bears."""
    recording = exact(CELL, 0.5, (0.3, 0.7), 30.0)
    by = np.array(factors)
    scaled = replace(recording, tau=by * recording.tau, sent=by * recording.sent)
    options = Options(slow_rad_per_s=0.05)
    part = equations(scaled, CELL.model(CELL.arms[0]), BASE, options)
    found = scales_of(part, Motion.of(scaled, options), BASE)
    assert found.value == pytest.approx(by / by[found.most], abs=2e-3)
    assert found.sigma[found.most] == 0.0


def test_only_what_is_a_torque_of_one_joint_goes_back_into_its_unit() -> None:
    taken, sticking = np.array([1.1, 1.0, 0.9]), ((BREAKAWAY, 0), (LOAD, 0), (BREAKAWAY_LOAD, 2), (BREAKAWAY, 2))
    by = in_own_units(taken, BASE, sticking)
    assert by[-4:].tolist() == [1.1, 1.0, 1.0, 0.9]
    for j, factor in enumerate(taken.tolist()):
        assert [by[i] for i in (BASE.rotor(j), BASE.viscous(j), BASE.coulomb(j))] == [factor] * 3
    assert [by[i] for i in BASE.gravity()] == [1.0] * len(BASE.gravity())


def test_equations_of_own_units_say_the_same_of_parameters_in_these() -> None:
    random, taken = np.random.default_rng(1), np.array([1.1, 1.0, 0.9])
    by = in_own_units(taken, BASE, ())
    value, columns = random.normal(size=len(by)), random.normal(size=(5, 3, len(by)))
    part = Part(np.arange(5.0), columns, columns @ value, np.ones((5, 3), dtype=bool))
    own = of_own_units(part, taken, by)
    assert own.columns @ (by * value) == pytest.approx(own.tau)
    assert own.tau == pytest.approx(taken * part.tau)
