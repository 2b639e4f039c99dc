"""The adaptive cell with one base believed elsewhere: what its arms press with in the end, and whether that grows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.config.cell import load_cell
from agent.config.schema.reality import ArmReality, Reality
from agent.report.series import internal_wrenches
from agent.study.lab import Laboratory, Run
from drivers.interface import Vector

DIAGONAL = (2.0**-0.5, 2.0**-0.5, 0.0)
EVERY = 10  # ticks between two looks at the truth


@dataclass(frozen=True)
class Pressed:
    """Of one run: force of the arm with the most and error of the object, at instants t (k,)."""

    t: Vector
    force_N: Vector
    error_m: Vector
    told: tuple[str, ...]  # of arms that gave up following

    def mean_N(self, begin_s: float, end_s: float) -> float:
        """Mean force between two instants."""
        return float(self.force_N[(self.t >= begin_s) & (self.t < end_s)].mean())

    def error_after_m(self, begin_s: float) -> float:
        """Largest error from an instant on."""
        return float(self.error_m[self.t >= begin_s].max())


def pressed(
    off_mm: float,
    duration_s: float,
    *overrides: str,
    direction: tuple[float, float, float] = DIAGONAL,
    object_times: float = 1.0,
) -> Pressed:
    """Run `paper_adaptive` with the right base off by so much, and the object so many times as heavy as believed."""
    cell = load_cell(Path("paper_adaptive"), overrides)
    x, y, z = (1e-3 * off_mm * d for d in direction)
    run = Run(Laboratory(cell), Reality(object=object_times, arms={"right": ArmReality(base_m=(x, y, z))}))
    trajectory, t, error, wrench, quat = cell.trajectory(), [], [], [], []
    while run.t < duration_s:
        if run.tick % EVERY == 0 and run.t >= 0.0:
            seen = run.observe()
            t.append(run.t)
            error.append(float(np.linalg.norm(seen.p_object - np.array(trajectory.at(run.t).p))))
            wrench.append(seen.grasp_wrench)
            quat.append(seen.quat_object)
        run.advance()
    internal = internal_wrenches(np.array(wrench), np.array(quat), None)[:, :, :3]
    told = tuple(trip.told for trip in run.trips)
    return Pressed(np.array(t), np.linalg.norm(internal, axis=2).max(axis=1), np.array(error), told)
