"""A radius that is too large is told beside a bound that it differs from, with a remedy that works at every rate."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict
from agent.verify.radius import mended, told

WEAK = tuple(
    f"arms.{arm}.{key}" for arm in ("left", "right") for key in ("k_v_N_s_per_m=1e-3", "k_v_Nm_s_per_rad=1e-4")
)
UNSTABLE = "raise rate_hz"


@pytest.mark.parametrize(
    ("radius", "most", "text"),
    [
        (0.9944, 0.9999, "0.9944"),
        (0.99994, 0.9999, "0.99994"),
        (0.99988, 0.9999, "0.99988"),
        (0.9999, 0.99985, "0.9999"),
        (0.999904, 0.9999, "0.999904"),
        (0.99997, 0.999933, "0.99997"),
        (0.99994, 0.999933, "0.99994"),
        (0.9999334, 0.9999334, "0.9999"),  # as much as may be, beside a bound that is printed as 0.999933
        (1.0, 0.9999, "1.0000"),
        (1.3, 0.9999, "1.3000"),
        (1.00001, 1.0 - 1e-9, "1.00001"),
        (0.99998, 1.0 - 1e-9, "0.99998"),
        (1.0 - 1e-14, 1.0 - 1e-9, "1.000000000"),
    ],
)
def test_a_radius_is_printed_on_the_side_of_its_bound_and_of_one_on_which_it_is(
    radius: float, most: float, text: str
) -> None:
    assert told(radius, most) == text


def test_what_is_stable_and_slow_is_not_sent_to_a_higher_rate() -> None:
    assert mended(1.0, 200.0, UNSTABLE) == UNSTABLE
    slow = mended(math.exp(-1.0 / (60.0 * 200.0)), 200.0, UNSTABLE)
    assert slow == "stable, but an error takes 60 s to fall to 37 %; take the gains that `coop tune` proposes"


def test_errors_must_fall_by_as_much_a_second_at_every_rate_unless_the_cell_gives_a_radius() -> None:
    for rate in (100.0, 200.0, 500.0):
        file = load_cell(Path("two_wx200"), [f"rate_hz={rate}"]).file
        assert 1.0 - file.radius_max**rate == pytest.approx(0.02, rel=0.02)
        given = load_cell(Path("two_wx200"), [f"rate_hz={rate}", "safety.spectral_radius_max=0.98"]).file
        assert given.radius_max == 0.98
    assert load_cell(Path("two_wx200")).file.radius_max == pytest.approx(0.9999, abs=1e-8)


def of_radius(*changes: str) -> Finding:
    (found,) = (f for f in examine(load_cell(Path("two_wx200"), changes)).findings if f.what.startswith("spectral"))
    return found


@pytest.mark.parametrize("rate", [100.0, 200.0, 300.0])
def test_gains_that_hold_nothing_are_refused_at_every_rate_and_sent_to_tune(rate: float) -> None:
    found = of_radius(*WEAK, f"rate_hz={rate}")
    assert found.verdict is Verdict.REFUSED
    assert float(found.wanted.removeprefix("≤ ")) < float(found.found) < 1.0
    assert "coop tune" in found.remedy
    assert "rate_hz" not in found.remedy
