"""Shipped cells as the stability criterion sees them: poses, loop and ranges; and gains that it accepts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

import configs
from agent.config import observer
from agent.config.cell import Cell, load_cell
from agent.config.schema.controller import ObserverGains
from agent.verify.check import start_configurations
from agent.verify.criterion.bodies import Pose, pose
from agent.verify.criterion.cases import Aligning, Loop, Ranges

# k_p, k_eps, k_v of translation and of rotation; and the part of k_p and k_eps that stands in v̇_r
GENTLE = {3: (100.0, 60.0, 1.5, 0.1), 6: (80.0, 60.0, 3.0, 0.1)}  # by controlled joints
GENTLE_RATE = 0.7
OBSERVER = tuple(f"controller.observer.{key}={value}" for key, value in ObserverGains().model_dump().items())
FIRST = {3: (150.0, 100.0, 2.5, 2.5), 6: (100.0, 100.0, 10.0, 0.3)}  # of the paper, and of the first six-joint cells


@cache  # nobody changes a cell, and a dozen tests ask for the same
def cell_of(name: str, *overrides: str) -> Cell:
    """A shipped cell; its arms align themselves where an override says how."""
    aligned = any(change.startswith("controller.alignment.") for change in overrides)
    changes = [f"controller.alignment.enabled={str(aligned).lower()}", *overrides]
    return load_cell(configs.CELLS_DIR / f"{name}.toml", changes)


def with_gains(name: str, gains: Mapping[int, Sequence[float]], rate: float, *overrides: str) -> Cell:
    """A shipped cell with other gains."""
    arms = cell_of(name).file.arms
    k_p, k_eps, k_v, k_v_turn = gains[len(arms[0].controlled)]
    changes = [
        f"controller.k_p_per_s={k_p}",
        f"controller.k_eps_rad_per_s={k_eps}",
        f"controller.k_p_rate_per_s={rate * k_p}",
        f"controller.k_eps_rate_rad_per_s={rate * k_eps}",
        *OBSERVER,
    ]
    for arm in arms:
        changes += [f"arms.{arm.name}.k_v_N_s_per_m={k_v}", f"arms.{arm.name}.k_v_Nm_s_per_rad={k_v_turn}"]
    return cell_of(name, *changes, *overrides)


def gentle(name: str, *overrides: str) -> Cell:
    """With gains that survive reality."""
    return with_gains(name, GENTLE, GENTLE_RATE, *overrides)


def first(name: str, *overrides: str) -> Cell:
    """With gains that do not."""
    return with_gains(name, FIRST, 1.0, *overrides)


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
