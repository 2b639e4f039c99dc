"""What servos bear for long: an advice, said by `coop check` and held against what shipped cells ask."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict
from agent.verify.path import _rms
from drivers.dynamixel.servo.models import CONTINUOUS_SHARE
from tests.support.control.level_wx200 import LEVEL


@cache
def found(name: str, *overrides: str) -> list[Finding]:
    return [f for f in examine(load_cell(Path(name), overrides)).findings if f.what.startswith("current for long")]


def test_no_servo_of_two_wx200_carries_more_than_is_advised_for_long() -> None:
    assert [f.verdict for f in found("two_wx200")] == [Verdict.OK, Verdict.OK]
    assert [f.found.split()[0] for f in found("two_wx200")] == ["19.9%", "19.7%"]


def test_what_is_a_little_above_is_not_written_as_what_is_advised() -> None:
    right = found("two_models")[1]
    assert (right.verdict, right.found.split()[0]) == (Verdict.WARNING, "20.1%")
    assert right.wanted.startswith("≤ 20%")


def test_elbows_of_arms_that_reach_out_level_carry_more() -> None:
    level = found("two_wx200", *LEVEL)
    assert [(f.what, f.where, f.verdict) for f in level] == [
        ("current for long, elbow", "left", Verdict.WARNING),
        ("current for long, elbow", "right", Verdict.WARNING),
    ]
    assert all(25.5 <= float(f.found.split("%")[0]) < 26.5 for f in level)
    assert all(f.wanted.startswith("≤ 20%") for f in level)


def test_the_arms_of_the_paper_carry_less() -> None:
    assert [f.verdict for f in found("paper_real")] == [Verdict.OK, Verdict.OK]
    assert all(f.found.startswith("10.") for f in found("paper_real"))


def test_a_quick_move_between_long_waits_adds_no_more_than_its_time(tmp_path: Path) -> None:
    """Many of the instants that are examined are of it; of the time it is a hundredth."""
    text = (configs.CELLS_DIR / "two_wx200.toml").read_text()
    rest = (
        'kind = "rest_to_rest"\np_from_m = [0.225, 0.0, 0.25]\np_to_m = [{}, 0.0, 0.25]\n'
        "move_s = 0.05\nwait_s = 60.0\nand_back = true"
    )
    for place in (0.225, 0.235):
        moved = re.sub(r"\[trajectory\]\n(.+\n)+", f"[trajectory]\n{rest.format(place)}\n", text)
        (tmp_path / f"{place}.toml").write_text(moved)
    still, quick = (found(str(tmp_path / f"{place}.toml"), "duration_s=121.0") for place in (0.225, 0.235))
    assert [f.found.split()[0] for f in still] == [f.found.split()[0] for f in quick] == ["19.7%", "19.7%"]


def test_a_root_mean_square_is_over_time_and_none_of_no_time() -> None:
    squares = [np.array([4.0, 1.0]), np.array([4.0, 1.0]), np.array([16.0, 1.0]), np.array([16.0, 1.0])]
    assert _rms(squares, [1.0, 1.5, 1.5, 3.5], 2).tolist() == pytest.approx([math.sqrt((0.5 * 4 + 2 * 16) / 2.5), 1.0])
    assert _rms(squares[:1], [1.0], 2).tolist() == _rms([], [], 2).tolist() == [0.0, 0.0]


def test_a_servo_bears_a_fifth_of_its_stall_current_for_long() -> None:
    assert CONTINUOUS_SHARE == 0.2
