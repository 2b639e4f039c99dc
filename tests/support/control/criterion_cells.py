"""Shipped cells as the stability criterion sees them: poses, loop and ranges; and gains that it accepts."""

from __future__ import annotations

import numpy as np

import configs
from agent.config import observer
from agent.config.cell import Cell, load_cell
from agent.verify.check import start_configurations
from agent.verify.criterion.bodies import Pose, pose
from agent.verify.criterion.cases import Aligning, Loop, Ranges

PLANAR = {"k_p": 100.0, "k_eps": 60.0, "k_v": 1.5, "k_v_turn": 0.1}
SPATIAL = {"k_p": 80.0, "k_eps": 60.0, "k_v": 3.0, "k_v_turn": 0.1}
RATE_SHARE = 0.7


def cell_of(name: str, *overrides: str) -> Cell:
    """A shipped cell."""
    return load_cell(configs.CELLS_DIR / f"{name}.toml", list(overrides))


def gentle(name: str, *overrides: str) -> Cell:
    """The same with gains that survive reality."""
    arms = cell_of(name).file.arms
    g = PLANAR if len(arms[0].controlled) == 3 else SPATIAL
    changes = [
        f"controller.k_p_per_s={g['k_p']}",
        f"controller.k_eps_rad_per_s={g['k_eps']}",
        f"controller.k_p_rate_per_s={RATE_SHARE * g['k_p']}",
        f"controller.k_eps_rate_rad_per_s={RATE_SHARE * g['k_eps']}",
    ]
    for arm in arms:
        changes += [f"arms.{arm.name}.k_v_N_s_per_m={g['k_v']}", f"arms.{arm.name}.k_v_Nm_s_per_rad={g['k_v_turn']}"]
    return cell_of(name, *changes, *overrides)


def start_pose(cell: Cell) -> Pose:
    """All arms at the start."""
    models = [cell.model(arm) for arm in cell.arms]
    viscous = [np.array([s.viscous_Nm_s_per_rad.value for s in arm.servos]) for arm in cell.arms]
    return pose(models, [cell.offline(arm) for arm in cell.arms], viscous, start_configurations(cell, models))


def loop_of(cell: Cell, aligning: Aligning | None = None) -> Loop:
    """Its loop as the agents run it."""
    gains = tuple(cell.offline(arm).gains for arm in cell.arms)
    return Loop(1.0 / cell.file.rate_hz, gains, observer.build(cell.file), aligning)


def ranges_of(cell: Cell) -> Ranges:
    """The stated realities at its delay."""
    n = cell.file.delay_periods
    return Ranges((0.8 * n, n, 1.25 * n))
