"""Recordings with known parameters: from the real plant with all servo effects, or exact ones from the equations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from agent.config.cell import Cell
from agent.identify.columns import all_columns, base_of, described_parameters, object_torque
from agent.identify.recording import Recording, acted
from drivers.interface import Vector
from tests.support.arm_files import with_true_arms
from tests.support.plant.inprocess import simulate

DAY = "2026-03-14"


def from_plant(cell: Cell, directory: Path, factors: Mapping[str, Mapping[str, float]]) -> tuple[Recording, Vector]:
    """Recording of the cell's own motion by agents that believe the shipped arm files, and the true base parameters.

    factors: of the plant's figures, by joint and key of the arm file.
    """
    true = with_true_arms(cell, directory, factors=factors)
    arm = true.arms[0]
    model = true.model(arm)
    truth = base_of(model).combination @ described_parameters(arm, model)
    return recorded(true, cell), truth


def recorded(true: Cell, cell: Cell) -> Recording:
    """Recording of the cell's own motion in the plant of `true`, as a log of agents that believe `cell` has it."""
    history = simulate(true, cell.file.duration_s, agents_cell=cell)
    sent, T = np.array(history.tau_sent), 1.0 / cell.file.rate_hz
    tau = acted(sent, cell.file.delay_periods)
    return Recording(cell, cell.arms[0], T, np.array(history.q_measured), tau, DAY, sent, cell.file.delay_s)


def exact(cell: Cell, speed_rad_per_s: float, hz: tuple[float, ...], duration_s: float) -> Recording:
    """Joint sinusoids of these frequencies, each of this speed, and the torque of the described parameters."""
    arm, T = cell.arms[0], 1.0 / cell.file.rate_hz
    model, random = cell.model(arm), np.random.default_rng(0)
    t = T * np.arange(round(duration_s / T))[:, None, None]
    w = 2.0 * np.pi * np.array(hz) * (1.0 + 0.07 * np.arange(arm.n)[:, None])  # (n, frequencies)
    angle = w * t + random.uniform(-np.pi, np.pi, w.shape)
    q = np.array(arm.entry.q_near_rad) + (speed_rad_per_s / w * np.sin(angle)).sum(axis=2)
    dq = (speed_rad_per_s * np.cos(angle)).sum(axis=2)
    ddq = -(speed_rad_per_s * w * np.sin(angle)).sum(axis=2)
    columns = all_columns(model, q, dq, ddq, 0.02)
    tau = columns @ described_parameters(arm, model) + object_torque(cell, model, columns)
    return Recording(cell, arm, T, q, tau, DAY, tau, 0.0)
