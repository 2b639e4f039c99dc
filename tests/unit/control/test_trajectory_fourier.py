"""The excitation motion: derivatives against central differences, rest at both ends, and what its file refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import configs
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.trajectory import SAMPLES_PER_SHORTEST_PERIOD, waypoint_times
from agent.control.quaternion import conjugate, multiply
from agent.control.trajectory_fourier import Fourier, Term
from tests.support.control.oracle import rate_at

CENTRE, UPRIGHT = (0.1, -0.2, 0.3), (0.5, 0.5, -0.5, 0.5)
BASE_S, FADE_S, MOTION_S = 4.0, 1.5, 10.0

terms = st.lists(
    st.builds(Term, st.integers(1, 6), st.floats(-0.15, 0.15), st.floats(-math.pi, math.pi)), max_size=3
)  # fmt: skip
motions = st.builds(
    lambda axes: Fourier(CENTRE, UPRIGHT, axes, BASE_S, FADE_S, MOTION_S), st.tuples(*[terms] * 6)
)  # fmt: skip
times = st.floats(0.01, MOTION_S - 0.01)


@given(motions, times)
def test_twist_is_the_derivative_of_the_pose(motion: Fourier, t: float) -> None:
    now = motion.at(t)
    assert rate_at(lambda s: np.array(motion.at(s).p), t) == pytest.approx(now.v[:3], abs=1e-7)

    def small_rotation(s: float) -> np.ndarray:
        """Twice the vector part of the rotation from time t to time s: its rate at t is ω, world axes."""
        return 2.0 * np.array(multiply(motion.at(s).quat, conjugate(now.quat))[1:])

    assert rate_at(small_rotation, t) == pytest.approx(now.v[3:], abs=1e-7)


# where the window begins or ends to move, its third derivative jumps and a difference quotient is no derivative
SMOOTH = times.filter(lambda t: min(abs(t - x) for x in (0.0, FADE_S, MOTION_S - FADE_S, MOTION_S)) > 1e-2)


@given(motions, SMOOTH)
def test_acceleration_is_the_derivative_of_the_twist(motion: Fourier, t: float) -> None:
    assert rate_at(lambda s: np.array(motion.at(s).v), t) == pytest.approx(motion.at(t).a, abs=1e-6)


@given(motions, st.sampled_from([0.0, MOTION_S, MOTION_S + 3.0]))
def test_it_begins_and_ends_at_rest_at_its_centre(motion: Fourier, t: float) -> None:
    now = motion.at(t)
    assert now.p == pytest.approx(CENTRE, abs=1e-15)
    assert now.quat == pytest.approx(UPRIGHT, abs=1e-15)
    assert np.allclose(now.v, 0.0, atol=1e-12)
    assert np.allclose(now.a, 0.0, atol=1e-12)


@given(motions)
def test_no_excursion_exceeds_the_sum_of_amplitudes(motion: Fourier) -> None:
    for axis in range(3):
        bound = sum(abs(term.amplitude) for term in motion.axes[axis])
        seen = [abs(motion.at(t).p[axis] - CENTRE[axis]) for t in np.linspace(0.0, MOTION_S, 60)]
        assert max(seen) <= bound + 1e-12


WELL = """kind = "fourier"
p_centre_m = [0.3, 0.12, 0.0]
base_period_s = 10.0
fade_s = 2.0
motion_s = 20.0
x_m = [[1, 0.03, 0.0], [4, 0.01, 0.3]]
yaw_rad = [[3, 0.1, 1.0]]
"""


def paper_with(tmp_path: Path, trajectory: str) -> Cell:
    text = (configs.CELLS_DIR / "paper.toml").read_text()
    begin, end = text.index('kind = "sinusoid"'), text.index("[controller]")
    path = tmp_path / "cell.toml"
    path.write_text(text[:begin] + trajectory + "\n" + text[end:])
    return load_cell(path)


def test_the_cell_file_gives_the_motion_and_the_instants_to_examine(tmp_path: Path) -> None:
    cell = paper_with(tmp_path, WELL)
    motion = cell.trajectory()
    assert isinstance(motion, Fourier)
    t = 7.0
    x = 0.03 * math.sin(0.2 * math.pi * t) + 0.01 * math.sin(0.8 * math.pi * t + 0.3)
    assert motion.at(t).p == pytest.approx((0.3 + x, 0.12, 0.0), abs=1e-12)
    instants, count = waypoint_times(cell.file, 100.0, 6000)
    assert (instants[0], instants[-1], len(instants)) == (0.0, 20.0, count)
    assert max(np.diff(instants)) <= 1.0 / (SAMPLES_PER_SHORTEST_PERIOD * 0.4) + 1e-12
    assert waypoint_times(cell.file, 100.0, 3) == ([0.0, 10.0, 20.0], count)
    assert max(waypoint_times(cell.file, 5.0, 6000)[0]) == 5.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "0.03, 0.0]",
            "0.3, 0.0]",
            "trajectory.x_m in .* a sum of 0.31, expected amplitudes that sum to at most 0.15",
        ),
        ("[3, 0.1, 1.0]", "[3, 1.1, 1.0]", "trajectory.yaw_rad in .* amplitudes that sum to at most 1;"),
        ("[4, 0.01, 0.3]", "[24, 0.01, 0.3]", "trajectory.x_m in .* a highest frequency of 2.4 Hz"),
        ("[4, 0.01, 0.3]", "[0, 0.01, 0.3]", "greater than or equal to 1"),
        ("motion_s = 20.0", "motion_s = 3.0", "motion_s ≥ 2 fade_s"),
        ("x_m = [[1, 0.03, 0.0], [4, 0.01, 0.3]]\nyaw_rad = [[3, 0.1, 1.0]]\n", "", "at least one term"),
    ],
)
def test_slips_are_refused(tmp_path: Path, old: str, new: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        paper_with(tmp_path, WELL.replace(old, new))
