"""A motion that begins beside its start pose: blended into it, as gently as an exact start, and refused from too far.

Real drivers, loops and emulated servos in virtual time; the arms see where the object is, and nobody tells them.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.modes import Mode
from tests.support.servos.coupled_rig import CoupledRun

BLEND_S, DURATION_S = 2.5, 3.05
OFF_M, OFF_RAD = np.array([0.015, 0.0, 0.0]), 0.06


def cell_of(*more: str, duration_s: float = DURATION_S) -> Cell:
    session = [f"session.start_blend_s={BLEND_S}", "session.lift_m=0.0", "session.lift_s=0.5", "session.take_up_s=0.3"]
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", [f"duration_s={duration_s}", *session, *more])


@cache
def run(beside: float) -> CoupledRun:
    """Of an exact start nothing is asked behind the blend."""
    lasts_s = DURATION_S if beside else BLEND_S
    p = np.array(cell_of().file.object.p_start_m) + beside * OFF_M
    half = 0.5 * beside * OFF_RAD
    quat = [math.cos(half), 0.0, math.sin(half), 0.0]
    real = cell_of(
        f"object.p_start_m={p.tolist()}",
        f"object.quat_start={quat}",
        "safety.start_error_max_m=0.05",
        duration_s=lasts_s,
    )
    return CoupledRun(real, believed=cell_of(duration_s=lasts_s))


@pytest.mark.long  # tests/unit/monitors/test_cells_watched.py has such a start without servos
def test_a_start_from_15_mm_and_60_mrad_beside_is_as_gentle_as_an_exact_one() -> None:
    exact, beside = run(0.0), run(1.0)
    for name, arm in beside.arms.items():
        rows = arm.rows[(arm.rows["mode"] == Mode.TRACK) & (arm.rows["t"] < BLEND_S)]
        there = exact.arms[name].rows
        there = there[(there["mode"] == Mode.TRACK) & (there["t"] < BLEND_S)]
        peak, bound = (np.abs(r["tau_sent"][:, :3]).max(axis=0) for r in (rows, there))
        assert (peak <= 1.35 * bound).all()  # a shoulder bears 0.78 N·m, and 15 mm further out more
        assert np.abs(rows["dq"][:, :3]).max() <= 0.3


@pytest.mark.long  # of the same run
def test_the_blend_ends_on_the_motion_of_the_cell() -> None:
    motion = cell_of().trajectory()
    for arm in run(1.0).arms.values():
        row = arm.rows[(arm.rows["mode"] == Mode.TRACK) & (arm.rows["t"] > BLEND_S + 0.5)][0]
        want = np.array(motion.at(float(row["t"])).p)
        assert np.linalg.norm(row["p_object"] - want) < 3e-3
        first = arm.rows[arm.rows["mode"] == Mode.TRACK][0]
        assert abs(np.linalg.norm(first["p_object"] - np.array(motion.at(0.0).p)) - 0.015) < 3e-3
