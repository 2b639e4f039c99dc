"""Friction of joints that hardly move, all places at once, against the model of one joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.config.cell import load_cell
from agent.config.schema.arm import Figure, Provenance, ServoJoint
from agent.config.schema.tolerance import Tolerance
from agent.control.friction import JointFriction
from agent.verify.rubbing import Rubbing

KEYS = ("coulomb_Nm", "viscous_Nm_s_per_rad", "breakaway_Nm", "load_friction", "breakaway_load_friction")
SERVO = load_cell(Path("paper")).arms[0].servos[0]


def joint(coulomb: float, viscous: float, breakaway: float, load: float, breakaway_load: float) -> ServoJoint:
    values = (coulomb, viscous, breakaway, load, breakaway_load)
    figures = {
        k: Figure(value=v, status=Provenance.ESTIMATED, source="a test") for k, v in zip(KEYS, values, strict=True)
    }
    return SERVO.model_copy(update=figures)


AS_FILED = Tolerance()
ONE = Rubbing.of([joint(0.1, 0.02, 0.03, 0.05, 0.2)], AS_FILED)
TAU = np.array([[0.0], [2.0], [-2.0]])


def test_a_joint_at_rest_resists_by_breakaway_and_load_and_a_moving_one_by_neither_breakaway() -> None:
    assert ONE.at_rest(TAU)[:, 0] == pytest.approx([0.13, 0.13 + 0.25 * 2.0, 0.13 + 0.25 * 2.0])
    assert ONE.moving(TAU)[:, 0] == pytest.approx([0.1, 0.1 + 0.05 * 2.0, 0.1 + 0.05 * 2.0])


def test_at_most_is_the_file_s_breakaway_or_half_of_coulomb_friction_whichever_is_more() -> None:
    assert ONE.at_most(TAU)[:, 0] == pytest.approx([0.15, 0.15 + 0.25 * 2.0, 0.15 + 0.25 * 2.0])
    assert Rubbing.of([joint(0.1, 0.0, 0.3, 0.0, 0.0)], AS_FILED).at_most(TAU)[:, 0] == pytest.approx([0.4] * 3)


def test_at_most_is_what_the_cell_states_beside_a_file_that_has_none_where_that_is_more() -> None:
    stated = Tolerance(breakaway=2.0, load_friction=0.1)
    plain = Rubbing.of([joint(0.1, 0.0, 0.0, 0.0, 0.0)], stated)
    assert plain.at_most(TAU)[:, 0] == pytest.approx([0.3, 0.3 + 0.1 * 2.0, 0.3 + 0.1 * 2.0])
    assert (plain.at_rest(TAU) == plain.moving(TAU)).all(), "only the most of it is more"
    assert Rubbing.of([joint(0.1, 0.0, 0.03, 0.05, 0.0)], stated).at_most(TAU) == pytest.approx(
        Rubbing.of([joint(0.1, 0.0, 0.03, 0.05, 0.0)], AS_FILED).at_most(TAU)
    )


PART = st.floats(0.0, 0.45)


@given(PART, PART, PART, PART, st.floats(-3.0, 3.0), st.floats(-1.0, 1.0))
def test_what_is_fed_is_what_the_feed_forward_makes_of_it_at_rest(
    coulomb: float, breakaway: float, load: float, breakaway_load: float, tau: float, sign: float
) -> None:
    rubbing = Rubbing.of([joint(coulomb, 0.0, breakaway, load, breakaway_load)], AS_FILED)
    fed = rubbing.fed(np.array([[tau]]), np.array([[sign]]))
    one = JointFriction(coulomb, 0.0, breakaway, 1.0, 1.0, load, breakaway_load)
    assert fed[0, 0] == pytest.approx(one.bound(1.0, tau, sign))
